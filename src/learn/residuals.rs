//! What a Transfer-Net leaves over, kept beside its model.
//! PURE. Never: how it is measured (`train`).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a Transfer-Net leaves over on trials that it did not learn from (paper, Fig. 10A).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Residuals {
    /// Mean of each channel, V.
    pub mean_v: Vec<f32>,
    /// Standard deviation of each channel, V.
    pub sd_v: Vec<f32>,
    /// Trials that they are of.
    pub trials: u64,
}
