//! Ridge regression and kernel ridge regression from voltages to a quantity, to simulated voltages, or to a force map:
//! fitted in closed form, and what every net must be compared with. Channels are standardised, or robust; the penalty,
//! and the width of the kernel, are those of the least error on the validation rows.
//! PURE. Uses: the shared parts. Never: data, a fit (`closed_form` computes it).
//!
//! Source: C. Saunders, A. Gammerman, V. Vovk, Ridge Regression Learning Algorithm in Dual Variables,
//! ICML 1998.

use serde::{Deserialize, Serialize};

use crate::architecture::{Answer, Architecture, ClosedForm, Frames};
use crate::error::{RecipeError, require};
use crate::initial::Initial;
use crate::input::Input;
use crate::loss::Loss;
use crate::network::{Form, Layer, Network};
use crate::quantity::Quantity;
use crate::statistics::Statistics;

/// Threshold of a pattern's targets, 0 and 1.
const HALF: f32 = 0.5;
/// Largest side of a map, pixels: that of the finest map of the paper. The weights grow with its square.
const SIDE_MAX: usize = 160;

/// What a regression answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Regressed {
    /// Position of the one contact.
    Position,
    /// Which of the known places are pressed.
    Pattern,
    /// Number of contacts.
    Count,
    /// Sum of the contacts' forces.
    Force,
    /// The simulated frame, as a Transfer-Net.
    Frame,
    /// The force map, as an end-to-end net.
    Map,
    /// The force map of a simulated frame, as a Recon-Net.
    ReconMap,
}

impl Regressed {
    /// Frames that the regression reads in training.
    pub(crate) fn frames(self) -> Frames {
        if self == Self::ReconMap { Frames::Simulated } else { Frames::Measured }
    }

    fn answer(self, side: Option<usize>) -> Answer {
        let quantity = match self {
            Self::Frame => return Answer::Frame,
            Self::Map | Self::ReconMap => return Answer::Map { side: side.unwrap_or_default() },
            Self::Position => Quantity::Position,
            Self::Pattern => Quantity::Pattern,
            Self::Count => Quantity::Count,
            Self::Force => Quantity::Force,
        };
        Answer::Quantity(quantity)
    }
}

/// Parameters of a ridge regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ridge {
    /// What it answers: a quantity, a frame, or a force map.
    pub answers: Regressed,
    /// Number of pixels along a side of the map; absent if it answers none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub side: Option<usize>,
    /// Normalisation of frames: standardised or robust.
    pub input: Input,
}

/// Parameters of a kernel ridge regression with the kernel `exp(-gamma |x - c|^2)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KernelRidge {
    /// What it answers: a quantity, a frame, or a force map.
    pub answers: Regressed,
    /// Number of pixels along a side of the map; absent if it answers none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub side: Option<usize>,
    /// Normalisation of frames: standardised or robust.
    pub input: Input,
    /// Largest number of training rows that are centres of the kernel, taken evenly; fewer for fine maps. Time
    /// grows with its cube.
    pub centres: usize,
}

impl Default for Ridge {
    fn default() -> Self {
        Self { answers: Regressed::Force, side: None, input: Input::Standardised }
    }
}

impl Default for KernelRidge {
    fn default() -> Self {
        let (answers, input) = (Regressed::Force, Input::Standardised);
        Self { answers, side: None, input, centres: 4000 }
    }
}

/// Checks that a normalisation scales each channel by itself, as the fit assumes, and that a map has a side.
fn check(answers: Regressed, side: Option<usize>, input: Input) -> Result<(), RecipeError> {
    let limit = "standardised or robust";
    require(input.scales_channels(), "net.input", format!("{input:?}"), limit)?;
    let is_map = matches!(answers, Regressed::Map | Regressed::ReconMap);
    let fits = side.map_or(!is_map, |side| is_map && (1..=SIDE_MAX).contains(&side));
    let found = side.map_or("none".to_owned(), |side| side.to_string());
    require(fits, "net.side", found, "1..160 for a map, and absent for other answers")
}

/// The layers around a regression: `middle` maps scaled frames to standardised targets.
fn network(
    (answers, side, input): (Regressed, Option<usize>, Input),
    statistics: &Statistics,
    target: usize,
    middle: impl IntoIterator<Item = Layer>,
) -> Network {
    let mut layers = input.layers(statistics);
    layers.extend(middle);
    // A pattern's answer is above zero where a place is pressed.
    let shift = if answers == Regressed::Pattern { -HALF } else { 0.0 };
    layers.push(statistics.in_units_of_targets(shift));
    // No true force of a map is negative.
    layers.extend(side.map(|_| Layer::Relu));
    let output = side.map_or(vec![target], |side| vec![side; 2]);
    Network { inputs: statistics.mean.len(), output, layers, form: Form::Plain }
}

fn dense(inputs: usize, outputs: usize) -> Layer {
    Layer::Dense { inputs, outputs, weight: vec![0.0; inputs * outputs], bias: vec![0.0; outputs] }
}

impl Architecture for Ridge {
    fn input(&self) -> Input {
        self.input
    }

    fn answer(&self) -> Answer {
        self.answers.answer(self.side)
    }

    fn check(&self) -> Result<(), RecipeError> {
        check(self.answers, self.side, self.input)
    }

    fn loss(&self, _: f32) -> Loss {
        Loss::MeanSquare { unit: 1.0 }
    }

    fn first(&self, statistics: &Statistics, target: usize, _: &mut Initial) -> Network {
        let channels = statistics.mean.len();
        let shape = (self.answers, self.side, self.input);
        network(shape, statistics, target, [dense(channels, target)])
    }

    fn closed_form(&self) -> Option<ClosedForm> {
        Some(ClosedForm::Ridge)
    }
}

impl Architecture for KernelRidge {
    fn input(&self) -> Input {
        self.input
    }

    fn answer(&self) -> Answer {
        self.answers.answer(self.side)
    }

    fn check(&self) -> Result<(), RecipeError> {
        check(self.answers, self.side, self.input)?;
        let limit = "10..20000: the kernel's matrix has its square";
        require((10..=20_000).contains(&self.centres), "net.centres", self.centres, limit)
    }

    fn loss(&self, _: f32) -> Loss {
        Loss::MeanSquare { unit: 1.0 }
    }

    /// Without centres: the rows that are centres are known after the fit.
    fn first(&self, statistics: &Statistics, target: usize, _: &mut Initial) -> Network {
        let channels = statistics.mean.len();
        let kernel = Layer::Kernel { inputs: channels, centres: Vec::new(), gamma: 1.0 };
        let shape = (self.answers, self.side, self.input);
        network(shape, statistics, target, [kernel, dense(0, target)])
    }

    fn closed_form(&self) -> Option<ClosedForm> {
        Some(ClosedForm::KernelRidge { centres: self.centres })
    }
}
