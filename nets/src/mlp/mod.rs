//! A multilayer perceptron from measured voltages to a quantity: position, pattern, count or force.
//! PURE. Uses: the shared parts. Never: data.

use serde::{Deserialize, Serialize};

use crate::architecture::{Answer, Architecture};
use crate::error::{RecipeError, require};
use crate::initial::{Initial, LINEAR};
use crate::input::Input;
use crate::loss::Loss;
use crate::network::{Form, Layer, Network, WEIGHTS_MAX};
use crate::quantity::Quantity;
use crate::statistics::Statistics;

/// Parameters of a perceptron.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mlp {
    /// Quantity that it answers.
    pub answers: Quantity,
    /// Normalisation of frames.
    pub input: Input,
    /// Number of hidden layers.
    pub hidden: usize,
    /// Number of neurons of a hidden layer.
    pub width: usize,
}

impl Default for Mlp {
    fn default() -> Self {
        Self { answers: Quantity::Force, input: Input::Standardised, hidden: 2, width: 256 }
    }
}

impl Architecture for Mlp {
    fn input(&self) -> Input {
        self.input
    }

    fn answer(&self) -> Answer {
        Answer::Quantity(self.answers)
    }

    fn check(&self) -> Result<(), RecipeError> {
        require((1..=64).contains(&self.hidden), "net.hidden", self.hidden, "1..64")?;
        require((1..=1 << 14).contains(&self.width), "net.width", self.width, "1..16384")?;
        let weights = self.hidden * self.width * self.width;
        require(weights <= WEIGHTS_MAX, "net.hidden x net.width^2", weights, "at most 2^28")
    }

    fn loss(&self, _: f32) -> Loss {
        match self.answers {
            Quantity::Pattern => Loss::Presence,
            Quantity::Position | Quantity::Count | Quantity::Force => {
                Loss::MeanSquare { unit: 1.0 }
            }
        }
    }

    fn first(&self, statistics: &Statistics, target: usize, initial: &mut Initial) -> Network {
        let channels = statistics.mean.len();
        let mut layers = self.input.layers(statistics);
        let mut inputs = self.input.width(channels);
        for _ in 0..self.hidden {
            layers.extend([initial.dense(inputs, self.width, LINEAR), Layer::Gelu]);
            inputs = self.width;
        }
        layers.push(initial.dense(inputs, target, LINEAR));
        // Logits of a pattern have no unit.
        if self.answers != Quantity::Pattern {
            layers.push(statistics.in_units_of_targets(0.0));
        }
        Network { inputs: channels, output: vec![target], layers, form: Form::Plain }
    }
}
