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
    use super::Compared;

    #[test]
    fn the_rmse_is_per_value_and_the_fvu_that_of_the_statistics() {
        let measured = [1.0, 2.0, 3.0, 6.0];
        for (measured_v, simulated_v, rmse_v, fvu) in [
            (&measured[..], &measured[..], 0.0, Some(0.0)),
            (&measured[..], &[3.0; 4][..], 3.5_f64.sqrt(), Some(1.0)),
            (&[2.0; 3][..], &[1.0; 3][..], 1.0, None),
        ] {
            let found = Compared { measured_v, simulated_v }.difference();
            assert!((found.rmse_v - rmse_v).abs() < 1e-12, "{found:?}");
            assert_eq!(found.fvu, fvu);
        }
    }
}
