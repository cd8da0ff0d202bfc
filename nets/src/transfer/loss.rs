//! The loss of Transfer-Net's residual form: light touches count as much as heavy ones.
//! Uses: burn. Never: data.

use burn::tensor::Tensor;

use crate::loss::Loss;
use crate::model::norm;
use crate::network::NORM_FLOOR_V;

/// `|p - y|^2 / |y|^2`.
pub(crate) struct Relative;

impl Loss for Relative {
    fn value(&self, answers: Tensor<2>, targets: Tensor<2>) -> Tensor<1> {
        let size = norm(&targets.clone().detach(), NORM_FLOOR_V);
        let apart = (answers - targets) / size;
        let batch = apart.dims()[0] as f64;
        (apart.clone() * apart).sum().div_scalar(batch)
    }
}
