//! Recon-Net (paper V-B): voltages to a force map, newtons per pixel. The paper's layers are not
//! public; these are the project's: a dense layer draws a small image with many channels, and
//! transposed convolutions double its sides until it has the size of the map.
//! PURE. Uses: the shared parts. Never: data.

use serde::{Deserialize, Serialize};

use crate::architecture::{Answer, Architecture};
use crate::error::{RecipeError, require};
use crate::initial::{Initial, LINEAR, RECTIFIED};
use crate::input::Input;
use crate::loss::Loss;
use crate::network::{Form, Layer, Network, WEIGHTS_MAX};
use crate::statistics::Statistics;

/// Number of inputs that the size check of a net without a hidden layer assumes: the paper's
/// sensor.
const TYPICAL_INPUTS: usize = 784;

/// Largest number of weights between two channels: a kernel of 3 that produces four pixels.
const LARGEST_KERNEL: usize = 36;

/// Parameters of a Recon-Net. It is trained without a bound; the trained net ends in a rectifier,
/// which can only decrease the error, since no true force is negative.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReconNet {
    /// Number of pixels along a side of the map: 160, 64 or 32 in the paper.
    pub side: usize,
    /// Normalisation of frames.
    pub input: Input,
    /// Number of neurons of a dense rectified layer between input and first image; 0: no such
    /// layer.
    pub hidden: usize,
    /// Channels of the first image and of each following one, except for the map itself. The side
    /// of the first image is the map's over two to the power of their number.
    pub channels: Vec<usize>,
    /// Layers that double an image's sides.
    pub upsampling: Upsampling,
    /// Whether channels are normalised over the batch after each layer.
    pub batch_norm: bool,
}

/// Kinds of layers that double the sides of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Upsampling {
    /// Transposed convolution, kernel 2: a pixel becomes four, without overlap.
    Apart,
    /// Transposed convolution, kernel 4: the results of neighbouring pixels overlap.
    Overlapping,
    /// Convolution, kernel 3, to four times the channels, which become four pixels.
    Shuffled,
}

impl Default for ReconNet {
    fn default() -> Self {
        Self {
            side: 160,
            input: Input::Whitened { components: 100 },
            hidden: 0,
            channels: vec![128, 64, 32, 16],
            upsampling: Upsampling::Overlapping,
            batch_norm: false,
        }
    }
}

impl ReconNet {
    /// Side of the first image.
    fn first_side(&self) -> usize {
        self.side >> self.channels.len()
    }
}

impl Architecture for ReconNet {
    fn input(&self) -> Input {
        self.input
    }

    fn answer(&self) -> Answer {
        Answer::Map { side: self.side }
    }

    fn check(&self) -> Result<(), RecipeError> {
        let few = (1..=10).contains(&self.channels.len());
        require(few, "net.channels", self.channels.len(), "a list of 1 to 10")?;
        let sizes = self.channels.iter().all(|c| (1..=4096).contains(c));
        require(sizes, "net.channels", format!("{:?}", self.channels), "numbers of 1..4096")?;
        let whole = (1..=1024).contains(&self.side)
            && self.first_side() << self.channels.len() == self.side;
        let limit = "1..1024 and a multiple of two to the power of the number of channels";
        require(whole, "net.side", self.side, limit)?;
        require(self.hidden <= 1 << 14, "net.hidden", self.hidden, "at most 16384")?;
        let first = self.channels[0] * self.first_side() * self.first_side();
        let inputs = if self.hidden > 0 { self.hidden } else { TYPICAL_INPUTS };
        let doubling = self.channels.windows(2).map(|two| LARGEST_KERNEL * two[0] * two[1]);
        let weights = inputs * first + doubling.sum::<usize>();
        require(weights <= WEIGHTS_MAX, "weights", weights, "at most 2^28: fewer net.channels")
    }

    fn loss(&self, target_size: f32) -> Loss {
        Loss::MeanSquare { unit: target_size }
    }

    fn first(&self, statistics: &Statistics, _: usize, initial: &mut Initial) -> Network {
        let inputs = statistics.mean.len();
        let mut layers = self.input.layers(statistics);
        let mut width = self.input.width(inputs);
        if self.hidden > 0 {
            layers.extend([initial.dense(width, self.hidden, RECTIFIED), Layer::Relu]);
            width = self.hidden;
        }
        let side = self.first_side();
        let mut channels = self.channels[0];
        layers.push(initial.dense(width, channels * side * side, RECTIFIED));
        layers.push(Layer::Image { channels, height: side, width: side });
        let normalise = |channels: usize| {
            self.batch_norm.then(|| Layer::BatchNorm {
                scale: vec![1.0; channels],
                shift: vec![0.0; channels],
                mean: vec![0.0; channels],
                variance: vec![1.0; channels],
                epsilon: 1e-5,
            })
        };
        for &next in &self.channels[1..] {
            layers.extend(normalise(channels));
            layers.push(Layer::Relu);
            let mut up = self.upsampling.layers(channels, next, RECTIFIED, initial);
            if self.batch_norm {
                forget_bias(&mut up[0]);
            }
            layers.extend(up);
            channels = next;
        }
        layers.extend(normalise(channels));
        layers.push(Layer::Relu);
        layers.extend(self.upsampling.layers(channels, 1, LINEAR, initial));
        layers.push(Layer::Scale { scale: statistics.target_size, shift: 0.0 });
        layers.push(Layer::Relu);
        Network { inputs, output: vec![self.side, self.side], layers, form: Form::Plain }
    }
}

/// Removes a bias that a batch normalisation would cancel.
fn forget_bias(layer: &mut Layer) {
    if let Layer::ConvTranspose { bias, .. } | Layer::Conv { bias, .. } = layer {
        bias.clear();
    }
}

impl Upsampling {
    fn layers(self, inputs: usize, outputs: usize, gain: f32, initial: &mut Initial) -> Vec<Layer> {
        match self {
            Self::Apart => vec![initial.twice(inputs, outputs, 2, gain)],
            Self::Overlapping => vec![initial.twice(inputs, outputs, 4, gain)],
            Self::Shuffled => {
                let conv = initial.conv(inputs, 4 * outputs, 3, gain);
                vec![conv, Layer::PixelShuffle { factor: 2 }]
            }
        }
    }
}
