//! The foam as a resistor (paper Eq. 1): `f(x) = a / (exp(b x) - 1) + c`.
//! Uses: `sensor::Piezo`. Never: the origin of x.
//!
//! x: compression, mm, > 0; a, c: ohm; b: 1/mm. f(0) is infinite: x counts as at least 1e-4 mm
//! inside f (1.6e12 ohm with the paper's numbers, negligible compared with a sheet of 1e4 ohm/sq),
//! so that an untouched skin is a valid input.

use crate::sensor::Piezo;

/// Smallest compression inside f, mm (`docs/references.md`, "Foam resistance").
pub const LEAST_COMPRESSION_MM: f64 = 1e-4;
/// Area of the specimen on which Eq. 1 was fitted, mm2 (paper III-B).
pub const SPECIMEN_AREA_MM2: f64 = 400.0;

/// Resistance of the specimen at a compression, ohm.
pub fn resistance_ohm(piezo: &Piezo, compression_mm: f64) -> f64 {
    let x = compression_mm.max(LEAST_COMPRESSION_MM);
    piezo.a_ohm / (piezo.b_per_mm * x).exp_m1() + piezo.c_ohm
}

/// Eq. 1 at one node, with all factors of the node included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NodeLaw {
    pub a_ohm: f64,
    pub b_per_mm: f64,
    pub c_ohm: f64,
    /// Factor from the compression of the nominal skin to that of this one.
    pub compliance: f64,
}

impl NodeLaw {
    /// `1 / f(x)` at a compression of this skin, S; for the forward model's inner loop.
    #[inline]
    pub fn conductance_s(&self, compression_mm: f64) -> f64 {
        let x = compression_mm.max(LEAST_COMPRESSION_MM);
        1.0 / (self.a_ohm / (self.b_per_mm * x).exp_m1() + self.c_ohm)
    }

    /// Slopes of [`NodeLaw::conductance_s`].
    pub fn conductance_slopes(&self, compression_mm: f64) -> ConductanceSlopes {
        let Self { a_ohm, b_per_mm, c_ohm, .. } = *self;
        let x = compression_mm.max(LEAST_COMPRESSION_MM);
        let grown = (b_per_mm * x).exp_m1();
        let foam_ohm = a_ohm / grown;
        let g = 1.0 / (foam_ohm + c_ohm);
        // d(foam_ohm)/dx = -foam_ohm b (grown + 1) / grown.
        let along_x = g * g * foam_ohm * b_per_mm * (1.0 + 1.0 / grown);
        ConductanceSlopes {
            per_mm: if compression_mm > LEAST_COMPRESSION_MM { along_x } else { 0.0 },
            per_ln_a: -g * g * foam_ohm,
            per_ln_b: along_x * x,
            per_ln_c: -g * g * c_ohm,
        }
    }
}

/// Derivatives of a node's conductance at one compression.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConductanceSlopes {
    /// By the compression, S/mm; 0 at and below the smallest one.
    pub per_mm: f64,
    /// By ln a, S.
    pub per_ln_a: f64,
    /// By ln b, S.
    pub per_ln_b: f64,
    /// By ln c, S.
    pub per_ln_c: f64,
}
