//! The losses that nets minimise. Each is a mean over the batch.
//! Uses: burn. Never: data, nets.

use burn::tensor::{Tensor, activation};

use crate::input::NORM_FLOOR_V;
use crate::model::norm;
use crate::recipe::Net;
use crate::transfer_net::TransferForm;

/// A loss on answers and targets, `[batch, numbers]` each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Loss {
    /// Mean of `(p - y)^2` over all numbers: V^2 of Transfer-Net, N^2 of Recon-Net.
    MeanSquare {
        /// Size of targets, by which the minimised loss is scaled, so that Adam's epsilon stays
        /// small compared with gradients.
        unit: f32,
    },
    /// `|p - y|^2 / |y|^2`.
    Relative,
    /// Targets are the force at each point, N, 0 without contact. Binary cross entropy of presence
    /// summed over points, and the weighted squared error of `ln` force summed over the pressed
    /// points.
    Points {
        /// Weight of the second sum.
        force_weight: f64,
    },
}

impl Loss {
    /// The loss of a net; `target_size` is the root mean square of its targets.
    pub fn of(net: &Net, target_size: f32) -> Self {
        match net {
            Net::TransferNet(net) if net.form == TransferForm::Residual => Self::Relative,
            Net::TransferNet(_) | Net::ReconNet(_) | Net::EndToEnd(_) => {
                Self::MeanSquare { unit: target_size }
            }
            Net::PointNet(net) => Self::Points { force_weight: net.force_weight },
        }
    }

    /// The minimised value, one number.
    pub fn value(self, answers: Tensor<2>, targets: Tensor<2>) -> Tensor<1> {
        match self {
            Self::MeanSquare { unit } => {
                let apart = (answers - targets).mul_scalar(1.0 / unit);
                (apart.clone() * apart).mean()
            }
            Self::Relative => {
                let size = norm(&targets.clone().detach(), NORM_FLOOR_V);
                let apart = (answers - targets) / size;
                let batch = apart.dims()[0] as f64;
                (apart.clone() * apart).sum().div_scalar(batch)
            }
            Self::Points { force_weight } => points(answers, targets, force_weight),
        }
    }

    /// Converts a minimised value to the loss in its own unit.
    pub fn in_units(self, minimised: f64) -> f64 {
        match self {
            Self::MeanSquare { unit } => minimised * f64::from(unit).powi(2),
            Self::Relative | Self::Points { .. } => minimised,
        }
    }
}

fn points(answers: Tensor<2>, forces: Tensor<2>, force_weight: f64) -> Tensor<1> {
    let [batch, points] = forces.dims();
    let logits = answers.clone().slice([0..batch, 0..points]);
    let log_forces = answers.slice([0..batch, points..2 * points]);
    let pressed = forces.clone().sign();
    // Without contact the logarithm is ln 1 and has no weight.
    let true_logs = (forces + pressed.clone().neg().add_scalar(1.0)).log();
    // ln(1 + e^z) - z t, without overflow.
    let log_one_more = activation::relu(logits.clone()) + logits.clone().abs().neg().exp().log1p();
    let entropy = (log_one_more - logits * pressed.clone()).sum();
    let apart = (log_forces - true_logs) * pressed;
    let force = (apart.clone() * apart).sum().mul_scalar(force_weight);
    (entropy + force).div_scalar(batch as f64)
}
