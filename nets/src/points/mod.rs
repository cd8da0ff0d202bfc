//! Point-Net: for each point of the skin the logit of the presence of a contact and the logarithm
//! of its force (`docs/references.md`, "Feasibility study").
//! PURE. Uses: the shared parts; `streamed` simulates its samples. Never: data.

pub mod draws;
pub mod streamed;

use serde::{Deserialize, Serialize};

use self::draws::Draws;
use crate::architecture::{Answer, Architecture};
use crate::error::{RecipeError, require};
use crate::initial::{Initial, LINEAR};
use crate::input::Input;
use crate::loss::Loss;
use crate::network::{Form, Layer, Network, WEIGHTS_MAX};
use crate::statistics::Statistics;

/// Parameters of a Point-Net. Its answer is `[2, points]`: logits, then `ln` of the force in
/// newtons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointNet {
    /// Number of principal components in the input.
    pub components: usize,
    /// Number of hidden layers.
    pub hidden: usize,
    /// Number of neurons of a hidden layer.
    pub width: usize,
    /// Weight of the squared error of `ln` force, summed over the pressed points, compared with the
    /// cross entropy of presence, summed over all points.
    pub force_weight: f64,
    /// Distribution of contacts in the samples that are simulated during training.
    pub draws: Draws,
}

impl Default for PointNet {
    fn default() -> Self {
        Self { components: 100, hidden: 3, width: 1024, force_weight: 1.0, draws: Draws::default() }
    }
}

/// Logit of presence at the start: 3.5 contacts on 804 points.
const RARE: f32 = -5.4;
/// `ln` of the force at the start: 15 N.
const TYPICAL: f32 = 2.7;

impl Architecture for PointNet {
    fn input(&self) -> Input {
        Input::Whitened { components: self.components }
    }

    fn answer(&self) -> Answer {
        Answer::Points
    }

    fn check(&self) -> Result<(), RecipeError> {
        require(self.components > 0, "net.components", self.components, "at least 1")?;
        require((1..=64).contains(&self.hidden), "net.hidden", self.hidden, "1..64")?;
        require((1..=1 << 14).contains(&self.width), "net.width", self.width, "1..16384")?;
        let weights = self.hidden * self.width * self.width;
        require(weights <= WEIGHTS_MAX, "net.hidden x net.width^2", weights, "at most 2^28")?;
        let good = self.force_weight.is_finite() && self.force_weight >= 0.0;
        require(good, "net.force_weight", self.force_weight, "at least 0")?;
        self.draws.check()
    }

    fn loss(&self, _: f32) -> Loss {
        Loss::PresenceAndForce { force_weight: self.force_weight }
    }

    fn first(&self, statistics: &Statistics, points: usize, initial: &mut Initial) -> Network {
        let channels = statistics.mean.len();
        let mut layers = self.input().layers(statistics);
        let mut inputs = self.input().width(channels);
        for _ in 0..self.hidden {
            layers.extend([initial.dense(inputs, self.width, LINEAR), Layer::Gelu]);
            inputs = self.width;
        }
        let mut heads = initial.dense(inputs, 2 * points, LINEAR);
        if let Layer::Dense { bias, .. } = &mut heads {
            bias[..points].fill(RARE);
            bias[points..].fill(TYPICAL);
        }
        layers.push(heads);
        Network { inputs: channels, output: vec![2, points], layers, form: Form::Plain }
    }
}
