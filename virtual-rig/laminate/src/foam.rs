//! The foam's pressure in its compression, and the fabric's in the overlap with a tip.
//! Uses: `laws`. Never: places.

use crate::laws::{CoverLaw, FoamLaw};

/// Compression beyond which the foam's law is continued by its tangent.
const STRAIN_MAX: f64 = 0.92;
/// Overlap, in lofts, beyond which the fabric's law is continued by its tangent.
const LOFTS_MAX: f64 = 7.0;

/// A law's value and its slope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    /// Pressure at the strain, MPa.
    pub pressure_mpa: f64,
    /// Its derivative by the argument.
    pub slope: f64,
}

impl FoamLaw {
    /// Pressure at a compressive strain, and its slope by the strain: Avalle's law with m = 0,
    /// `A (1 - exp(-E e / A)) + B (e / (1 - e))^n`, linear in tension; or the Ogden foam of one term
    /// without lateral strain, `(mu / (a - 1 + q)) ((1-e)^-q - (1-e)^(a-1))`.
    pub fn pressure(&self, strain: f64) -> Value {
        if strain > STRAIN_MAX {
            let at = self.pressure(STRAIN_MAX);
            let pressure_mpa = at.pressure_mpa + at.slope * (strain - STRAIN_MAX);
            return Value { pressure_mpa, slope: at.slope };
        }
        match *self {
            Self::Avalle {
                modulus_mpa,
                plateau_mpa,
                densification_mpa,
                densification_exponent,
            } => {
                if strain < 0.0 {
                    return Value { pressure_mpa: modulus_mpa * strain, slope: modulus_mpa };
                }
                let decay = (-modulus_mpa * strain / plateau_mpa).exp();
                let ratio = strain / (1.0 - strain);
                let n = densification_exponent;
                Value {
                    pressure_mpa: plateau_mpa * (1.0 - decay) + densification_mpa * ratio.powf(n),
                    slope: modulus_mpa * decay
                        + densification_mpa * n * ratio.powf(n - 1.0) / (1.0 - strain).powi(2),
                }
            }
            Self::Ogden { modulus_mpa, exponent, volumetric } => {
                // Initial slope: modulus. (1-e)^(a-1) softens, (1-e)^-q locks.
                let scale = modulus_mpa / (exponent - 1.0 + volumetric);
                let rest = 1.0 - strain;
                Value {
                    pressure_mpa: scale * (rest.powf(-volumetric) - rest.powf(exponent - 1.0)),
                    slope: scale
                        * (volumetric * rest.powf(-volumetric - 1.0)
                            + (exponent - 1.0) * rest.powf(exponent - 2.0)),
                }
            }
        }
    }

    /// Compressive strain at a pressure >= 0.
    pub fn strain(&self, pressure_mpa: f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.5);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.pressure(middle).pressure_mpa < pressure_mpa {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }
}

impl CoverLaw {
    /// Pressure between tip and fabric at an overlap, and its slope by the overlap in mm: zero apart,
    /// `p0 (exp(overlap / loft) - 1)` in contact.
    pub fn contact(&self, overlap_mm: f64) -> Value {
        if overlap_mm <= 0.0 {
            return Value { pressure_mpa: 0.0, slope: 0.0 };
        }
        let lofts = overlap_mm / self.loft_mm;
        let grown = lofts.min(LOFTS_MAX).exp();
        let slope = self.loft_mpa * grown / self.loft_mm;
        let beyond_mm = (lofts - LOFTS_MAX).max(0.0) * self.loft_mm;
        Value { pressure_mpa: self.loft_mpa * (grown - 1.0) + slope * beyond_mm, slope }
    }

    /// Overlap at a pressure >= 0, mm, without the tangent's part.
    pub fn overlap_mm(&self, pressure_mpa: f64) -> f64 {
        self.loft_mm * (pressure_mpa / self.loft_mpa).ln_1p()
    }
}
