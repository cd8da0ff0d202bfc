//! The laws and parameters of a skin: the sections of its gap file.
//! Uses: serde. Never: TOML (the caller reads it), chance.

use serde::{Deserialize, Serialize};

use crate::Plan;

/// A value of a gap file that is outside its limits.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value}: {limit}")]
pub struct ValueError {
    /// Dotted key in the gap file.
    pub key: &'static str,
    /// Value that was found.
    pub value: f64,
    /// Allowed values.
    pub limit: &'static str,
}

/// Laws and parameters of a skin, one field per section of the gap file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laws {
    /// Squares of the mechanics and of the sheet.
    pub grid: GridLaw,
    /// Compression of the foam, and its variation over the skin.
    pub foam: Foam,
    /// The fabric above it.
    pub cover: CoverLaw,
    /// Tilts of tips and of the skin under them.
    pub tips: Tips,
    /// Heights and springs of the rig.
    pub stage: Stage,
    /// Conductance through the foam.
    pub conductance: Foamed,
    /// The high-resistance fabric.
    pub sheet: SheetLaw,
    /// Sizes, positions and resistances of the electrodes.
    pub electrodes: Electrodes,
    /// Sampling, noise and drift of the readout.
    pub readout: ReadoutLaw,
}

/// Sizes of squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridLaw {
    /// Squares of the mechanics and of the conductance, mm.
    pub foam_mm: f64,
    /// Squares of the sheet, mm: a multiple of `foam_mm`.
    pub sheet_mm: f64,
}

/// Compression of the foam, and its variation over the skin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Foam {
    /// Pressure by strain.
    pub law: FoamLaw,
    /// Shear modulus, MPa: couples neighbouring columns.
    pub shear_mpa: f64,
    /// Standard deviation of the logarithm of a factor on all stiffness.
    pub ln_sd: f64,
    /// Correlation length of that factor, mm.
    pub correlation_mm: f64,
    /// Relative loss of force while unloading.
    pub unloading: f64,
}

/// Pressure of the foam by its compressive strain.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "kebab-case", deny_unknown_fields)]
pub enum FoamLaw {
    /// Plateau and densification (Avalle et al. 2007).
    Avalle {
        /// Initial modulus, MPa.
        modulus_mpa: f64,
        /// Pressure at which the cells of the foam collapse, MPa.
        plateau_mpa: f64,
        /// Scale of the densification, MPa.
        densification_mpa: f64,
        /// Its exponent, > 1.
        densification_exponent: f64,
    },
    /// A compressible Ogden solid of one term.
    Ogden {
        /// Initial modulus, MPa.
        modulus_mpa: f64,
        /// Exponent of the stretch, > 1.
        exponent: f64,
        /// Exponent of the volume, > 0.
        volumetric: f64,
    },
}

/// The fabric above the foam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoverLaw {
    /// Bending stiffness, N mm.
    pub bending_n_mm: f64,
    /// Tension, N/mm.
    pub tension_n_per_mm: f64,
    /// Overlap at which the pressure under a tip grows by the factor e, mm.
    pub loft_mm: f64,
    /// Scale of that pressure, MPa.
    pub loft_mpa: f64,
}

/// Tilts of tips and of the skin under them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tips {
    /// Standard deviation of an arm's tilt about each axis, degrees.
    pub tilt_sd_deg: f64,
    /// Standard deviation of the slope of the skin under a tip along each axis, degrees.
    pub slope_sd_deg: f64,
    /// Correlation length of that slope, mm.
    pub slope_correlation_mm: f64,
}

/// Heights and springs of the rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Mean height of the skin below z = 0, mm.
    pub height_mm: f64,
    /// Standard deviation of the height, mm.
    pub height_sd_mm: f64,
    /// Its correlation length, mm.
    pub height_correlation_mm: f64,
    /// How much shorter each arm's tip is, mm.
    pub arm_offsets_mm: Vec<f64>,
    /// Spring of an arm with its cell, N/mm.
    pub arm_n_per_mm: f64,
}

/// Conductance through the foam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Foamed {
    /// Conductance by pressure.
    pub law: ConductanceLaw,
    /// Resistance that remains at high pressure, ohm mm^2.
    pub series_ohm_mm2: f64,
    /// Conductance without load, S/mm^2.
    pub untouched_s_per_mm2: f64,
    /// Relative gain at equal pressure while unloading.
    pub unloading: f64,
    /// Standard deviation of the logarithm, smooth part.
    pub ln_sd: f64,
    /// Correlation length of the smooth part, mm.
    pub correlation_mm: f64,
    /// Standard deviation of the logarithm, independent in each square of the mechanics.
    pub ln_cell_sd: f64,
}

/// Conductance of the foam by its pressure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ConductanceLaw {
    /// A power of the pressure.
    Power {
        /// Conductance at 1 MPa, S/mm^2.
        s_per_mm2_at_1_mpa: f64,
        /// Exponent of the power, without unit.
        exponent: f64,
    },
    /// A power of the pressure above a threshold.
    Percolation {
        /// Conductance at 1 MPa above the threshold, S/mm^2.
        s_per_mm2_at_1_mpa: f64,
        /// Pressure around which the foam starts to conduct, MPa.
        threshold_mpa: f64,
        /// Exponent of the power, without unit.
        exponent: f64,
    },
}

/// Conductance of the high-resistance fabric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SheetLaw {
    /// Conductance along x over that along y; their geometric mean is the sensor file's.
    pub anisotropy: f64,
    /// Standard deviation of the logarithm of the conductance.
    pub ln_sd: f64,
    /// Its correlation length, mm.
    pub correlation_mm: f64,
}

/// Sizes, positions and resistances of the electrodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Electrodes {
    /// Diameter of a disc, mm.
    pub diameter_mm: f64,
    /// Standard deviation of its centre per axis, mm.
    pub offset_sd_mm: f64,
    /// Median contact impedance, ohm mm^2.
    pub contact_ohm_mm2: f64,
    /// Standard deviation of its logarithm.
    pub contact_ln_sd: f64,
    /// Median resistance of a lead, ohm.
    pub lead_ohm: f64,
    /// Standard deviation of its logarithm.
    pub lead_ln_sd: f64,
}

/// Sampling, noise and drift of the readout.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadoutLaw {
    /// Samples per second.
    pub sample_hz: f64,
    /// A count of the converter, mV.
    pub count_mv: f64,
    /// White noise of a sample, mV.
    pub white_mv: f64,
    /// 1/f noise of an electrode's buffer over five decades of time, mV.
    pub flicker_mv: f64,
    /// Amplitude of the mains, mV.
    pub mains_mv: f64,
    /// Frequency of the mains, Hz.
    pub mains_hz: f64,
    /// Share of the previous sample in each one.
    pub crosstalk: f64,
    /// Offset of a buffer at the beginning, mV.
    pub offset_mv: f64,
    /// Change of that offset in a day, mV.
    pub offset_per_day_mv: f64,
    /// Change of that offset per kelvin, mV.
    pub offset_per_k_mv: f64,
    /// Change of the converter's offset, which all channels share, per kelvin, mV.
    pub converter_per_k_mv: f64,
    /// Relative growth of the signal per decade of seconds under a held load.
    pub relaxation_per_decade: f64,
    /// Relative change of the foam's conductance per kelvin.
    pub conductance_per_k: f64,
    /// Half of the difference of temperature between day and night, K.
    pub day_k: f64,
    /// Standard deviation of the temperature over hours, K.
    pub hours_k: f64,
}

/// Dotted keys and values of fields of a file's sections: `keyed!(file, foam: ln_sd; tips: tilt_sd)`.
#[macro_export]
macro_rules! keyed {
    ($file:expr, $($section:ident: $($field:ident),+);+) => {
        [$($((
            concat!(stringify!($section), ".", stringify!($field)),
            $file.$section.$field,
        )),+),+]
    };
}

impl Laws {
    /// Checks the values.
    ///
    /// # Errors
    /// `ValueError` with the first value outside its limits.
    pub fn check(&self, plan: &Plan) -> Result<(), ValueError> {
        let (g, s, e, r) = (&self.grid, &self.stage, &self.electrodes, &self.readout);
        let (f, k) = (&self.foam, &self.conductance);
        let not_negative = keyed!(self,
            foam: shear_mpa, ln_sd; cover: bending_n_mm, tension_n_per_mm;
            tips: tilt_sd_deg, slope_sd_deg; stage: height_sd_mm;
            conductance: series_ohm_mm2, unloading, ln_sd, ln_cell_sd; sheet: ln_sd;
            electrodes: offset_sd_mm, contact_ln_sd, lead_ohm, lead_ln_sd;
            readout: white_mv, flicker_mv, mains_mv, offset_mv, offset_per_day_mv, hours_k,
                offset_per_k_mv, converter_per_k_mv, relaxation_per_decade, conductance_per_k,
                day_k; stage: height_mm);
        for (key, value) in not_negative {
            require(key, value, value >= 0.0, "must be a number >= 0")?;
        }
        let mut positive = Vec::from(keyed!(self,
            grid: foam_mm, sheet_mm; foam: correlation_mm; cover: loft_mm, loft_mpa;
            tips: slope_correlation_mm; stage: height_correlation_mm, arm_n_per_mm;
            conductance: untouched_s_per_mm2, correlation_mm; sheet: anisotropy, correlation_mm;
            electrodes: diameter_mm, contact_ohm_mm2; readout: sample_hz, count_mv, mains_hz));
        match f.law {
            FoamLaw::Avalle {
                modulus_mpa,
                plateau_mpa,
                densification_mpa,
                densification_exponent,
            } => {
                positive.extend([
                    ("foam.law.modulus_mpa", modulus_mpa),
                    ("foam.law.plateau_mpa", plateau_mpa),
                    ("foam.law.densification_mpa", densification_mpa),
                    ("foam.law.densification_exponent, above 1", densification_exponent - 1.0),
                ]);
            }
            FoamLaw::Ogden { modulus_mpa, exponent, volumetric } => positive.extend([
                ("foam.law.modulus_mpa", modulus_mpa),
                ("foam.law.exponent, above 1", exponent - 1.0),
                ("foam.law.volumetric", volumetric),
            ]),
        }
        match k.law {
            ConductanceLaw::Power { s_per_mm2_at_1_mpa, exponent } => positive.extend([
                ("conductance.law.s_per_mm2_at_1_mpa", s_per_mm2_at_1_mpa),
                ("conductance.law.exponent", exponent),
            ]),
            ConductanceLaw::Percolation { s_per_mm2_at_1_mpa, threshold_mpa, exponent } => {
                positive.extend([
                    ("conductance.law.s_per_mm2_at_1_mpa", s_per_mm2_at_1_mpa),
                    ("conductance.law.threshold_mpa", threshold_mpa),
                    ("conductance.law.exponent", exponent),
                ]);
            }
        }
        for (key, value) in positive {
            require(key, value, value > 0.0, "must be a number > 0")?;
        }
        for (key, value) in [("foam.unloading", f.unloading), ("readout.crosstalk", r.crosstalk)] {
            require(key, value, (0.0..1.0).contains(&value), "must be in [0, 1)")?;
        }
        let whole = |value: f64| (value - value.round()).abs() < 1e-9 && value.round() >= 1.0;
        let ratio = g.sheet_mm / g.foam_mm;
        require("grid.sheet_mm", g.sheet_mm, whole(ratio), "must be a multiple of grid.foam_mm")?;
        for size_mm in plan.size_mm {
            let fits = whole(size_mm / g.sheet_mm);
            require("grid.sheet_mm", g.sheet_mm, fits, "must divide the size of the skin")?;
        }
        let within = plan.size_mm.iter().all(|size_mm| e.diameter_mm < *size_mm);
        require("electrodes.diameter_mm", e.diameter_mm, within, "must be smaller than the skin")?;
        for value in &s.arm_offsets_mm {
            require("stage.arm_offsets_mm", *value, true, "must be numbers")?;
        }
        Ok(())
    }
}

/// Checks that a value is finite, and that its limit holds.
///
/// # Errors
/// `ValueError` if not.
pub fn require(
    key: &'static str,
    value: f64,
    holds: bool,
    limit: &'static str,
) -> Result<(), ValueError> {
    if holds && value.is_finite() { Ok(()) } else { Err(ValueError { key, value, limit }) }
}
