//! A network as tensors: forward through burn, with gradients, and back to plain numbers.
//! Uses: burn, `network`, `upsample`. Never: losses, data, the order of training.
//!
//! An image is stored as rows of pixels, `[batch height width, channels]`: a convolution is then
//! one matrix product. Every parameter is a matrix.

use burn::tensor::{Device, Gradients, Tensor, TensorData, activation};
use nets::network::{Form, Layer, Network};

use crate::upsample;

/// Momentum of the running moments of a batch normalisation, PyTorch's.
const RUNNING: f64 = 0.1;

/// A network whose numbers are on a device.
pub(crate) struct Model {
    network: Network,
    /// Number of layers at the front that are not trained.
    fixed: usize,
    device: Device,
    /// For each layer its trained matrices: weight `[inputs, ..]` and bias `[1, ..]`.
    parameters: Vec<Vec<Tensor<2>>>,
    /// For each layer its matrices without gradients.
    constants: Vec<Vec<Tensor<2>>>,
}

/// Kind of a forward pass.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// Training: batch moments, no rectifier at the end.
    Learn,
    /// Validation: as in training, with running moments and without gradients.
    Judge,
    /// Inference: as the network is defined.
    Answer,
}

/// Rows, and the shape of the images of which they are pixels, `[height, width]`.
struct Rows {
    x: Tensor<2>,
    image: Option<[usize; 2]>,
}

impl Model {
    /// Puts a network on a device; its first `fixed` layers are not trained.
    pub fn new(network: Network, fixed: usize, device: &Device) -> Self {
        let mut model = Self {
            fixed,
            device: device.clone(),
            parameters: Vec::new(),
            constants: Vec::new(),
            network,
        };
        for (nth, layer) in model.network.layers.iter().enumerate() {
            let [trained, kept] = matrices(layer);
            let put = |(data, shape)| Tensor::<2>::from_data(TensorData::new(data, shape), device);
            let [trained, kept] = [trained, kept].map(|m| m.into_iter().map(put).collect());
            let learns = nth >= fixed;
            model.parameters.push(if learns { learn(trained) } else { trained });
            model.constants.push(kept);
        }
        model
    }

    /// Returns the network with its current numbers.
    pub fn network(&self) -> Network {
        let mut network = self.network.clone();
        let tensors = self.parameters.iter().zip(&self.constants);
        for ((nth, layer), (trained, kept)) in network.layers.iter_mut().enumerate().zip(tensors) {
            if nth < self.fixed {
                continue;
            }
            let read = |t: &Tensor<2>| {
                without_gradient(t).into_data().try_to_vec::<f32>().expect("parameters are f32")
            };
            let trained: Vec<_> = trained.iter().map(read).collect();
            set_matrices(layer, &trained, &kept.iter().map(read).collect::<Vec<_>>());
        }
        network
    }

    /// Shapes of all trained matrices, in order.
    pub fn shapes(&self) -> impl Iterator<Item = [usize; 2]> {
        self.parameters[self.fixed..].iter().flatten().map(Tensor::dims)
    }

    /// The gradients of all trained matrices, in order.
    pub fn gradients(&self, of: &mut Gradients) -> Vec<Tensor<2>> {
        let trained = self.parameters[self.fixed..].iter().flatten();
        trained.map(|p| p.grad_remove(of).expect("every parameter is in the loss")).collect()
    }

    /// Replaces all trained matrices, in order; they are passed and returned without gradients.
    pub fn move_parameters(&mut self, mut to: impl FnMut(Tensor<2>) -> Tensor<2>) {
        for parameters in &mut self.parameters[self.fixed..] {
            let old = std::mem::take(parameters).into_iter();
            *parameters = learn(old.map(|p| to(p.inner())).collect());
        }
    }

    /// Answers of frames while learning, with gradients.
    pub fn learn(&mut self, frames: Tensor<2>) -> Tensor<2> {
        let parameters = self.parameters.clone();
        self.forward(frames, &parameters, Pass::Learn)
    }

    /// Answers for the validation loss, without gradients.
    pub fn judge(&mut self, frames: Tensor<2>) -> Tensor<2> {
        let parameters = self.without_gradients();
        self.forward(frames, &parameters, Pass::Judge)
    }

    /// Answers as the network is defined.
    pub fn answer(&mut self, frames: Tensor<2>) -> Tensor<2> {
        let parameters = self.without_gradients();
        self.forward(frames, &parameters, Pass::Answer)
    }

    fn without_gradients(&self) -> Vec<Vec<Tensor<2>>> {
        self.parameters.iter().map(|p| p.iter().map(without_gradient).collect()).collect()
    }

    /// `frames` are `[batch, inputs]`, answers `[batch, numbers of an answer]`.
    fn forward(
        &mut self,
        frames: Tensor<2>,
        parameters: &[Vec<Tensor<2>>],
        pass: Pass,
    ) -> Tensor<2> {
        let [batch, _] = frames.dims();
        let mut rows = Rows { x: frames.clone(), image: None };
        for (nth, own) in parameters.iter().enumerate() {
            if nth == self.fixed && pass == Pass::Learn {
                rows.x = rows.x.autodiff();
            }
            let last = nth + 1 == self.network.layers.len();
            if last && pass != Pass::Answer && self.network.layers[nth] == Layer::Relu {
                break; // A rectifier at the end would stop the gradients of what it hides.
            }
            rows = self.layer(nth, rows, own, pass);
        }
        let answer = match rows.image {
            None => rows.x,
            Some([height, width]) => to_planes(rows.x, [batch, height, width]),
        };
        match self.network.form {
            Form::Plain => answer,
            Form::Residual { floor } => {
                let size = norm(&frames, floor);
                let [frames, size] = match pass {
                    Pass::Learn => [frames.autodiff(), size.autodiff()],
                    Pass::Judge | Pass::Answer => [frames, size],
                };
                frames + answer * size
            }
        }
    }

    fn layer(&mut self, nth: usize, rows: Rows, p: &[Tensor<2>], pass: Pass) -> Rows {
        let Rows { x, image } = rows;
        let c = &self.constants[nth];
        let x = match &self.network.layers[nth] {
            Layer::Dense { .. } => biased(x.matmul(p[0].clone()), p),
            Layer::Relu => activation::relu(x),
            Layer::Gelu => activation::gelu(x),
            Layer::Standardise { .. } => {
                let like_x =
                    |t: &Tensor<2>| if x.is_autodiff() { t.clone().autodiff() } else { t.clone() };
                let [mean, sd] = [&c[0], &c[1]].map(like_x);
                (x - mean) / sd
            }
            Layer::Scale { scale, shift } => {
                let scaled = if *scale == 1.0 { x } else { x.mul_scalar(*scale) };
                if *shift == 0.0 { scaled } else { scaled.add_scalar(*shift) }
            }
            Layer::Clip { limit } => x.clamp(-*limit, *limit),
            Layer::Kernel { gamma, .. } => {
                let square = (x.clone() * x.clone()).sum_dim(1);
                let apart = square + c[1].clone() - x.matmul(c[0].clone()).mul_scalar(2.0);
                apart.mul_scalar(-*gamma).exp()
            }
            Layer::UnitNorm { floor, log_scale } => {
                let size = norm(&x, *floor);
                let unit = x / size.clone();
                match log_scale {
                    None => unit,
                    Some(scale) => Tensor::cat(vec![unit, size.log().mul_scalar(*scale)], 1),
                }
            }
            Layer::Image { channels, height, width } => {
                let batch = x.dims()[0];
                let pixels = x.reshape([batch, *channels, height * width]).swap_dims(1, 2);
                let x = pixels.reshape([batch * height * width, *channels]);
                return Rows { x, image: Some([*height, *width]) };
            }
            Layer::ConvTranspose { outputs, kernel, stride, padding, .. } => {
                let [height, width] = image.expect("an image comes before a convolution");
                let shape = upsample::Shape {
                    image: [x.dims()[0] / (height * width), height, width],
                    outputs: *outputs,
                    kernel: *kernel,
                    stride: *stride,
                    padding: *padding,
                };
                let (x, image) = upsample::conv_transpose(x, p[0].clone(), shape);
                return Rows { x: biased(x, p), image: Some(image) };
            }
            Layer::Conv { kernel, .. } => {
                let [height, width] = image.expect("an image comes before a convolution");
                let shape = [x.dims()[0] / (height * width), height, width];
                biased(upsample::conv(x, p[0].clone(), shape, *kernel), p)
            }
            Layer::PixelShuffle { factor } => {
                let [height, width] = image.expect("an image comes before a shuffle");
                let shape = [x.dims()[0] / (height * width), height, width];
                let (x, image) = upsample::shuffle(x, shape, *factor);
                return Rows { x, image: Some(image) };
            }
            Layer::BatchNorm { epsilon, .. } => {
                let epsilon = *epsilon;
                self.batch_norm(nth, x, p, epsilon, pass)
            }
        };
        Rows { x, image }
    }

    /// Normalises channels by the batch's moments while training, and updates the running moments;
    /// otherwise by the running moments.
    fn batch_norm(
        &mut self,
        nth: usize,
        x: Tensor<2>,
        p: &[Tensor<2>],
        epsilon: f32,
        pass: Pass,
    ) -> Tensor<2> {
        let c = &mut self.constants[nth];
        let (mean, variance) = if pass == Pass::Learn {
            let rows = x.dims()[0] as f64;
            let mean = x.clone().mean_dim(0);
            let apart = x.clone() - mean.clone();
            let variance = (apart.clone() * apart).mean_dim(0);
            let unbiased = variance.clone().inner().mul_scalar(rows / (rows - 1.0).max(1.0));
            let follow = |old: &Tensor<2>, new: Tensor<2>| {
                old.clone().mul_scalar(1.0 - RUNNING) + new.mul_scalar(RUNNING)
            };
            *c = vec![follow(&c[0], mean.clone().inner()), follow(&c[1], unbiased)];
            (mean, variance)
        } else {
            (c[0].clone(), c[1].clone())
        };
        let factor = p[0].clone() / variance.add_scalar(epsilon).sqrt();
        (x - mean) * factor + p[1].clone()
    }

    /// The device of the tensors.
    pub fn device(&self) -> &Device {
        &self.device
    }
}

/// Adds the layer's bias, if it has one.
fn biased(x: Tensor<2>, p: &[Tensor<2>]) -> Tensor<2> {
    match p.get(1) {
        Some(bias) => x + bias.clone(),
        None => x,
    }
}

/// The same numbers, not followed by gradients.
fn without_gradient(t: &Tensor<2>) -> Tensor<2> {
    if t.is_autodiff() { t.clone().inner() } else { t.clone() }
}

/// Marks matrices as parameters with gradients.
pub(crate) fn learn(matrices: Vec<Tensor<2>>) -> Vec<Tensor<2>> {
    matrices.into_iter().map(|m| m.autodiff().require_grad()).collect()
}

/// Euclidean norm of each row, at least the floor, `[batch, 1]`.
pub(crate) fn norm(x: &Tensor<2>, floor: f32) -> Tensor<2> {
    (x.clone() * x.clone()).sum_dim(1).sqrt().clamp_min(floor)
}

/// Converts pixels to one row per image, channel by channel.
fn to_planes(x: Tensor<2>, [batch, height, width]: [usize; 3]) -> Tensor<2> {
    let channels = x.dims()[1];
    if channels == 1 {
        return x.reshape([batch, height * width]);
    }
    let planes = x.reshape([batch, height * width, channels]).swap_dims(1, 2);
    planes.reshape([batch, channels * height * width])
}

/// Numbers of a matrix, row-major, and its shape.
type Matrix = (Vec<f32>, [usize; 2]);

fn row(numbers: &[f32]) -> Matrix {
    (numbers.to_vec(), [1, numbers.len()])
}

/// A weight, and its bias if there is one.
fn weights(weight: Vec<f32>, shape: [usize; 2], bias: &[f32]) -> Vec<Matrix> {
    let bias = (!bias.is_empty()).then(|| row(bias));
    [(weight, shape)].into_iter().chain(bias).collect()
}

fn transposed(numbers: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
    let mut out = Vec::with_capacity(numbers.len());
    for column in 0..columns {
        out.extend((0..rows).map(|row| numbers[row * columns + column]));
    }
    out
}

/// A layer's trained and constant matrices, in the order in which [`Model::layer`] reads them.
fn matrices(layer: &Layer) -> [Vec<Matrix>; 2] {
    match layer {
        Layer::Dense { inputs, outputs, weight, bias } => {
            let weight = transposed(weight, [*outputs, *inputs]);
            [weights(weight, [*inputs, *outputs], bias), vec![]]
        }
        Layer::ConvTranspose { inputs, outputs, kernel, stride, weight, bias, .. } => {
            let order = upsample::order(*outputs, *kernel, *stride);
            let columns = order.len();
            let rows = weight.chunks_exact(columns);
            let weight = rows.flat_map(|row| order.iter().map(|&at| row[at])).collect();
            [weights(weight, [*inputs, columns], bias), vec![]]
        }
        Layer::BatchNorm { scale, shift, mean, variance, .. } => {
            [vec![row(scale), row(shift)], vec![row(mean), row(variance)]]
        }
        Layer::Conv { inputs, outputs, kernel, weight, bias } => {
            let taps = inputs * kernel * kernel;
            let weight = transposed(weight, [*outputs, taps]);
            [weights(weight, [taps, *outputs], bias), vec![]]
        }
        Layer::Standardise { mean, sd } => [vec![], vec![row(mean), row(sd)]],
        Layer::Kernel { inputs, centres, .. } => {
            let count = centres.len() / (*inputs).max(1);
            let square = |centre: &[f32]| centre.iter().map(|x| x * x).sum();
            let squares: Vec<f32> = centres.chunks_exact((*inputs).max(1)).map(square).collect();
            let centres = (transposed(centres, [count, *inputs]), [*inputs, count]);
            [vec![], vec![centres, row(&squares)]]
        }
        Layer::Relu
        | Layer::Gelu
        | Layer::Image { .. }
        | Layer::Scale { .. }
        | Layer::Clip { .. }
        | Layer::PixelShuffle { .. }
        | Layer::UnitNorm { .. } => [vec![], vec![]],
    }
}

fn set_bias(bias: &mut Vec<f32>, trained: &[Vec<f32>]) {
    if let Some(trained) = trained.get(1) {
        bias.clone_from(trained);
    }
}

/// Sets a layer's numbers from its matrices.
fn set_matrices(layer: &mut Layer, trained: &[Vec<f32>], kept: &[Vec<f32>]) {
    match layer {
        Layer::Dense { inputs, outputs, weight, bias } => {
            *weight = transposed(&trained[0], [*inputs, *outputs]);
            set_bias(bias, trained);
        }
        Layer::ConvTranspose { outputs, kernel, stride, weight, bias, .. } => {
            let order = upsample::order(*outputs, *kernel, *stride);
            let rows = weight.chunks_exact_mut(order.len());
            for (row, matrix) in rows.zip(trained[0].chunks_exact(order.len())) {
                for (&at, &x) in order.iter().zip(matrix) {
                    row[at] = x;
                }
            }
            set_bias(bias, trained);
        }
        Layer::Conv { inputs, outputs, kernel, weight, bias } => {
            *weight = transposed(&trained[0], [*inputs * *kernel * *kernel, *outputs]);
            set_bias(bias, trained);
        }
        Layer::BatchNorm { scale, shift, mean, variance, .. } => {
            scale.clone_from(&trained[0]);
            shift.clone_from(&trained[1]);
            mean.clone_from(&kept[0]);
            variance.clone_from(&kept[1]);
        }
        Layer::Relu
        | Layer::Gelu
        | Layer::Image { .. }
        | Layer::PixelShuffle { .. }
        | Layer::Standardise { .. }
        | Layer::Clip { .. }
        | Layer::Kernel { .. }
        | Layer::Scale { .. }
        | Layer::UnitNorm { .. } => {}
    }
}
