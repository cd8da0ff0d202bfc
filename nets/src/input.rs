//! Normalisation of frames: the layers at the front of a net, measured once and not trained.
//! PURE. Uses: `statistics`. Never: training.

use serde::{Deserialize, Serialize};

use crate::network::{Layer, NORM_FLOOR_V};
use crate::statistics::Statistics;

/// Normalisation of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Each channel to mean 0 and standard deviation 1.
    Standardised,
    /// `sqrt(channels) v / |v|`: the pattern of a touch, independent of its force.
    Unit,
    /// `v / |v|` to its first principal components, each of variance 1, and `ln |v|`
    /// standardised: the best of five (`docs/references.md`, "Feasibility study").
    Whitened {
        /// Number of components; at most the number of channels.
        components: usize,
    },
}

impl Input {
    /// Number of layers of a normalisation.
    pub const LAYERS: usize = 2;

    /// Number of principal components that must be measured, if any.
    pub fn components(self) -> Option<usize> {
        match self {
            Self::Standardised | Self::Unit => None,
            Self::Whitened { components } => Some(components),
        }
    }

    /// Number of outputs for `channels` inputs.
    pub fn width(self, channels: usize) -> usize {
        match self {
            Self::Standardised | Self::Unit => channels,
            Self::Whitened { components } => components.min(channels) + 1,
        }
    }

    /// The layers, [`Input::LAYERS`] of them.
    pub fn layers(self, statistics: &Statistics) -> Vec<Layer> {
        let channels = statistics.mean.len();
        match self {
            Self::Standardised => {
                let (mean, sd) = (statistics.mean.clone(), statistics.sd.clone());
                vec![Layer::Standardise { mean, sd }, Layer::Scale { scale: 1.0, shift: 0.0 }]
            }
            Self::Unit => vec![
                Layer::UnitNorm { floor: NORM_FLOOR_V, log_scale: None },
                Layer::Scale { scale: (channels as f32).sqrt(), shift: 0.0 },
            ],
            Self::Whitened { .. } => {
                let (weight, bias) = statistics.whitening.clone();
                vec![
                    Layer::UnitNorm { floor: NORM_FLOOR_V, log_scale: Some(1.0) },
                    Layer::Dense { inputs: channels + 1, outputs: bias.len(), weight, bias },
                ]
            }
        }
    }
}
