//! Settings of the optimiser in a recipe.
//! PURE. Uses: serde. Never: weights, a step (the trainer takes it).

use serde::{Deserialize, Serialize};

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
