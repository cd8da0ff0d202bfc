//! Losses that nets minimise, each a mean over the batch, and the one that several nets share.
//! Uses: burn. Never: data, nets.

use burn::tensor::Tensor;

/// A loss on answers and targets, `[batch, numbers]` each.
pub(crate) trait Loss {
    /// The minimised value, one number.
    fn value(&self, answers: Tensor<2>, targets: Tensor<2>) -> Tensor<1>;

    /// Converts a minimised value to the loss in its own unit.
    fn in_units(&self, minimised: f64) -> f64 {
        minimised
    }
}

/// Mean of `(p - y)^2` over all numbers: V^2 of Transfer-Net, N^2 of Recon-Net.
pub(crate) struct MeanSquare {
    /// Size of targets, by which the minimised loss is scaled, so that Adam's epsilon stays small
    /// compared with gradients.
    pub unit: f32,
}

impl Loss for MeanSquare {
    fn value(&self, answers: Tensor<2>, targets: Tensor<2>) -> Tensor<1> {
        let apart = (answers - targets).mul_scalar(1.0 / self.unit);
        (apart.clone() * apart).mean()
    }

    fn in_units(&self, minimised: f64) -> f64 {
        minimised * f64::from(self.unit).powi(2)
    }
}
