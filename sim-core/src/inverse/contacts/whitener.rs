//! Whitening of projected frames: numbers whose errors are correlated become numbers with independent errors of
//! variance 1, so that a fit is a sum of squares.
//! PURE. Uses: `dense`. Never: what the errors come from.

use super::dense::{PAD, cholesky, dot};

/// The linear map that makes a covariance the identity.
#[derive(Debug, Clone, Default)]
pub(super) struct Whitener {
    /// Number of rows, a multiple of [`PAD`].
    width: usize,
    /// Inverse of the covariance's Cholesky factor: row-major, zeros above the diagonal.
    inverse: Vec<f64>,
    factor: Vec<f64>,
}

impl Whitener {
    /// Takes a positive definite covariance, `width` rows of which the lower triangle is read.
    pub fn set(&mut self, covariance: &[f64], width: usize) {
        self.width = width;
        self.inverse.clear();
        self.inverse.resize(width * width, 0.0);
        if !cholesky(covariance, width, &mut self.factor) {
            // Rounding, if the variances differ by all digits of a number: without the correlations.
            for i in 0..width {
                self.inverse[i * width + i] = 1.0 / covariance[i * width + i].sqrt();
            }
            return;
        }
        for i in 0..width {
            let (done, rest) = self.inverse.split_at_mut(i * width);
            let (row, factor) = (&mut rest[..width], &self.factor[i * width..][..=i]);
            for (k, before) in done.chunks_exact(width).enumerate() {
                let share = factor[k];
                row[..=k].iter_mut().zip(&before[..=k]).for_each(|(r, b)| *r -= share * b);
            }
            let scale = 1.0 / factor[i];
            row[..i].iter_mut().for_each(|r| *r *= scale);
            row[i] = scale;
        }
    }

    /// Whitens columns of `width` numbers, one after the other, in place.
    pub fn apply(&self, columns: &mut [f64]) {
        for column in columns.chunks_exact_mut(self.width) {
            for i in (0..self.width).rev() {
                let used = (i + 1).next_multiple_of(PAD);
                column[i] = dot(&self.inverse[i * self.width..][..used], &column[..used]);
            }
        }
    }

    /// Writes the transposed map of a whitened column: `weights` of whitened numbers become those of the numbers
    /// themselves.
    pub fn transposed(&self, weights: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.resize(self.width, 0.0);
        for (row, weight) in self.inverse.chunks_exact(self.width).zip(weights) {
            out.iter_mut().zip(row).for_each(|(o, r)| *o += weight * r);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_covariance_becomes_the_identity() {
        let width = PAD;
        let mut covariance = vec![0.0; width * width];
        for i in 0..width {
            for j in 0..width {
                let near = 0.6f64.powi(i.abs_diff(j) as i32);
                covariance[i * width + j] = ((i + 1) * (j + 1)) as f64 * near;
            }
        }
        let mut whitener = Whitener::default();
        whitener.set(&covariance, width);
        // W C, column by column (C is symmetric), then W (W C)'.
        let mut half = covariance.clone();
        whitener.apply(&mut half);
        let mut whole: Vec<f64> =
            (0..width * width).map(|i| half[i % width * width + i / width]).collect();
        whitener.apply(&mut whole);
        for (i, value) in whole.iter().enumerate() {
            let wanted = f64::from(u8::from(i / width == i % width));
            assert!((value - wanted).abs() < 1e-12, "{i}: {value}");
        }
        // The same number by the map and by its transpose.
        let (weights, column) = (vec![1.5; width], vec![0.5, -1.0, 2.0, 0.0, 3.0, 1.0, -2.0, 4.0]);
        let (mut back, mut whitened) = (Vec::new(), column.clone());
        whitener.transposed(&weights, &mut back);
        whitener.apply(&mut whitened);
        assert!((dot(&back, &column) - dot(&weights, &whitened)).abs() < 1e-12);
    }

    #[test]
    fn a_covariance_beyond_rounding_keeps_its_variances() {
        let mut covariance = vec![1e300; PAD * PAD];
        (0..PAD).for_each(|i| covariance[i * PAD + i] = 4.0);
        let mut whitener = Whitener::default();
        whitener.set(&covariance, PAD);
        let mut column = vec![2.0; PAD];
        whitener.apply(&mut column);
        assert_eq!(column, vec![1.0; PAD]);
    }
}
