//! Merges a batch norm into the layer before it: the same function with fewer operations.
//! PURE. Uses: a net as plain numbers. Never: a change of a net whose tensors do not match (the
//! writer reports the mismatch).
//!
//! `scale (W x + b - mean) / sqrt(variance + epsilon) + shift` is `W' x + b'` with, for each
//! channel, `g = scale / sqrt(variance + epsilon)`, `W' = g W`, `b' = g (b - mean) + shift`. In
//! tract a batch norm of eight images costs as much as a transposed convolution.

use nets::network::Layer;

/// The layers without the batch norms that follow a dense layer (straight, or as an image), a
/// convolution or a transposed convolution.
pub(super) fn folded(layers: &[Layer]) -> Vec<Layer> {
    let mut kept: Vec<Layer> = Vec::with_capacity(layers.len());
    for layer in layers {
        if !norm_of(layer).is_some_and(|norm| fold_into(&mut kept, &norm)) {
            kept.push(layer.clone());
        }
    }
    kept
}

/// For each channel, the factor and the term of a batch norm: `y = factor x + term`.
fn norm_of(layer: &Layer) -> Option<Vec<(f64, f64)>> {
    let Layer::BatchNorm { scale, shift, mean, variance, epsilon } = layer else { return None };
    let channels = scale.len();
    if [shift.len(), mean.len(), variance.len()] != [channels; 3] {
        return None;
    }
    let norm = (0..channels).map(|c| {
        let deviation = (f64::from(variance[c]) + f64::from(*epsilon)).sqrt();
        let factor = f64::from(scale[c]) / deviation;
        (factor, f64::from(shift[c]) - factor * f64::from(mean[c]))
    });
    Some(norm.collect())
}

/// Merges a norm into the last layer; returns whether that was possible.
fn fold_into(layers: &mut [Layer], norm: &[(f64, f64)]) -> bool {
    let channels = norm.len();
    match layers {
        [.., Layer::Dense { outputs, weight, bias, .. }] if *outputs == channels => {
            rows(weight, bias, norm, 1)
        }
        [
            ..,
            Layer::Dense { outputs, weight, bias, .. },
            Layer::Image { channels: images, height, width },
        ] if *images == channels && *outputs == channels * *height * *width => {
            rows(weight, bias, norm, *height * *width)
        }
        [.., Layer::Conv { outputs, weight, bias, .. }] if *outputs == channels => {
            bias.resize(channels, 0.0);
            rows(weight, bias, norm, 1)
        }
        [.., Layer::ConvTranspose { inputs, outputs, kernel, weight, bias, .. }]
            if *outputs == channels && weight.len() == *inputs * channels * *kernel * *kernel =>
        {
            bias.resize(channels, 0.0);
            let square = *kernel * *kernel;
            for (row, numbers) in weight.chunks_exact_mut(square).enumerate() {
                let (factor, _) = norm[row % channels];
                numbers.iter_mut().for_each(|w| *w = (f64::from(*w) * factor) as f32);
            }
            terms(bias, norm, 1)
        }
        _ => false,
    }
}

/// Scales a weight `[rows][..]` and a bias `[rows]` with `each` rows per channel.
fn rows(weight: &mut [f32], bias: &mut [f32], norm: &[(f64, f64)], each: usize) -> bool {
    let rows = norm.len() * each;
    if rows == 0 || bias.len() != rows || !weight.len().is_multiple_of(rows) {
        return false;
    }
    let length = weight.len() / rows;
    for (row, numbers) in weight.chunks_exact_mut(length.max(1)).enumerate() {
        let (factor, _) = norm[row / each];
        numbers.iter_mut().for_each(|w| *w = (f64::from(*w) * factor) as f32);
    }
    terms(bias, norm, each)
}

fn terms(bias: &mut [f32], norm: &[(f64, f64)], each: usize) -> bool {
    for (row, b) in bias.iter_mut().enumerate() {
        let (factor, term) = norm[row / each];
        *b = (f64::from(*b) * factor + term) as f32;
    }
    true
}
