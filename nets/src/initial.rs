//! First weights: uniform within `gain / sqrt(fan in)`, as PyTorch draws them for gain 1.
//! PURE. Never: other generators.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::chance::{Purpose, generator};
use crate::network::Layer;

/// Gain before a rectifier; preserves the size of activations through many layers (He et al. 2015).
pub const RECTIFIED: f32 = 2.449_49; // sqrt(6)
/// PyTorch's default gain.
pub const LINEAR: f32 = 1.0;

/// Draws the weights of one layer after another.
pub struct Initial {
    chance: ChaCha8Rng,
}

impl Initial {
    /// Starts the generator of a seed.
    pub fn new(seed: u64) -> Self {
        Self { chance: generator(seed, Purpose::Weights, 0, 0) }
    }

    fn uniform(&mut self, bound: f32, len: usize) -> Vec<f32> {
        (0..len).map(|_| self.chance.random_range(-bound..=bound)).collect()
    }

    /// Draws a dense layer with biases of zero.
    pub fn dense(&mut self, inputs: usize, outputs: usize, gain: f32) -> Layer {
        let weight = self.uniform(gain / (inputs as f32).sqrt(), inputs * outputs);
        Layer::Dense { inputs, outputs, weight, bias: vec![0.0; outputs] }
    }

    /// Draws a transposed convolution that doubles height and width: kernel 2 or 4.
    pub fn twice(&mut self, inputs: usize, outputs: usize, kernel: usize, gain: f32) -> Layer {
        let (stride, padding) = (2, (kernel - 2) / 2);
        let taps = kernel / stride; // Along each side, of an output's pixel.
        let bound = gain / ((inputs * taps * taps) as f32).sqrt();
        let weight = self.uniform(bound, inputs * outputs * kernel * kernel);
        let bias = vec![0.0; outputs];
        Layer::ConvTranspose { inputs, outputs, kernel, stride, padding, weight, bias }
    }

    /// Draws a convolution that preserves height and width.
    pub fn conv(&mut self, inputs: usize, outputs: usize, kernel: usize, gain: f32) -> Layer {
        let bound = gain / ((inputs * kernel * kernel) as f32).sqrt();
        let weight = self.uniform(bound, inputs * outputs * kernel * kernel);
        Layer::Conv { inputs, outputs, kernel, weight, bias: vec![0.0; outputs] }
    }
}
