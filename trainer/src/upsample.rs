//! Transposed convolution as one matrix product, kernel a multiple of the stride.
//! Uses: burn. Never: other layers.
//!
//! An output pixel is pixel `(py, px)` of a block of `stride x stride`; a kernel of `m` strides
//! spreads an input pixel over `m x m` blocks. The product determines the `m x m` blocks of every
//! input pixel; overlapping blocks are added.

use burn::tensor::Tensor;
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;

/// Shape of a transposed convolution.
#[derive(Clone, Copy)]
pub(crate) struct Shape {
    /// Batch, height, width of the input.
    pub image: [usize; 3],
    /// Number of output channels.
    pub outputs: usize,
    /// Side of the kernel, pixels, a multiple of the stride.
    pub kernel: usize,
    /// Stride, pixels.
    pub stride: usize,
    /// Number of pixels cut from each side.
    pub padding: usize,
}

/// For each column of the product, where its weight is in a row `[outputs][kernel][kernel]`.
/// Columns are `[block y][block x][py][px][output]`.
pub(crate) fn order(outputs: usize, kernel: usize, stride: usize) -> Vec<usize> {
    let blocks = kernel / stride;
    let mut order = Vec::with_capacity(outputs * kernel * kernel);
    for (by, bx) in pairs(blocks) {
        for (py, px) in pairs(stride) {
            let (ky, kx) = (by * stride + py, bx * stride + px);
            order.extend((0..outputs).map(|o| (o * kernel + ky) * kernel + kx));
        }
    }
    order
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |a| (0..n).map(move |b| (a, b)))
}

/// Maps rows of pixels to rows of pixels, and returns the new `[height, width]`. `weight` is
/// `[inputs, outputs kernel^2]` in [`order`].
pub(crate) fn conv_transpose(
    x: Tensor<2>,
    weight: Tensor<2>,
    shape: Shape,
) -> (Tensor<2>, [usize; 2]) {
    let Shape { image: [batch, height, width], outputs, kernel, stride, padding } = shape;
    let blocks = kernel / stride;
    let block = stride * stride * outputs;
    let product = x.matmul(weight).reshape([batch, height, width, blocks * blocks * block]);
    let [high, wide] = [height + blocks - 1, width + blocks - 1];
    let mut canvas: Option<Tensor<4>> = None;
    for (nth, (by, bx)) in pairs(blocks).enumerate() {
        let part = if blocks == 1 {
            product.clone()
        } else {
            let part = product.clone().slice_dim(3, nth * block..(nth + 1) * block);
            part.pad([(by, blocks - 1 - by), (bx, blocks - 1 - bx), (0, 0)], 0.0)
        };
        canvas = Some(match canvas {
            None => part,
            Some(sum) => sum + part,
        });
    }
    let canvas = canvas.expect("a kernel has at least one block");
    let pixels = canvas
        .reshape([batch, high, wide, stride, stride, outputs])
        .permute([0, 1, 3, 2, 4, 5])
        .reshape([batch, high * stride, wide * stride, outputs]);
    let [tall, broad] = [high * stride - 2 * padding, wide * stride - 2 * padding];
    // A slice of everything would copy its gradient into zeros.
    let cut = if padding == 0 {
        pixels
    } else {
        pixels.slice([0..batch, padding..padding + tall, padding..padding + broad, 0..outputs])
    };
    (cut.reshape([batch * tall * broad, outputs]), [tall, broad])
}

/// Convolution with an odd kernel that preserves height and width; `weight` is
/// `[inputs kernel^2, outputs]`, the taps of an input together.
pub(crate) fn conv(
    x: Tensor<2>,
    weight: Tensor<2>,
    [batch, height, width]: [usize; 3],
    kernel: usize,
) -> Tensor<2> {
    let ([_, inputs], [_, outputs]) = (x.dims(), weight.dims());
    let planes = x.reshape([batch, height, width, inputs]).permute([0, 3, 1, 2]);
    let weight = weight.swap_dims(0, 1).reshape([outputs, inputs, kernel, kernel]);
    let options = ConvOptions::new([1, 1], [kernel / 2, kernel / 2], [1, 1], 1);
    let planes = conv2d(planes, weight, None, options);
    planes.permute([0, 2, 3, 1]).reshape([batch * height * width, outputs])
}

/// From `channels r^2` to `channels`, each side `r` times as long (ONNX DepthToSpace, mode CRD).
pub(crate) fn shuffle(
    x: Tensor<2>,
    [batch, height, width]: [usize; 3],
    r: usize,
) -> (Tensor<2>, [usize; 2]) {
    let channels = x.dims()[1] / (r * r);
    let [tall, broad] = [height * r, width * r];
    let pixels = x.reshape([batch, height, width, channels, r, r]).permute([0, 1, 4, 2, 5, 3]);
    (pixels.reshape([batch * tall * broad, channels]), [tall, broad])
}
