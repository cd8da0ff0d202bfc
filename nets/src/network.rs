//! A net as plain numbers: the form that is trained, written as ONNX, and read back.
//! PURE. Never: files.

/// Lower limit of the norm that divides a frame, V: that of readout noise of 36 uV, so that the
/// frame of an untouched skin stays small instead of being scaled to one.
pub const NORM_FLOOR_V: f32 = 1e-3;

/// Largest number of weights between two layers: with gradients and Adam's moments 4 GB.
pub(crate) const WEIGHTS_MAX: usize = 1 << 28;

/// A layer of a net. Tensors are row-major, batch first.
#[derive(Debug, Clone, PartialEq)]
pub enum Layer {
    /// `y = W x + b`.
    Dense {
        /// Length of x.
        inputs: usize,
        /// Length of y.
        outputs: usize,
        /// W, `[outputs][inputs]`, as PyTorch stores it.
        weight: Vec<f32>,
        /// Offsets b, `[outputs]`.
        bias: Vec<f32>,
    },
    /// `max(0, x)`.
    Relu,
    /// `x Phi(x)`, with the error function.
    Gelu,
    /// `scale (x - mean) / sqrt(variance + epsilon) + shift` in each channel, with the moments of
    /// the training.
    BatchNorm {
        /// Factor, per channel.
        scale: Vec<f32>,
        /// Term, per channel.
        shift: Vec<f32>,
        /// Mean, per channel.
        mean: Vec<f32>,
        /// Variance, per channel.
        variance: Vec<f32>,
        /// Added to the variance, so that the root is not zero.
        epsilon: f32,
    },
    /// Reshapes a vector to `[channels][height][width]`.
    Image {
        /// Number of channels.
        channels: usize,
        /// Number of rows.
        height: usize,
        /// Number of columns.
        width: usize,
    },
    /// Transposed convolution in two dimensions, the same along both.
    ConvTranspose {
        /// Number of input channels.
        inputs: usize,
        /// Number of output channels.
        outputs: usize,
        /// Side of the kernel, pixels.
        kernel: usize,
        /// Stride, pixels.
        stride: usize,
        /// Padding, pixels.
        padding: usize,
        /// `[inputs][outputs][kernel][kernel]`, as PyTorch stores it.
        weight: Vec<f32>,
        /// One per output channel; empty without a bias.
        bias: Vec<f32>,
    },
    /// Convolution in two dimensions that preserves height and width (stride 1, padding kernel /
    /// 2).
    Conv {
        /// Number of input channels.
        inputs: usize,
        /// Number of output channels.
        outputs: usize,
        /// Side of the kernel, pixels, odd.
        kernel: usize,
        /// `[outputs][inputs][kernel][kernel]`.
        weight: Vec<f32>,
        /// One per output channel; empty without a bias.
        bias: Vec<f32>,
    },
    /// From `[channels r^2][height][width]` to `[channels][height r][width r]` (ONNX DepthToSpace,
    /// mode CRD; PyTorch's PixelShuffle).
    PixelShuffle {
        /// r, the factor of height and width.
        factor: usize,
    },
    /// `(x - mean) / sd`, per number.
    Standardise {
        /// Mean, per number.
        mean: Vec<f32>,
        /// Standard deviation, per number, > 0.
        sd: Vec<f32>,
    },
    /// `min(max(x, -limit), limit)`, for each number.
    Clip {
        /// Largest absolute value, > 0.
        limit: f32,
    },
    /// `exp(-gamma |x - c|^2)` for each centre c.
    Kernel {
        /// Length of x.
        inputs: usize,
        /// Centres, `[centres][inputs]`.
        centres: Vec<f32>,
        /// Factor gamma on the squared distance, > 0.
        gamma: f32,
    },
    /// `x scale + shift`, one number each for all.
    Scale {
        /// Factor on every number.
        scale: f32,
        /// Term added to every number.
        shift: f32,
    },
    /// `x / max(|x|, floor)`, Euclidean; with `log_scale`, one further number:
    /// `log_scale ln max(|x|, floor)`.
    UnitNorm {
        /// Lower limit of the norm in the quotient.
        floor: f32,
        /// Factor on the logarithm of the norm that is appended; `None` appends none.
        log_scale: Option<f32>,
    },
}

/// Relation of a net's answer to its last layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// The result of the last layer.
    Plain,
    /// `x + max(|x|, floor) r` with the result r of the last layer: the difference from the input,
    /// in units of its norm.
    Residual {
        /// Lower limit of the norm in the product.
        floor: f32,
    },
}

/// A net, from frames to answers, with the normalisation included.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Length of an input.
    pub inputs: usize,
    /// Shape of one answer: `[784]`, `[160, 160]`, `[2, 804]`.
    pub output: Vec<usize>,
    /// Layers in order.
    pub layers: Vec<Layer>,
    /// Relation of the answer to the last layer.
    pub form: Form,
}

impl Network {
    /// Passes every number of every layer to `see`, in the same order for all networks of a shape.
    pub fn each_number(&mut self, see: &mut dyn FnMut(&mut [f32])) {
        for layer in &mut self.layers {
            match layer {
                Layer::Dense { weight, bias, .. }
                | Layer::ConvTranspose { weight, bias, .. }
                | Layer::Conv { weight, bias, .. } => {
                    [weight, bias].into_iter().for_each(|x| see(x))
                }
                Layer::BatchNorm { scale, shift, mean, variance, .. } => {
                    [scale, shift, mean, variance].into_iter().for_each(|x| see(x))
                }
                Layer::Standardise { mean, sd } => [mean, sd].into_iter().for_each(|x| see(x)),
                Layer::Scale { scale, shift } => {
                    [scale, shift].into_iter().for_each(|x| see(std::slice::from_mut(x)))
                }
                Layer::Kernel { centres, gamma, .. } => {
                    see(centres);
                    see(std::slice::from_mut(gamma));
                }
                Layer::Relu
                | Layer::Gelu
                | Layer::Image { .. }
                | Layer::PixelShuffle { .. }
                | Layer::Clip { .. }
                | Layer::UnitNorm { .. } => {}
            }
        }
    }

    /// Every number, in that order.
    pub fn numbers(&self) -> Vec<f32> {
        let mut numbers = Vec::new();
        self.clone().each_number(&mut |x| numbers.extend_from_slice(x));
        numbers
    }

    /// Sets every number, in that order.
    ///
    /// # Panics
    /// If there are fewer numbers than the network has.
    pub fn set_numbers(&mut self, numbers: &[f32]) {
        let mut numbers = numbers;
        self.each_number(&mut |x| {
            let (these, rest) = numbers.split_at(x.len());
            x.copy_from_slice(these);
            numbers = rest;
        });
    }

    /// Factor of the last [`Layer::Scale`]: the size of the targets in training.
    pub fn target_size(&self) -> f32 {
        let scale = |layer: &Layer| match layer {
            Layer::Scale { scale, .. } => Some(*scale),
            _ => None,
        };
        self.layers.iter().rev().find_map(scale).unwrap_or(1.0)
    }
}
