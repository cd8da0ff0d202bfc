//! Normalisation of frames: the layers at the front of a net, measured once and not trained.
//! PURE. Uses: `statistics`. Never: training.

use serde::{Deserialize, Serialize};

use crate::network::{Layer, NORM_FLOOR_V};
use crate::statistics::{Measured, Statistics};

/// Largest absolute value of a channel of a robust input.
const ROBUST_LIMIT: f32 = 10.0;

/// Normalisation of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Each channel to mean 0 and standard deviation 1.
    Standardised,
    /// Each channel to median 0 and, without its extremes, standard deviation 1, then clipped to 10 of
    /// these: faults in few rows neither scale the other rows down nor have a large effect.
    Robust,
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

    /// What must be measured of the frames.
    pub fn measured(self) -> Measured {
        match self {
            Self::Standardised | Self::Unit => Measured::Moments,
            Self::Robust => Measured::WithoutExtremes,
            Self::Whitened { components } => Measured::Components(components),
        }
    }

    /// Whether each channel is scaled by itself, so that one without information is ignored.
    pub fn scales_channels(self) -> bool {
        matches!(self, Self::Standardised | Self::Robust)
    }

    /// Largest absolute value of a scaled channel, if it is limited.
    pub fn limit(self) -> Option<f32> {
        (self == Self::Robust).then_some(ROBUST_LIMIT)
    }

    /// Number of outputs for `channels` inputs.
    pub fn width(self, channels: usize) -> usize {
        match self {
            Self::Standardised | Self::Robust | Self::Unit => channels,
            Self::Whitened { components } => components.min(channels) + 1,
        }
    }

    /// The layers, [`Input::LAYERS`] of them.
    pub fn layers(self, statistics: &Statistics) -> Vec<Layer> {
        let channels = statistics.mean.len();
        match self {
            Self::Standardised | Self::Robust => {
                let (mean, sd) = (statistics.mean.clone(), statistics.sd.clone());
                let second = match self.limit() {
                    Some(limit) => Layer::Clip { limit },
                    None => Layer::Scale { scale: 1.0, shift: 0.0 },
                };
                vec![Layer::Standardise { mean, sd }, second]
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
