//! Products and factors of small dense matrices, row-major.
//! PURE. Uses: nothing of the crate. Never: what the numbers are.

/// Rows are padded to a multiple of this length.
pub(super) const PAD: usize = 8;

/// Inner product as four independent sums, which a processor adds in parallel.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_tail), (b, b_tail)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let tail: f64 = a_tail.iter().zip(b_tail).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + tail
}

/// Cholesky factor of a row-major lower triangle. `false` if it is not positive definite.
pub(super) fn cholesky(lower: &[f64], size: usize, factor: &mut Vec<f64>) -> bool {
    factor.clear();
    factor.extend_from_slice(&lower[..size * size]);
    for i in 0..size {
        for j in 0..=i {
            let (row_i, row_j) = (&factor[i * size..][..j], &factor[j * size..][..j]);
            let sum = factor[i * size + j] - dot(row_i, row_j);
            if i != j {
                factor[i * size + j] = sum / factor[j * size + j];
            } else if sum > 0.0 {
                factor[i * size + i] = sum.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// Solves with a factor of [`cholesky`], in place.
pub(super) fn solve(factor: &[f64], size: usize, x: &mut [f64]) {
    for i in 0..size {
        let sum = x[i] - dot(&factor[i * size..][..i], &x[..i]);
        x[i] = sum / factor[i * size + i];
    }
    for i in (0..size).rev() {
        x[i] /= factor[i * size + i];
        let value = x[i];
        for (x, f) in x[..i].iter_mut().zip(&factor[i * size..]) {
            *x -= f * value;
        }
    }
}
