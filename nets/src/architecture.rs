//! What a net is to its training: its input, its layers, its answer, its loss, its limits.
//! Uses: the types of the shared parts. Never: a particular net (`net` lists them).

use crate::error::RecipeError;
use crate::initial::Initial;
use crate::input::Input;
use crate::loss::Loss;
use crate::network::Network;
use crate::quantity::Quantity;
use crate::statistics::Statistics;

/// Frames that a net reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frames {
    /// Frames that the readout measured, V.
    Measured,
    /// Frames that the forward model computed, V; measured ones pass a Transfer-Net first.
    Simulated,
}

/// Answer of a net to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// A frame, V.
    Frame,
    /// A square force map, N per pixel.
    Map {
        /// Number of pixels along a side.
        side: usize,
    },
    /// Logit of presence and `ln` of the force, N, at each point; the target is the force.
    Points,
    /// Few numbers for a whole frame.
    Quantity(Quantity),
}

/// A net that is fitted in closed form, not by steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClosedForm {
    /// Linear regression with a penalty on the squared weights.
    Ridge,
    /// Regression on the likeness of a frame to training rows, `exp(-gamma |x - c|^2)`.
    KernelRidge {
        /// Largest number of centres.
        centres: usize,
    },
}

impl Answer {
    /// Length of a target; `points`: the number of points of the sensor, or of known places.
    pub fn target_len(self, channels: usize, points: usize) -> usize {
        match self {
            Self::Frame => channels,
            Self::Map { side } => side * side,
            Self::Points => points,
            Self::Quantity(quantity) => quantity.len(points),
        }
    }
}

/// Parameters of a net in a recipe, and what follows from them.
pub trait Architecture {
    /// Normalisation of its frames.
    fn input(&self) -> Input;

    /// Kind of its answers.
    fn answer(&self) -> Answer;

    /// Checks the limits of its parameters.
    ///
    /// # Errors
    /// `RecipeError::Value` with the first value outside its limits.
    fn check(&self) -> Result<(), RecipeError>;

    /// Its loss; `target_size` is the root mean square of its targets.
    fn loss(&self, target_size: f32) -> Loss;

    /// The net before the first step; `target` is the length of a target.
    fn first(&self, statistics: &Statistics, target: usize, initial: &mut Initial) -> Network;

    /// How it is fitted in closed form; `None`: it is trained by steps.
    fn closed_form(&self) -> Option<ClosedForm> {
        None
    }
}
