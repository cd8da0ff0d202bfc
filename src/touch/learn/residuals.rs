//! Residuals of a Transfer-Net, stored with its model.
//! PURE. Never: their measurement (the trainer).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Residuals of a Transfer-Net on trials that were not used to train it (paper, Fig. 10A).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Residuals {
    /// Mean of each channel, V.
    pub mean_v: Vec<f32>,
    /// Standard deviation of each channel, V.
    pub sd_v: Vec<f32>,
    /// Number of trials.
    pub trials: u64,
}
