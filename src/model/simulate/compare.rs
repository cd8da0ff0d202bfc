//! Difference of a simulated frame from the measured one: RMSE and FVU of the paper's Eq. 2.
//! PURE. Uses: sim-core's `stats`. Never: thresholds (`drift` and `evaluate` have them).

use sim_core::stats::{fvu, squared_error};

/// Difference of two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Root of the mean squared difference, V.
    pub rmse_v: f64,
    /// Fraction of variance unexplained, Eq. 2: the sum of squared differences over that of the
    /// measured voltages around their mean. Absent if the measured frame is constant.
    pub fvu: Option<f64>,
}

/// A measured frame and a simulated one of the same length.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// Measured voltages, V.
    pub measured_v: &'a [f32],
    /// Simulated voltages, V.
    pub simulated_v: &'a [f32],
}

impl Compared<'_> {
    /// Compares the two frames.
    pub fn difference(self) -> Difference {
        let Self { measured_v, simulated_v } = self;
        assert_eq!(measured_v.len(), simulated_v.len(), "frames of one sensor have one length");
        let count = measured_v.len().max(1) as f64;
        let modelled_v = || simulated_v.iter().copied().map(f64::from);
        Difference {
            rmse_v: (squared_error(measured_v, modelled_v()) / count).sqrt(),
            fvu: fvu(measured_v, modelled_v()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Compared, Difference};

    fn difference(measured_v: &[f32], simulated_v: &[f32]) -> Difference {
        Compared { measured_v, simulated_v }.difference()
    }

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
