//! The recipe of a training: the net, its optimiser, its noise, its end. One TOML file.
//! PURE. Uses: serde. Never: data, weights.

use serde::{Deserialize, Serialize};

use crate::input::Input;
use crate::point_net::PointNet;
use crate::recon_net::ReconNet;
use crate::transfer_net::TransferNet;

/// Everything that determines the trained bytes, except for the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Seed of the first weights, the order of samples and the noise.
    pub seed: u64,
    /// Number of passes over the training data; for a stream, over its `len` samples.
    pub epochs: u32,
    /// Number of samples in a step.
    pub batch: usize,
    /// Number of epochs without a better validation loss after which training ends; `None`: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patience: Option<u32>,
    /// The net and its loss.
    pub net: Net,
    /// Optimiser of the weights.
    #[serde(default)]
    pub optimiser: Optimiser,
    /// Noise that is added to the inputs.
    #[serde(default)]
    pub noise: Noise,
}

/// The nets of the paper (V), and Point-Net.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Net {
    /// Real voltages to simulated ones (paper V-A).
    TransferNet(TransferNet),
    /// Simulated voltages to a force map (paper V-B).
    ReconNet(ReconNet),
    /// Real voltages to a force map (paper V-D): Recon-Net's layers on other data.
    EndToEnd(ReconNet),
    /// Voltages to presence and force at each point.
    PointNet(PointNet),
}

impl Net {
    /// Normalisation of its frames.
    pub fn input(&self) -> Input {
        match self {
            Self::TransferNet(net) => net.input(),
            Self::ReconNet(net) | Self::EndToEnd(net) => net.input,
            Self::PointNet(net) => net.input(),
        }
    }
}

/// Adam, as PyTorch defines it (Kingma and Ba 2015, algorithm 1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Optimiser {
    /// Step size at the start.
    pub learning_rate: f64,
    /// Decay of the mean gradient: the paper's "momentum of 0.7".
    pub beta1: f64,
    /// Decay of the mean squared gradient.
    pub beta2: f64,
    /// Added to the denominator, which keeps the quotient finite.
    pub epsilon: f64,
    /// Step size during the training.
    pub schedule: Schedule,
}

impl Default for Optimiser {
    /// The paper's values (V-A), and PyTorch's defaults for the others.
    fn default() -> Self {
        let schedule = Schedule::Constant;
        Self { learning_rate: 1e-3, beta1: 0.7, beta2: 0.999, epsilon: 1e-8, schedule }
    }
}

/// Step size as a function of the step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Schedule {
    /// The same in every step.
    Constant,
    /// Half a cosine, from the first step size to zero at the end of the last epoch.
    Cosine,
}

impl Optimiser {
    /// Step size of a step, from 0, of `steps` steps in total.
    pub fn rate(&self, step: u64, steps: u64) -> f64 {
        match self.schedule {
            Schedule::Constant => self.learning_rate,
            Schedule::Cosine => {
                let done = step as f64 / steps as f64;
                self.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * done).cos())
            }
        }
    }
}

/// Gaussian noise on every channel, redrawn in each epoch (paper V-C).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Factor on each channel's standard deviation, which the plan states: the paper's 0, 0.1, 0.5.
    pub level: f64,
    /// Additional standard deviation of all channels, V: the readout's white noise.
    pub white_v: f64,
}

/// Why a recipe is invalid: the field, its value, its limit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecipeError {
    /// The text is not TOML, or does not have these fields.
    #[error("recipe: {0}")]
    Text(#[from] toml::de::Error),
    /// A value is outside its limits.
    #[error("recipe: {field} is {found}, must be {limit}")]
    Value {
        /// Dotted path of the field.
        field: &'static str,
        /// Value of the field, as text.
        found: String,
        /// Allowed values.
        limit: &'static str,
    },
}

/// Largest number of weights between two layers: with gradients and Adam's moments 4 GB.
pub(crate) const WEIGHTS_MAX: usize = 1 << 28;

/// Returns an error for a value unless a condition holds.
pub(crate) fn require(
    holds: bool,
    field: &'static str,
    found: impl ToString,
    limit: &'static str,
) -> Result<(), RecipeError> {
    let found = || found.to_string();
    if holds { Ok(()) } else { Err(RecipeError::Value { field, found: found(), limit }) }
}

impl Recipe {
    /// Reads and checks a recipe.
    ///
    /// # Errors
    /// `RecipeError::Text` if the text is not a recipe; `RecipeError::Value` if a value is outside
    /// its limits.
    pub fn from_toml(text: &str) -> Result<Self, RecipeError> {
        let recipe: Self = toml::from_str(text)?;
        recipe.check()?;
        Ok(recipe)
    }

    /// Returns the recipe as TOML, including every default.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a recipe is plain numbers and names")
    }

    /// Checks the limits of all values.
    ///
    /// # Errors
    /// `RecipeError::Value` with the first value outside its limits.
    pub fn check(&self) -> Result<(), RecipeError> {
        let Optimiser { learning_rate, beta1, beta2, epsilon, .. } = self.optimiser;
        let share = |x: f64| (0.0..1.0).contains(&x);
        require(self.seed <= i64::MAX as u64, "seed", self.seed, "below 2^63, the limit of TOML")?;
        require(self.epochs > 0, "epochs", self.epochs, "at least 1")?;
        require((1..=1 << 16).contains(&self.batch), "batch", self.batch, "1..65536")?;
        require(self.patience != Some(0), "patience", 0, "at least 1")?;
        let good = learning_rate.is_finite() && learning_rate > 0.0;
        require(good, "optimiser.learning_rate", learning_rate, "above 0")?;
        require(share(beta1), "optimiser.beta1", beta1, "0 <= beta1 < 1")?;
        require(share(beta2), "optimiser.beta2", beta2, "0 <= beta2 < 1")?;
        require(epsilon.is_finite() && epsilon > 0.0, "optimiser.epsilon", epsilon, "above 0")?;
        let Noise { level, white_v } = self.noise;
        require(level.is_finite() && level >= 0.0, "noise.level", level, "at least 0")?;
        require(white_v.is_finite() && white_v >= 0.0, "noise.white_v", white_v, "at least 0")?;
        match &self.net {
            Net::TransferNet(net) => net.check(),
            Net::ReconNet(net) | Net::EndToEnd(net) => net.check(),
            Net::PointNet(net) => net.check(),
        }
    }
}
