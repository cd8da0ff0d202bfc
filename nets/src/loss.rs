//! Losses that nets minimise, each a mean over the batch, as plain values; the trainer has their form as
//! tensors.
//! PURE. Never: data, nets, tensors.

/// A loss on answers p and targets y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Mean of `(p - y)^2` over all numbers: V^2 of Transfer-Net, N^2 of Recon-Net.
    MeanSquare {
        /// Size of targets, by which the minimised loss is scaled, so that Adam's epsilon stays small
        /// compared with gradients.
        unit: f32,
    },
    /// `|p - y|^2 / |y|^2`: light touches count as much as heavy ones.
    Relative,
    /// Targets are 1 at the pressed places, 0 at others; answers are logits. Binary cross entropy, mean
    /// over places.
    Presence,
    /// Targets are the force at each point, N, 0 without contact. Binary cross entropy of presence
    /// summed over points, and the weighted squared error of `ln` force summed over the pressed points.
    PresenceAndForce {
        /// Weight of the second sum.
        force_weight: f64,
    },
}

impl Loss {
    /// Converts a minimised value to the loss in its own unit.
    pub fn in_units(self, minimised: f64) -> f64 {
        match self {
            Self::MeanSquare { unit } => minimised * f64::from(unit).powi(2),
            Self::Relative | Self::Presence | Self::PresenceAndForce { .. } => minimised,
        }
    }
}
