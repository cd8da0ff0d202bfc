//! The losses of nets as tensors, `[batch, numbers]` of answers and targets to one number.
//! Uses: burn. Never: data.

use burn::tensor::{Tensor, activation};
use nets::loss::Loss;
use nets::network::NORM_FLOOR_V;

use crate::model::norm;

/// The minimised value, one number.
pub(crate) fn value(loss: Loss, answers: Tensor<2>, targets: Tensor<2>) -> Tensor<1> {
    match loss {
        Loss::MeanSquare { unit } => {
            let apart = (answers - targets).mul_scalar(1.0 / unit);
            (apart.clone() * apart).mean()
        }
        Loss::Relative => {
            let size = norm(&targets.clone().detach(), NORM_FLOOR_V);
            let apart = (answers - targets) / size;
            let batch = apart.dims()[0] as f64;
            (apart.clone() * apart).sum().div_scalar(batch)
        }
        Loss::Presence => entropy(answers, targets).mean(),
        Loss::PresenceAndForce { force_weight } => {
            presence_and_force(answers, targets, force_weight)
        }
    }
}

/// Binary cross entropy of each logit z and target t: `ln(1 + e^z) - z t`, without overflow.
fn entropy(logits: Tensor<2>, targets: Tensor<2>) -> Tensor<2> {
    let log_one_more = activation::relu(logits.clone()) + logits.clone().abs().neg().exp().log1p();
    log_one_more - logits * targets
}

fn presence_and_force(answers: Tensor<2>, forces: Tensor<2>, force_weight: f64) -> Tensor<1> {
    let [batch, points] = forces.dims();
    let logits = answers.clone().slice([0..batch, 0..points]);
    let log_forces = answers.slice([0..batch, points..2 * points]);
    let pressed = forces.clone().sign();
    // Without contact the logarithm is ln 1 and has no weight.
    let true_logs = (forces + pressed.clone().neg().add_scalar(1.0)).log();
    let entropy = entropy(logits, pressed.clone()).sum();
    let apart = (log_forces - true_logs) * pressed;
    let force = (apart.clone() * apart).sum().mul_scalar(force_weight);
    (entropy + force).div_scalar(batch as f64)
}
