//! Differences of one skin from the nominal one, node by node: materials, sheet, foam law.
//! Uses: `mesh` for the counts. Never: chance (a reality gap or a calibration fills these in).

use crate::digest::Digest;
use crate::mesh::Mesh;

/// A monotone map from linear to real foam compression, sampled evenly and interpolated linearly;
/// beyond its last sample it is extrapolated with the last slope.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplacementLut {
    step_mm: f64,
    samples_mm: Vec<f64>,
}

/// Compressions at which a displacement table is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LutGrid {
    /// Distance of the samples, mm.
    pub step_mm: f64,
    /// Compression up to which the table is sampled, mm.
    pub end_mm: f64,
}

/// Why a displacement table is invalid; samples count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LutError {
    #[error("displacement table: needs a positive step and at least two samples")]
    TooShort,
    /// A sample is not finite or below the one before it, or the first is not zero.
    #[error("displacement table: sample {index} = {value_mm} mm breaks the rise from zero")]
    NotRising { index: usize, value_mm: f64 },
}

impl DisplacementLut {
    /// Builds the table from samples at 0, `step_mm`, 2 `step_mm`, ..
    ///
    /// # Errors
    /// `LutError::TooShort` or `LutError::NotRising`, as described there.
    pub fn new(step_mm: f64, samples_mm: Vec<f64>) -> Result<Self, LutError> {
        if !(step_mm > 0.0 && step_mm.is_finite()) || samples_mm.len() < 2 {
            return Err(LutError::TooShort);
        }
        let mut before = 0.0;
        for (index, &value_mm) in samples_mm.iter().enumerate() {
            let rises = value_mm.is_finite() && value_mm >= before;
            if !rises || (index == 0 && value_mm != 0.0) {
                return Err(LutError::NotRising { index, value_mm });
            }
            before = value_mm;
        }
        Ok(Self { step_mm, samples_mm })
    }

    /// Builds the table from samples of a law, in mm.
    ///
    /// # Errors
    /// `LutError`, as [`Self::new`].
    pub fn sample(grid: LutGrid, law: impl Fn(f64) -> f64) -> Result<Self, LutError> {
        let LutGrid { step_mm, end_mm } = grid;
        let count = (end_mm / step_mm).ceil().max(1.0) as usize;
        Self::new(step_mm, (0..=count).map(|i| law(i as f64 * step_mm)).collect())
    }

    /// Real compression for a linear one, mm.
    #[inline]
    pub fn apply(&self, linear_mm: f64) -> f64 {
        let place = linear_mm / self.step_mm;
        let cell = (place as usize).min(self.samples_mm.len() - 2);
        let (low, high) = (self.samples_mm[cell], self.samples_mm[cell + 1]);
        low + (high - low) * (place - cell as f64)
    }

    /// Slope of [`Self::apply`]; at a sample, that of the following piece.
    pub fn slope(&self, linear_mm: f64) -> f64 {
        let cell = ((linear_mm / self.step_mm) as usize).min(self.samples_mm.len() - 2);
        (self.samples_mm[cell + 1] - self.samples_mm[cell]) / self.step_mm
    }
}

/// Natural logarithms of factors on the nominal values (0 = nominal), and the foam's law.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeFields {
    /// Factor on a of Eq. 1, per node.
    pub ln_a: Vec<f64>,
    /// Factor on b of Eq. 1, per node.
    pub ln_b: Vec<f64>,
    /// Factor on c of Eq. 1, per node.
    pub ln_c: Vec<f64>,
    /// Factor on the foam's compression, per node.
    pub ln_compliance: Vec<f64>,
    /// Factor on the sheet's conductance, per triangle: on the geometric mean of those along x and y.
    pub ln_sheet_conductance: Vec<f64>,
    /// Sheet's conductance along x over that along y, the same at all positions: a fabric conducts differently along
    /// its two directions.
    pub ln_sheet_anisotropy: f64,
    /// The foam's law, applied after the compliance; `None` is linear.
    pub displacement: Option<DisplacementLut>,
}

/// A field's length does not fit the mesh.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("node fields: {field} has {found} values, the mesh needs {needed}")]
pub struct FieldLength {
    /// Name of the field.
    pub field: &'static str,
    /// Number of values found.
    pub found: usize,
    /// Number of values needed.
    pub needed: usize,
}

impl NodeFields {
    /// The nominal skin of a mesh.
    pub fn nominal(mesh: &Mesh) -> Self {
        let zeros = vec![0.0; mesh.plane_nodes()];
        Self {
            ln_a: zeros.clone(),
            ln_b: zeros.clone(),
            ln_c: zeros.clone(),
            ln_compliance: zeros,
            ln_sheet_conductance: vec![0.0; mesh.triangles.len()],
            ln_sheet_anisotropy: 0.0,
            displacement: None,
        }
    }

    /// Checks the lengths against a mesh.
    ///
    /// # Errors
    /// `FieldLength` with the first field whose length is wrong.
    pub fn check(&self, mesh: &Mesh) -> Result<(), FieldLength> {
        let (nodes, triangles) = (mesh.plane_nodes(), mesh.triangles.len());
        for (field, values, needed) in [
            ("ln_a", &self.ln_a, nodes),
            ("ln_b", &self.ln_b, nodes),
            ("ln_c", &self.ln_c, nodes),
            ("ln_compliance", &self.ln_compliance, nodes),
            ("ln_sheet_conductance", &self.ln_sheet_conductance, triangles),
        ] {
            if values.len() != needed {
                return Err(FieldLength { field, found: values.len(), needed });
            }
        }
        Ok(())
    }

    /// Factors on the nominal sheet's conductance along x and y in a triangle.
    pub(crate) fn sheet_factors(&self, triangle: usize) -> [f64; 2] {
        let half = 0.5 * self.ln_sheet_anisotropy;
        [half, -half].map(|ln| (self.ln_sheet_conductance[triangle] + ln).exp())
    }

    pub(crate) fn digest(&self, digest: &mut Digest) {
        for field in
            [&self.ln_a, &self.ln_b, &self.ln_c, &self.ln_compliance, &self.ln_sheet_conductance]
        {
            digest.numbers(field.iter().copied());
        }
        // The hash of an isotropic skin is that of before there were others.
        if self.ln_sheet_anisotropy != 0.0 {
            digest.word("anisotropy");
            digest.numbers([self.ln_sheet_anisotropy]);
        }
        if let Some(lut) = &self.displacement {
            digest.numbers([lut.step_mm]);
            digest.numbers(lut.samples_mm.iter().copied());
        }
    }
}
