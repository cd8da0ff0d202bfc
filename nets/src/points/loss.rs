//! The loss of Point-Net: presence at all points, force at the pressed ones.
//! Uses: burn. Never: data.

use burn::tensor::{Tensor, activation};

use crate::loss::Loss;

/// Targets are the force at each point, N, 0 without contact. Binary cross entropy of presence
/// summed over points, and the weighted squared error of `ln` force summed over the pressed
/// points.
pub(crate) struct PresenceAndForce {
    /// Weight of the second sum.
    pub force_weight: f64,
}

impl Loss for PresenceAndForce {
    fn value(&self, answers: Tensor<2>, forces: Tensor<2>) -> Tensor<1> {
        let [batch, points] = forces.dims();
        let logits = answers.clone().slice([0..batch, 0..points]);
        let log_forces = answers.slice([0..batch, points..2 * points]);
        let pressed = forces.clone().sign();
        // Without contact the logarithm is ln 1 and has no weight.
        let true_logs = (forces + pressed.clone().neg().add_scalar(1.0)).log();
        // ln(1 + e^z) - z t, without overflow.
        let log_one_more =
            activation::relu(logits.clone()) + logits.clone().abs().neg().exp().log1p();
        let entropy = (log_one_more - logits * pressed.clone()).sum();
        let apart = (log_forces - true_logs) * pressed;
        let force = (apart.clone() * apart).sum().mul_scalar(self.force_weight);
        (entropy + force).div_scalar(batch as f64)
    }
}
