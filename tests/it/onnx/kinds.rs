//! A small net of random weights around each kind of layer.
//! Uses: nets' plain numbers. Never: training.

use nets::network::{Form, Layer, Network};

use super::random_nets::{Draw, net};

/// A convolution.
pub fn conv(draw: &mut Draw, inputs: usize, outputs: usize, kernel: usize, bias: bool) -> Layer {
    let weight = draw.weights(inputs * outputs * kernel * kernel, inputs * kernel * kernel);
    let bias = draw.numbers(if bias { outputs } else { 0 }, -0.1, 0.1);
    Layer::Conv { inputs, outputs, kernel, weight, bias }
}

/// Likeness to five centres.
fn near(draw: &mut Draw) -> Layer {
    Layer::Kernel { inputs: 12, centres: draw.numbers(5 * 12, -0.1, 0.1), gamma: 40.0 }
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
        ("conv", plain(&[5, 2, 2], vec![image(), conv(draw, 3, 5, 3, true)])),
        ("conv-wide", plain(&[2, 2, 2], vec![image(), conv(draw, 3, 2, 5, false)])),
        (
            "pixel-shuffle",
            plain(
                &[2, 4, 4],
                vec![image(), conv(draw, 3, 8, 1, true), Layer::PixelShuffle { factor: 2 }],
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
        ("kernel", plain(&[5], vec![near(draw)])),
        ("clip", plain(&[12], vec![Layer::Clip { limit: 0.04 }])),
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
        Layer::Kernel { .. } => 11,
        Layer::Clip { .. } => 12,
    }
}

/// Kinds of layers that there are.
pub const KINDS: usize = 13;
