//! One skin as calibrated: fields on grids, electrodes, resistances, readout offsets.
//! Uses: `mesh`, `fields`, `circuit`, serde. Never: fitting (`inverse::skin` does), files.
//!
//! A field is defined by its values at the corners of a rectangular grid over the whole skin and is
//! bilinear between them. All numbers are rounded, see [`rounded`], so that a file stays short and
//! describes exactly the model whose accuracy it states.

use serde::{Deserialize, Serialize};

use crate::circuit::{ElectrodeSite, ReadoutCircuit};
use crate::fields::{DisplacementLut, LutError, NodeFields};
use crate::mesh::Mesh;
use crate::sensor::Sensor;

/// Calibrated values are rounded to 1 / this (ln of factors, mm, ohm; offsets in mV).
const DECIMALS: f64 = 1e4;
/// Largest absolute value of a field: the logarithm of a factor beyond the range of materials.
const LARGEST_LN: f64 = 20.0;
/// Largest absolute value of ln of the sheet's conductance along x over that along y: resistors of the mesh's triangles
/// become negative from ln 3 on.
pub const LARGEST_ANISOTROPY_LN: f64 = 1.0;

/// Rounds a value to the four decimals of a calibration.
pub fn rounded(value: f64) -> f64 {
    (value * DECIMALS).round() / DECIMALS
}

/// Corners of a rectangular grid over the skin, from (0, 0) to its far corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SkinGrid {
    /// Corners along x, at least 2.
    pub columns: usize,
    /// Corners along y, at least 2.
    pub rows: usize,
}

impl SkinGrid {
    /// Returns the coarsest grid whose corners are at most `spacing_mm` apart.
    pub fn of_spacing(sensor: &Sensor, spacing_mm: f64) -> Self {
        let corners = |extent_mm: f64| 1 + (extent_mm / spacing_mm).ceil().max(1.0) as usize;
        Self { columns: corners(sensor.file.width_mm), rows: corners(sensor.file.height_mm) }
    }

    /// Number of corners.
    pub fn corners(&self) -> usize {
        self.columns * self.rows
    }

    /// Position of a corner (row by row from y = 0), mm.
    pub fn place_mm(&self, sensor: &Sensor, corner: usize) -> [f64; 2] {
        let step = self.step_mm(sensor);
        [step[0] * (corner % self.columns) as f64, step[1] * (corner / self.columns) as f64]
    }

    /// The corners around a position, with bilinear weights (sum 1; outside, of the nearest
    /// position).
    pub fn weights(&self, sensor: &Sensor, [x_mm, y_mm]: [f64; 2]) -> [(usize, f64); 4] {
        let step = self.step_mm(sensor);
        let along = |mm: f64, step: f64, corners: usize| {
            let at = (mm / step).clamp(0.0, (corners - 1) as f64);
            let cell = (at as usize).min(corners - 2);
            (cell, at - cell as f64)
        };
        let (column, u) = along(x_mm, step[0], self.columns);
        let (row, v) = along(y_mm, step[1], self.rows);
        let first = row * self.columns + column;
        [
            (first, (1.0 - u) * (1.0 - v)),
            (first + 1, u * (1.0 - v)),
            (first + self.columns, (1.0 - u) * v),
            (first + self.columns + 1, u * v),
        ]
    }

    fn step_mm(&self, sensor: &Sensor) -> [f64; 2] {
        let step = |extent_mm: f64, corners: usize| extent_mm / (corners - 1) as f64;
        [step(sensor.file.width_mm, self.columns), step(sensor.file.height_mm, self.rows)]
    }
}

/// Prior of a field: standard deviations of the logarithm of a factor, over skins (its mean) and
/// over positions (two Gaussian processes).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldPrior {
    /// Standard deviation of the whole skin's mean.
    pub overall_sd: f64,
    /// Standard deviation of the smooth part.
    pub smooth_sd: f64,
    /// Its correlation length l, mm: `exp(-d^2 / (2 l^2))`.
    pub smooth_mm: f64,
    /// Standard deviation of the local part.
    pub local_sd: f64,
    /// Correlation length of the local part, mm.
    pub local_mm: f64,
}

impl FieldPrior {
    /// Spacing of a grid that resolves the field: its shortest correlation length, mm, at least
    /// `finest_mm`.
    pub fn spacing_mm(&self, finest_mm: f64) -> f64 {
        let shortest_mm = if self.local_sd > 0.0 { self.local_mm } else { self.smooth_mm };
        finest_mm.max(shortest_mm)
    }

    /// Covariance of the field's values at two positions at a distance, mm.
    pub fn covariance(&self, distance_mm: f64) -> f64 {
        let part = |sd: f64, length_mm: f64| {
            let t = distance_mm / length_mm;
            sd * sd * (-0.5 * t * t).exp()
        };
        self.overall_sd.powi(2)
            + part(self.smooth_sd, self.smooth_mm)
            + part(self.local_sd, self.local_mm)
    }
}

/// A fitted field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinField {
    /// Number of corners along x.
    pub columns: usize,
    /// Prior of the fit.
    pub prior: FieldPrior,
    /// Natural logarithm of a factor on the sensor's value at each corner, row by row from y = 0.
    pub values: Vec<f64>,
}

impl SkinField {
    /// The grid of its values.
    pub fn grid(&self) -> SkinGrid {
        SkinGrid { columns: self.columns, rows: self.values.len() / self.columns.max(1) }
    }

    /// Value at a position, mm.
    pub fn at(&self, sensor: &Sensor, place_mm: [f64; 2]) -> f64 {
        let corners = self.grid().weights(sensor, place_mm);
        corners.iter().map(|&(corner, weight)| weight * self.values[corner]).sum()
    }

    fn over(&self, sensor: &Sensor, places_mm: impl Iterator<Item = [f64; 2]>) -> Vec<f64> {
        places_mm.map(|place| self.at(sensor, place)).collect()
    }
}

/// The fitted fields.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinFields {
    /// The foam's law, the same at all positions.
    pub foam: SkinFoam,
    /// Factor on a of Eq. 1.
    pub ln_a: SkinField,
    /// Factor on b of Eq. 1.
    pub ln_b: SkinField,
    /// Factor on c of Eq. 1.
    pub ln_c: SkinField,
    /// Factor on the foam's compression.
    pub ln_compliance: SkinField,
    /// Factor on the sheet's conductance: on the geometric mean of those along x and y.
    pub ln_sheet_conductance: SkinField,
    /// Natural logarithm of the sheet's conductance along x over that along y. Files of an isotropic sheet, as all
    /// earlier ones, do not have it: their content's id stays.
    #[serde(default, skip_serializing_if = "is_isotropic")]
    pub ln_sheet_anisotropy: f64,
}

fn is_isotropic(ln_sheet_anisotropy: &f64) -> bool {
    *ln_sheet_anisotropy == 0.0
}

impl SkinFields {
    /// The fields, with their names in the file.
    pub fn named(&self) -> [(&'static str, &SkinField); 5] {
        [
            ("ln_a", &self.ln_a),
            ("ln_b", &self.ln_b),
            ("ln_c", &self.ln_c),
            ("ln_compliance", &self.ln_compliance),
            ("ln_sheet_conductance", &self.ln_sheet_conductance),
        ]
    }

    /// Evaluates the fields at the mesh's nodes and triangles.
    ///
    /// # Errors
    /// `LutError` if the foam's law is not a valid displacement table.
    pub fn over(&self, sensor: &Sensor, mesh: &Mesh) -> Result<NodeFields, LutError> {
        let over_nodes = |field: &SkinField| field.over(sensor, mesh.nodes_mm.iter().copied());
        let centres = mesh.triangles.iter().map(|t| mesh.triangle_centre_mm(t));
        Ok(NodeFields {
            ln_a: over_nodes(&self.ln_a),
            ln_b: over_nodes(&self.ln_b),
            ln_c: over_nodes(&self.ln_c),
            ln_compliance: over_nodes(&self.ln_compliance),
            ln_sheet_conductance: self.ln_sheet_conductance.over(sensor, centres),
            ln_sheet_anisotropy: self.ln_sheet_anisotropy,
            displacement: Some(self.foam.law()?),
        })
    }
}

/// The foam's law: its real compression as a piecewise linear function of the linear one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinFoam {
    /// Length of a piece, mm of linear compression.
    pub step_mm: f64,
    /// Natural logarithm of each piece's slope; beyond the last it is extrapolated with that slope.
    pub ln_slopes: Vec<f64>,
}

impl SkinFoam {
    /// Returns the law in the form of the model.
    ///
    /// # Errors
    /// `LutError` if the step is not positive, there are no pieces, or a sample is not finite.
    pub fn law(&self) -> Result<DisplacementLut, LutError> {
        let mut samples_mm = vec![0.0];
        for ln in &self.ln_slopes {
            samples_mm.push(samples_mm[samples_mm.len() - 1] + self.step_mm * ln.exp());
        }
        DisplacementLut::new(self.step_mm, samples_mm)
    }
}

/// The fitted electrodes, in measuring order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinElectrodes {
    /// Positions along x, mm.
    pub x_mm: Vec<f64>,
    /// Positions along y, mm.
    pub y_mm: Vec<f64>,
    /// Contact (spreading) resistances, ohm, > 0.
    pub contact_ohm: Vec<f64>,
    /// Lead resistances, ohm, >= 0.
    pub lead_ohm: Vec<f64>,
}

impl SkinElectrodes {
    /// Returns the readout circuit: source and gain are those of the sensor file.
    pub fn circuit(&self, sensor: &Sensor) -> ReadoutCircuit {
        let site = |k: usize| ElectrodeSite {
            x_mm: self.x_mm[k],
            y_mm: self.y_mm[k],
            contact_ohm: self.contact_ohm[k],
            lead_ohm: self.lead_ohm[k],
        };
        ReadoutCircuit {
            electrodes: (0..self.x_mm.len()).map(site).collect(),
            ..ReadoutCircuit::nominal(sensor)
        }
    }
}

/// Fraction of variance unexplained (Eq. 2) over several trials.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FvuSummary {
    /// Median over trials.
    pub median: f64,
    /// Mean over trials.
    pub mean: f64,
}

/// Data of a fit, and its accuracy on held-out trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinEvidence {
    /// Id of the run whose trials were used.
    pub run: String,
    /// Label of the rig.
    pub label: String,
    /// sha256 over the trials used (contacts, forces, voltages).
    pub data_sha256: String,
    /// Hash of the model that the fit started from.
    pub model: String,
    /// Number of trials fitted.
    pub trials: usize,
    /// Number of trials held out, none of a configuration that was fitted.
    pub held_out: usize,
    /// Number of trials whose weight is below one half: outliers with respect to the model.
    pub doubted: usize,
    /// Standard deviation of a reading, V.
    pub noise_v: f64,
    /// Relative error of the model, as a share of a frame's norm.
    pub model_error: f64,
    /// FVU on held-out trials before the fit, with the model that it started from.
    pub before: FvuSummary,
    /// FVU on held-out trials after the fit.
    pub after: FvuSummary,
}

/// Calibration of one skin by position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinCalibration {
    /// Offset of each channel of the readout, mV: to be subtracted from measured frames; not part
    /// of the model's frames. Empty if it was not estimated.
    pub offsets_mv: Vec<f64>,
    /// Data and accuracy of the fit.
    pub evidence: SkinEvidence,
    /// The fitted electrodes.
    pub electrodes: SkinElectrodes,
    /// The fitted fields.
    pub fields: SkinFields,
}

/// A value that is invalid for a skin.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("skin.{key} = {value}: {limit}")]
pub struct SkinValueError {
    /// Dotted key within the calibration's `skin`.
    pub key: String,
    /// The value found, as text.
    pub value: String,
    /// Allowed values.
    pub limit: String,
}

impl SkinCalibration {
    /// Checks everything that does not depend on the sensor: grids, lengths, ranges.
    ///
    /// # Errors
    /// `SkinValueError` with the first value outside its limits.
    pub fn check(&self) -> Result<(), SkinValueError> {
        for (name, field) in self.fields.named() {
            let name = format!("fields.{name}");
            let grid = field.grid();
            if grid.columns < 2 || grid.rows < 2 || field.values.len() != grid.corners() {
                let value = format!("{} values in {} columns", field.values.len(), field.columns);
                return Err(bad(&name, value, "needs whole rows, 2 or more of 2 columns or more"));
            }
            if let Some(wrong) = field.values.iter().find(|v| v.is_nan() || v.abs() > LARGEST_LN) {
                return Err(bad(&name, wrong, "must be the logarithm of a factor, -20 to 20"));
            }
        }
        let anisotropy = self.fields.ln_sheet_anisotropy;
        if anisotropy.is_nan() || anisotropy.abs() > LARGEST_ANISOTROPY_LN {
            return Err(bad("fields.ln_sheet_anisotropy", anisotropy, "must be -1 to 1"));
        }
        let foam = &self.fields.foam;
        if let Some(wrong) = foam.ln_slopes.iter().find(|v| v.is_nan() || v.abs() > LARGEST_LN) {
            return Err(bad("fields.foam.ln_slopes", wrong, "must be a logarithm, -20 to 20"));
        }
        if let Err(error) = foam.law() {
            return Err(bad("fields.foam.step_mm", foam.step_mm, &error.to_string()));
        }
        let e = &self.electrodes;
        for (name, values) in [
            ("electrodes.x_mm", &e.x_mm),
            ("electrodes.y_mm", &e.y_mm),
            ("electrodes.contact_ohm", &e.contact_ohm),
            ("electrodes.lead_ohm", &e.lead_ohm),
        ] {
            if values.len() != e.x_mm.len() || values.is_empty() {
                let value = format!("{} values", values.len());
                return Err(bad(name, value, "needs one for each electrode"));
            }
            if let Some(wrong) = values.iter().find(|v| !(**v >= 0.0 && v.is_finite())) {
                return Err(bad(name, wrong, "must be a number >= 0"));
            }
        }
        if let Some(wrong) = e.contact_ohm.iter().find(|v| **v == 0.0) {
            let limit = "must be above 0: not every place has a node";
            return Err(bad("electrodes.contact_ohm", wrong, limit));
        }
        let channels = e.x_mm.len() * e.x_mm.len();
        if !self.offsets_mv.is_empty() && self.offsets_mv.len() != channels {
            let value = format!("{} values", self.offsets_mv.len());
            return Err(bad("offsets_mv", value, "needs none, or one for each channel"));
        }
        Ok(())
    }

    /// Checks it against the sensor that it is applied to.
    ///
    /// # Errors
    /// `SkinValueError` if the number of electrodes differs, or one is outside the skin.
    pub fn check_for(&self, sensor: &Sensor) -> Result<(), SkinValueError> {
        let (found, needed) = (self.electrodes.x_mm.len(), sensor.electrodes_mm().len());
        if found != needed {
            let limit = format!("the sensor has {needed} electrodes");
            return Err(bad("electrodes.x_mm", format!("{found} values"), &limit));
        }
        for (name, values, most_mm) in [
            ("electrodes.x_mm", &self.electrodes.x_mm, sensor.file.width_mm),
            ("electrodes.y_mm", &self.electrodes.y_mm, sensor.file.height_mm),
        ] {
            if let Some(wrong) = values.iter().find(|v| **v > most_mm) {
                return Err(bad(name, wrong, &format!("must be on the skin, up to {most_mm} mm")));
            }
        }
        Ok(())
    }
}

fn bad(key: &str, value: impl ToString, limit: &str) -> SkinValueError {
    SkinValueError { key: key.into(), value: value.to_string(), limit: limit.into() }
}
