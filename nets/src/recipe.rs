//! The recipe of a training: the net, its optimiser, its noise, its end. One TOML file.
//! PURE. Uses: serde. Never: data, weights.

use serde::{Deserialize, Serialize};

use crate::error::{RecipeError, require};
use crate::initial::Initial;
use crate::net::Net;
use crate::network::Network;
use crate::noise::Noise;
use crate::optimiser::Optimiser;
use crate::statistics::Statistics;

/// Everything that determines the trained bytes, except for the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Seed of the first weights, the order of samples and the noise.
    pub seed: u64,
    /// Number of passes over the training data; for a stream, over its `len` samples. Nets that are
    /// fitted in closed form use neither this nor `batch`.
    #[serde(default = "one")]
    pub epochs: u32,
    /// Number of samples in a step.
    #[serde(default = "usual_batch")]
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

fn one() -> u32 {
    1
}

fn usual_batch() -> usize {
    64
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

    /// The net before the first step; `target` is the length of a target.
    pub fn first(&self, statistics: &Statistics, target: usize) -> Network {
        self.net.architecture().first(statistics, target, &mut Initial::new(self.seed))
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
        self.net.architecture().check()
    }
}
