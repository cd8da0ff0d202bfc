//! Difference of a simulated frame from the measured one: RMSE and FVU of the paper's Eq. 2.
//! PURE. Uses: nothing. Never: thresholds (`drift` and `evaluate` have them).

/// Difference of two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Root of the mean squared difference, V.
    pub rmse_v: f64,
    /// Fraction of variance unexplained, Eq. 2: the sum of squared differences over that of the
    /// measured voltages around their mean. Absent if the measured frame is constant.
    pub fvu: Option<f64>,
}

/// Compares a measured frame with a simulated one of the same length, V.
pub fn difference(measured_v: &[f32], simulated_v: &[f32]) -> Difference {
    assert_eq!(measured_v.len(), simulated_v.len(), "frames of one sensor have one length");
    let count = measured_v.len().max(1) as f64;
    let mean = measured_v.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let (mut unexplained, mut variance) = (0.0, 0.0);
    for (measured, simulated) in measured_v.iter().zip(simulated_v) {
        let measured = f64::from(*measured);
        unexplained += (measured - f64::from(*simulated)).powi(2);
        variance += (measured - mean).powi(2);
    }
    Difference {
        rmse_v: (unexplained / count).sqrt(),
        fvu: (variance > 0.0).then(|| unexplained / variance),
    }
}

#[cfg(test)]
mod tests {
    use super::difference;

    #[test]
    fn a_perfect_twin_leaves_nothing_and_the_mean_explains_nothing() {
        let measured = [1.0, 2.0, 3.0, 6.0];
        let same = difference(&measured, &measured);
        assert_eq!((same.rmse_v, same.fvu), (0.0, Some(0.0)));
        let mean = difference(&measured, &[3.0; 4]);
        assert_eq!(mean.fvu, Some(1.0));
        assert!((mean.rmse_v - 3.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_constant_frame_has_no_variance_to_explain() {
        let flat = difference(&[2.0; 3], &[1.0; 3]);
        assert_eq!((flat.rmse_v, flat.fvu), (1.0, None));
    }
}
