//! Nets of random weights, one for each kind of layer and one for each that Palpate trains, drawn
//! from a seed: what ONNX files are compared and timed with.
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
    fn weights(&mut self, count: usize, inputs: usize) -> Vec<f32> {
        let bound = (6.0 / inputs as f32).sqrt();
        self.numbers(count, -bound, bound)
    }

    pub fn dense(&mut self, inputs: usize, outputs: usize) -> Layer {
        let weight = self.weights(inputs * outputs, inputs);
        Layer::Dense { inputs, outputs, weight, bias: self.numbers(outputs, -0.1, 0.1) }
    }

    fn batch_norm(&mut self, channels: usize) -> Layer {
        Layer::BatchNorm {
            scale: self.numbers(channels, 0.5, 1.5),
            shift: self.numbers(channels, -0.2, 0.2),
            mean: self.numbers(channels, -0.2, 0.2),
            variance: self.numbers(channels, 0.3, 2.0),
            epsilon: 1e-5,
        }
    }

    /// Doubles height and width.
    fn up(&mut self, inputs: usize, outputs: usize) -> Layer {
        let weight = self.weights(inputs * outputs * 16, inputs * 4);
        let bias = self.numbers(outputs, -0.1, 0.1);
        Layer::ConvTranspose { inputs, outputs, kernel: 4, stride: 2, padding: 1, weight, bias }
    }

    fn conv(&mut self, inputs: usize, outputs: usize, kernel: usize, bias: bool) -> Layer {
        let weight = self.weights(inputs * outputs * kernel * kernel, inputs * kernel * kernel);
        let bias = self.numbers(if bias { outputs } else { 0 }, -0.1, 0.1);
        Layer::Conv { inputs, outputs, kernel, weight, bias }
    }
}

fn net(inputs: usize, output: &[usize], layers: Vec<Layer>, form: Form) -> Network {
    Network { inputs, output: output.to_vec(), layers, form }
}

/// A small net around each kind of layer.
pub fn kinds(draw: &mut Draw) -> Vec<(&'static str, Network)> {
    let plain = |output: &[usize], layers| net(12, output, layers, Form::Plain);
    let image = || Layer::Image { channels: 3, height: 2, width: 2 };
    let unit = |log_scale| Layer::UnitNorm { floor: 1e-3, log_scale };
    let (mean, sd) = (draw.numbers(12, -0.1, 0.1), draw.numbers(12, 0.1, 2.0));
    let kernel = draw.weights(3 * 5 * 9, 27);
    let odd = Layer::ConvTranspose {
        inputs: 3,
        outputs: 5,
        kernel: 3,
        stride: 1,
        padding: 1,
        weight: kernel,
        bias: vec![],
    };
    vec![
        ("dense", plain(&[7], vec![draw.dense(12, 7)])),
        ("relu", plain(&[12], vec![Layer::Relu])),
        ("gelu", plain(&[12], vec![Layer::Scale { scale: 40.0, shift: 0.0 }, Layer::Gelu])),
        ("batch-norm", plain(&[12], vec![draw.batch_norm(12)])),
        ("batch-norm-image", plain(&[3, 2, 2], vec![image(), draw.batch_norm(3)])),
        ("image", plain(&[3, 2, 2], vec![image()])),
        ("conv-transpose", plain(&[4, 4], vec![image(), draw.up(3, 1)])),
        ("conv-transpose-odd", plain(&[5, 2, 2], vec![image(), odd])),
        ("conv", plain(&[5, 2, 2], vec![image(), draw.conv(3, 5, 3, true)])),
        ("conv-wide", plain(&[2, 2, 2], vec![image(), draw.conv(3, 2, 5, false)])),
        (
            "pixel-shuffle",
            plain(
                &[2, 4, 4],
                vec![image(), draw.conv(3, 8, 1, true), Layer::PixelShuffle { factor: 2 }],
            ),
        ),
        ("standardise", plain(&[12], vec![Layer::Standardise { mean, sd }])),
        ("scale", plain(&[12], vec![Layer::Scale { scale: 30.0, shift: -0.25 }])),
        ("unit-norm", plain(&[12], vec![unit(None)])),
        ("unit-norm-log", plain(&[13], vec![unit(Some(0.1))])),
        ("nothing", plain(&[12], vec![])),
        (
            "residual",
            net(
                12,
                &[12],
                vec![unit(Some(0.1)), draw.dense(13, 12)],
                Form::Residual { floor: 1e-3 },
            ),
        ),
    ]
}

/// Which kind a layer is, so that a kind of layer without a net above is missed.
pub fn kind_index(layer: &Layer) -> usize {
    match layer {
        Layer::Dense { .. } => 0,
        Layer::Relu => 1,
        Layer::Gelu => 2,
        Layer::BatchNorm { .. } => 3,
        Layer::Image { .. } => 4,
        Layer::ConvTranspose { .. } => 5,
        Layer::Conv { .. } => 6,
        Layer::PixelShuffle { .. } => 7,
        Layer::Standardise { .. } => 8,
        Layer::Scale { .. } => 9,
        Layer::UnitNorm { .. } => 10,
    }
}

/// Kinds of layers that there are.
pub const KINDS: usize = 11;

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
