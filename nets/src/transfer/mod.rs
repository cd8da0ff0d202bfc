//! Transfer-Net (paper V-A): real voltages to simulated ones, five hidden layers of rectified
//! neurons, as many as channels.
//! PURE. Uses: the shared parts. Never: data.

use serde::{Deserialize, Serialize};

use crate::architecture::{Answer, Architecture};
use crate::error::{RecipeError, require};
use crate::initial::{Initial, LINEAR};
use crate::input::Input;
use crate::loss::Loss;
use crate::network::{Form, Layer, NORM_FLOOR_V, Network, WEIGHTS_MAX};
use crate::statistics::Statistics;

/// Parameters of a Transfer-Net.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransferNet {
    /// Relation of its answer to the input, and its loss.
    pub form: TransferForm,
    /// Number of hidden layers.
    pub hidden: usize,
    /// Number of neurons of a hidden layer; 0: the number of channels.
    pub width: usize,
}

/// Forms of the net's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TransferForm {
    /// As published: channels standardised, answers in volts, mean squared error.
    Plain,
    /// `y = v + |v| net(v / |v|)` with the loss `|p - y|^2 / |y|^2`: light touches count as much
    /// as heavy ones (`docs/references.md`, "Feasibility study").
    Residual,
}

impl Default for TransferNet {
    fn default() -> Self {
        Self { form: TransferForm::Plain, hidden: 5, width: 0 }
    }
}

impl Architecture for TransferNet {
    fn input(&self) -> Input {
        match self.form {
            TransferForm::Plain => Input::Standardised,
            TransferForm::Residual => Input::Unit,
        }
    }

    fn answer(&self) -> Answer {
        Answer::Frame
    }

    fn check(&self) -> Result<(), RecipeError> {
        require((1..=64).contains(&self.hidden), "net.hidden", self.hidden, "1..64")?;
        require(self.width <= 1 << 14, "net.width", self.width, "at most 16384")?;
        let weights = self.hidden * self.width * self.width;
        require(weights <= WEIGHTS_MAX, "net.hidden x net.width^2", weights, "at most 2^28")
    }

    fn loss(&self, target_size: f32) -> Loss {
        match self.form {
            TransferForm::Plain => Loss::MeanSquare { unit: target_size },
            TransferForm::Residual => Loss::Relative,
        }
    }

    fn first(&self, statistics: &Statistics, _: usize, initial: &mut Initial) -> Network {
        let channels = statistics.mean.len();
        let width = if self.width == 0 { channels } else { self.width };
        let mut layers = self.input().layers(statistics);
        let mut inputs = channels;
        for _ in 0..self.hidden {
            layers.extend([initial.dense(inputs, width, LINEAR), Layer::Relu]);
            inputs = width;
        }
        layers.push(initial.dense(inputs, channels, LINEAR));
        let (scale, form) = match self.form {
            TransferForm::Plain => (statistics.target_size, Form::Plain),
            TransferForm::Residual => {
                (1.0 / (channels as f32).sqrt(), Form::Residual { floor: NORM_FLOOR_V })
            }
        };
        layers.push(Layer::Scale { scale, shift: 0.0 });
        Network { inputs: channels, output: vec![channels], layers, form }
    }
}
