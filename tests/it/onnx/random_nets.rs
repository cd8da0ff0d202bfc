//! Nets of random weights, one for each that Palpate trains, drawn from a seed: what ONNX files are
//! compared and timed with.
//! Uses: nets' plain numbers. Never: training.

use nets::network::{Form, Layer, Network};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Channels and points of the sensor of 28 electrodes.
pub const CHANNELS: usize = 784;
const POINTS: usize = 804;
/// Smallest norm that is divided by, V.
const FLOOR_V: f32 = 1e-4;

/// A source of weights.
pub struct Draw(ChaCha8Rng);

impl Draw {
    /// The source of this seed.
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Numbers from `low` to `high`.
    pub fn numbers(&mut self, count: usize, low: f32, high: f32) -> Vec<f32> {
        (0..count).map(|_| self.0.random_range(low..high)).collect()
    }

    /// Frames whose sizes lie decades apart, V.
    pub fn frames(&mut self, count: usize, channels: usize) -> Vec<f32> {
        let decade = |frame: usize| [0.05, 3e-5, 0.5, 2e-3][frame % 4];
        let frames = (0..count).map(|frame| self.numbers(channels, -decade(frame), decade(frame)));
        frames.collect::<Vec<_>>().concat()
    }

    /// Weights that keep the size of what goes through them.
    pub fn weights(&mut self, count: usize, inputs: usize) -> Vec<f32> {
        let bound = (6.0 / inputs as f32).sqrt();
        self.numbers(count, -bound, bound)
    }

    pub fn dense(&mut self, inputs: usize, outputs: usize) -> Layer {
        let weight = self.weights(inputs * outputs, inputs);
        Layer::Dense { inputs, outputs, weight, bias: self.numbers(outputs, -0.1, 0.1) }
    }

    /// A batch norm that is far from doing nothing.
    pub fn batch_norm(&mut self, channels: usize) -> Layer {
        Layer::BatchNorm {
            scale: self.numbers(channels, 0.5, 1.5),
            shift: self.numbers(channels, -0.2, 0.2),
            mean: self.numbers(channels, -0.2, 0.2),
            variance: self.numbers(channels, 0.3, 2.0),
            epsilon: 1e-5,
        }
    }

    /// Doubles height and width.
    pub fn up(&mut self, inputs: usize, outputs: usize) -> Layer {
        let weight = self.weights(inputs * outputs * 16, inputs * 4);
        let bias = self.numbers(outputs, -0.1, 0.1);
        Layer::ConvTranspose { inputs, outputs, kernel: 4, stride: 2, padding: 1, weight, bias }
    }
}

/// A net of these layers.
pub fn net(inputs: usize, output: &[usize], layers: Vec<Layer>, form: Form) -> Network {
    Network { inputs, output: output.to_vec(), layers, form }
}

/// Transfer-Net as published: five hidden layers of 784, ReLU.
pub fn transfer(draw: &mut Draw) -> Network {
    let n = CHANNELS;
    let hidden = (0..5).flat_map(|_| [draw.dense(n, n), Layer::Relu]).collect();
    let layers = [hidden, vec![draw.dense(n, n)]].concat();
    net(n, &[n], layers, Form::Plain)
}

/// Transfer-Net in its residual form.
pub fn transfer_residual(draw: &mut Draw) -> Network {
    let n = CHANNELS;
    let mut layers = vec![Layer::UnitNorm { floor: FLOOR_V, log_scale: Some(0.1) }];
    layers.extend([draw.dense(n + 1, n), Layer::Relu]);
    layers.extend((0..4).flat_map(|_| [draw.dense(n, n), Layer::Relu]));
    layers.extend([draw.dense(n, n), Layer::Scale { scale: 0.1, shift: 0.0 }]);
    net(n, &[n], layers, Form::Residual { floor: FLOOR_V })
}

/// Recon-Net to a map of `side` x `side`, 160, 64 or 32.
pub fn recon(draw: &mut Draw, side: usize) -> Network {
    let start = if side == 160 { 10 } else { 4 };
    let doublings = (side / start).ilog2() as usize;
    let mean = draw.numbers(CHANNELS, -1e-3, 1e-3);
    let mut layers = vec![
        Layer::Standardise { mean, sd: draw.numbers(CHANNELS, 0.01, 0.1) },
        draw.dense(CHANNELS, 128 * start * start),
        Layer::Image { channels: 128, height: start, width: start },
        draw.batch_norm(128),
        Layer::Relu,
    ];
    let mut channels = 128;
    for doubling in 1..=doublings {
        let last = doubling == doublings;
        let next = if last { 1 } else { channels / 2 };
        layers.push(draw.up(channels, next));
        if !last {
            layers.extend([draw.batch_norm(next), Layer::Relu]);
        }
        channels = next;
    }
    net(CHANNELS, &[side, side], layers, Form::Plain)
}

/// Point-Net: three hidden layers of 1024, GELU, presence and log-force of each point.
pub fn points(draw: &mut Draw) -> Network {
    let unit = Layer::UnitNorm { floor: FLOOR_V, log_scale: Some(1.0) };
    let mut layers = vec![unit, draw.dense(CHANNELS + 1, 1024), Layer::Gelu];
    layers.extend((0..2).flat_map(|_| [draw.dense(1024, 1024), Layer::Gelu]));
    layers.push(draw.dense(1024, 2 * POINTS));
    net(CHANNELS, &[2, POINTS], layers, Form::Plain)
}

/// Every net that Palpate trains.
pub fn architectures(draw: &mut Draw) -> Vec<(&'static str, Network)> {
    vec![
        ("transfer", transfer(draw)),
        ("transfer-residual", transfer_residual(draw)),
        ("recon-160", recon(draw, 160)),
        ("recon-64", recon(draw, 64)),
        ("recon-32", recon(draw, 32)),
        ("points", points(draw)),
    ]
}
