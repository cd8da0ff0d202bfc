//! A net as plain numbers: what is trained, written as ONNX, and read back to go on training.
//! Never: burn, files.

/// A step of a net. Tensors are row-major, a batch first.
#[derive(Debug, Clone, PartialEq)]
pub enum Layer {
    /// `y = W x + b`.
    Dense {
        /// Length of x.
        inputs: usize,
        /// Length of y.
        outputs: usize,
        /// W, `[outputs][inputs]`, as PyTorch keeps it.
        weight: Vec<f32>,
        /// b.
        bias: Vec<f32>,
    },
    /// `max(0, x)`.
    Relu,
    /// `x Phi(x)`, with the error function.
    Gelu,
    /// `scale (x - mean) / sqrt(variance + epsilon) + shift` in each channel, with the moments that
    /// training left.
    BatchNorm {
        /// Factor, per channel.
        scale: Vec<f32>,
        /// Term, per channel.
        shift: Vec<f32>,
        /// Mean, per channel.
        mean: Vec<f32>,
        /// Variance, per channel.
        variance: Vec<f32>,
        /// Keeps the root away from zero.
        epsilon: f32,
    },
    /// From a vector to `[channels][height][width]`.
    Image {
        /// Channels.
        channels: usize,
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
    },
    /// Transposed convolution in two dimensions, the same along both.
    ConvTranspose {
        /// Channels in.
        inputs: usize,
        /// Channels out.
        outputs: usize,
        /// Side of the kernel.
        kernel: usize,
        /// Stride.
        stride: usize,
        /// Padding.
        padding: usize,
        /// `[inputs][outputs][kernel][kernel]`, as PyTorch keeps it.
        weight: Vec<f32>,
        /// Per channel out; empty where there is none.
        bias: Vec<f32>,
    },
    /// Convolution in two dimensions that keeps height and width (stride 1, padding kernel / 2).
    Conv {
        /// Channels in.
        inputs: usize,
        /// Channels out.
        outputs: usize,
        /// Side of the kernel, odd.
        kernel: usize,
        /// `[outputs][inputs][kernel][kernel]`.
        weight: Vec<f32>,
        /// Per channel out; empty where there is none.
        bias: Vec<f32>,
    },
    /// From `[channels r^2][height][width]` to `[channels][height r][width r]` (ONNX DepthToSpace,
    /// mode CRD; PyTorch's PixelShuffle).
    PixelShuffle {
        /// r.
        factor: usize,
    },
    /// `(x - mean) / sd`, per number.
    Standardise {
        /// Mean.
        mean: Vec<f32>,
        /// Standard deviation, > 0.
        sd: Vec<f32>,
    },
    /// `x scale + shift`, one number each for all.
    Scale {
        /// Factor.
        scale: f32,
        /// Term.
        shift: f32,
    },
    /// `x / max(|x|, floor)`, Euclidean; with `log`, one more number: `ln max(|x|, floor)`, times
    /// `log_scale`.
    UnitNorm {
        /// Smallest norm that is divided by.
        floor: f32,
        /// Factor on the logarithm of the norm that is appended; `None` appends none.
        log_scale: Option<f32>,
    },
}

/// How a net's steps become its answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// The last step's result.
    Plain,
    /// `x + max(|x|, floor) times the last step's result`: what differs from the input, in units of
    /// its size.
    Residual {
        /// Smallest norm that is multiplied with.
        floor: f32,
    },
}

/// A net, from frames to what it was trained for, with normalisation inside.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Numbers in.
    pub inputs: usize,
    /// Shape of one answer: `[784]`, `[160, 160]`, `[2, 804]`.
    pub output: Vec<usize>,
    /// Steps.
    pub layers: Vec<Layer>,
    /// What is made of the last one.
    pub form: Form,
}

impl Network {
    /// Shows every number of every layer to `see`, in one order for all networks of a shape.
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
                Layer::Relu
                | Layer::Gelu
                | Layer::Image { .. }
                | Layer::PixelShuffle { .. }
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
    pub(crate) fn set_numbers(&mut self, numbers: &[f32]) {
        let mut numbers = numbers;
        self.each_number(&mut |x| {
            let (these, rest) = numbers.split_at(x.len());
            x.copy_from_slice(these);
            numbers = rest;
        });
    }

    /// Factor of the last [`Layer::Scale`]: the size of what the net was trained to answer.
    pub(crate) fn target_size(&self) -> f32 {
        let scale = |layer: &Layer| match layer {
            Layer::Scale { scale, .. } => Some(*scale),
            _ => None,
        };
        self.layers.iter().rev().find_map(scale).unwrap_or(1.0)
    }

    /// The layers without their numbers: two networks of a shape have the same.
    pub fn shape(&self) -> Network {
        let mut shape = self.clone();
        shape.each_number(&mut |x| x.fill(0.0));
        shape
    }
}
