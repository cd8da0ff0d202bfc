//! The parameters of a skin as one vector: field values at grid corners, electrode moves,
//! logarithms of resistances; their prior, the model of a vector, and its derivatives.
//! Uses: `skin`, `jacobian` (names of the fields). Never: frames.
//!
//! Electrode positions have no derivative here. With a contact much better than the sheet an
//! electrode shorts the triangle that contains it: a frame hardly depends on the position within
//! the triangle, and jumps from one triangle to the next. Positions are searched among triangles.
//!
//! All parameters are zero at the prior mean. The prior is Gaussian: two Gaussian processes per
//! field on its corners, and independent electrodes.

use std::ops::Range;
use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use super::{SkinFitError, SkinPrior};
use crate::circuit::{ElectrodeSite, ReadoutCircuit};
use crate::fields::NodeFields;
use crate::forward::{ForwardModel, ModelError};
use crate::jacobian::{Field, Mode, circuit_resistors};
use crate::mesh::Mesh;
use crate::network::Resistor;
use crate::responses::UnitResponses;
use crate::sensor::Sensor;
use crate::skin::{
    FieldPrior, LARGEST_ANISOTROPY_LN, SkinElectrodes, SkinField, SkinFields, SkinFoam, SkinGrid,
    rounded,
};

/// Added to the prior variance of a field, as a share: otherwise the covariance of neighbouring
/// corners has no inverse in f64.
const NUGGET: f64 = 1e-4;

/// Number of pieces of the foam's law, first in the vector: ln slopes over equal steps of linear
/// compression.
pub(super) const LAW_PIECES: usize = 20;
/// Length of a piece, mm; all pieces together exceed the compression of a foam of 4 mm and its law.
pub(super) const LAW_STEP_MM: f64 = 0.25;

/// Radius of the search for electrodes, in standard deviations of their position.
const REACH_SD: f64 = 3.2;

/// The fields of the foam and the sheet, in the vector's order.
pub(super) const FIELDS: [Field; 5] =
    [Field::LnA, Field::LnB, Field::LnC, Field::LnCompliance, Field::LnSheetConductance];
/// Number of parameters of an electrode: moves in x and y, mm; logarithms of contact and lead
/// resistance over their prior medians.
const OF_ELECTRODES: usize = 4;

/// One field on its grid.
pub(super) struct FieldBlock {
    pub field: Field,
    grid: SkinGrid,
    prior: FieldPrior,
    /// Range of its corners in the vector.
    pub at: Range<usize>,
    /// For each node or triangle: the corners around it (counted within the field), with weights.
    pub corners: Vec<[(usize, f64); 4]>,
}

impl FieldBlock {
    /// Position of a corner, mm.
    pub fn place_mm(&self, sensor: &Sensor, corner: usize) -> [f64; 2] {
        self.grid.place_mm(sensor, corner)
    }
}

/// Changes of the circuit with the parameters of the sheet and the electrodes, one after the other.
pub(super) struct CircuitChanges {
    /// Changes by the sheet's corners, its anisotropy and the electrodes' contacts.
    pub resistors: Vec<Vec<Resistor>>,
    /// Changes by the leads.
    pub leads: Vec<Mode>,
    /// Indices of these parameters in the vector.
    pub at: Vec<usize>,
}

/// Meaning of the vector for one sensor.
pub(super) struct Parameters {
    sensor: Sensor,
    responses: Arc<UnitResponses>,
    prior: SkinPrior,
    pub blocks: Vec<FieldBlock>,
    /// Index of the sheet's anisotropy; the electrodes follow.
    anisotropy: usize,
    first_electrode: usize,
    electrodes: usize,
    /// Inverse of the prior's covariance.
    pub precision: Mat<f64>,
}

impl Parameters {
    /// Lays out the vector for a sensor; fields are at most as fine as `spacing_mm`.
    ///
    /// # Errors
    /// `SkinFitError::Model` if there is no mesh; `Prior` or `FoamPrior` if a prior has no inverse.
    pub fn new(
        sensor: &Sensor,
        responses: Arc<UnitResponses>,
        prior: SkinPrior,
        spacing_mm: f64,
    ) -> Result<Self, SkinFitError> {
        let mesh = Mesh::new(sensor).map_err(ModelError::from)?;
        let nodes = mesh.nodes_mm.clone();
        let centres: Vec<_> = mesh.triangles.iter().map(|t| mesh.triangle_centre_mm(t)).collect();
        let (mut blocks, mut first) = (Vec::new(), LAW_PIECES);
        for (field, of_field) in FIELDS.into_iter().zip(prior.fields()) {
            let places = if field == Field::LnSheetConductance { &centres } else { &nodes };
            let grid = SkinGrid::of_spacing(sensor, of_field.spacing_mm(spacing_mm));
            let corners = places.iter().map(|&place| grid.weights(sensor, place)).collect();
            let at = first..first + grid.corners();
            first = at.end;
            blocks.push(FieldBlock { field, grid, prior: of_field, at, corners });
        }
        let electrodes = sensor.electrodes_mm().len();
        let mut parameters = Self {
            sensor: sensor.clone(),
            responses,
            prior,
            blocks,
            anisotropy: first,
            first_electrode: first + 1,
            electrodes,
            precision: Mat::zeros(0, 0),
        };
        parameters.precision = parameters.prior_precision()?;
        Ok(parameters)
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.first_electrode + OF_ELECTRODES * self.electrodes
    }

    /// The vector of the skin that `vector` is with coarser fields.
    pub fn refined(&self, coarser: &Self, vector: &[f64]) -> Vec<f64> {
        let mut refined = vector[..LAW_PIECES].to_vec();
        for (block, from) in self.blocks.iter().zip(&coarser.blocks) {
            let values = &vector[from.at.clone()];
            for corner in 0..block.at.len() {
                let place_mm = block.place_mm(&self.sensor, corner);
                let around = from.grid.weights(&self.sensor, place_mm);
                refined.push(around.iter().map(|&(c, w)| w * values[c]).sum());
            }
        }
        refined.extend(&vector[coarser.anisotropy..]);
        refined
    }

    /// Contribution of the prior to the cost.
    pub fn prior_cost(&self, vector: &[f64]) -> f64 {
        let pull = self.prior_pull(vector);
        vector.iter().zip(pull).map(|(v, p)| v * p).sum()
    }

    /// Precision times the vector: half of the gradient of [`Self::prior_cost`].
    pub fn prior_pull(&self, vector: &[f64]) -> Vec<f64> {
        let mut out: Vec<f64> = vec![0.0; vector.len()];
        let law = 0..LAW_PIECES;
        for at in self.blocks.iter().map(|block| block.at.clone()).chain([law]) {
            for j in at.clone() {
                for i in at.clone() {
                    out[i] += self.precision[(i, j)] * vector[j];
                }
            }
        }
        for i in self.anisotropy..self.len() {
            out[i] = self.precision[(i, i)] * vector[i];
        }
        out
    }

    fn prior_precision(&self) -> Result<Mat<f64>, SkinFitError> {
        let mut precision = Mat::zeros(self.len(), self.len());
        for block in &self.blocks {
            let count = block.at.len();
            let places: Vec<[f64; 2]> =
                (0..count).map(|corner| block.place_mm(&self.sensor, corner)).collect();
            let nugget = NUGGET * block.prior.covariance(0.0);
            let covariance = Mat::from_fn(count, count, |i, j| {
                let [p, q] = [places[i], places[j]];
                let own = if i == j { nugget } else { 0.0 };
                block.prior.covariance((p[0] - q[0]).hypot(p[1] - q[1])) + own
            });
            set_inverse(&mut precision, block.at.start, &covariance)
                .ok_or(SkinFitError::Prior(block.field))?;
        }
        let law = Mat::from_fn(LAW_PIECES, LAW_PIECES, |i, j| {
            let t = LAW_STEP_MM * i.abs_diff(j) as f64 / self.prior.foam_mm;
            let own = if i == j { NUGGET } else { 0.0 };
            self.prior.foam_sd.powi(2) * ((-0.5 * t * t).exp() + own)
        });
        set_inverse(&mut precision, 0, &law).ok_or(SkinFitError::FoamPrior)?;
        precision[(self.anisotropy, self.anisotropy)] = 1.0 / self.prior.anisotropy_ln_sd.powi(2);
        let sds = [
            self.prior.electrode_sd_mm,
            self.prior.electrode_sd_mm,
            self.prior.contact_ln_sd,
            self.prior.lead_ln_sd,
        ];
        for (kind, sd) in sds.into_iter().enumerate() {
            for k in 0..self.electrodes {
                let i = self.of_electrode(kind, k);
                precision[(i, i)] = 1.0 / (sd * sd);
            }
        }
        Ok(precision)
    }

    fn of_electrode(&self, kind: usize, electrode: usize) -> usize {
        self.first_electrode + kind * self.electrodes + electrode
    }

    /// Returns a vector with electrodes at `moves` from their positions in the sensor file, mm;
    /// `None` keeps an electrode.
    pub fn with_moves(&self, vector: &[f64], moves: &[Option<[f64; 2]>]) -> Vec<f64> {
        let mut moved = vector.to_vec();
        for (k, by) in moves.iter().enumerate() {
            if let Some(by) = by {
                for axis in 0..2 {
                    moved[self.of_electrode(axis, k)] = by[axis];
                }
            }
        }
        moved
    }

    /// As [`Self::with_moves`], with the resistances of moved electrodes raised at least to the
    /// prior median: values fitted at a wrong position are not valid at another.
    pub fn moved_anew(&self, vector: &[f64], moves: &[Option<[f64; 2]>]) -> Vec<f64> {
        let mut moved = self.with_moves(vector, moves);
        for k in (0..moves.len()).filter(|&k| moves[k].is_some()) {
            for kind in [2, 3] {
                let ln = &mut moved[self.of_electrode(kind, k)];
                *ln = ln.max(0.0);
            }
        }
        moved
    }

    /// Unit of each parameter: 1, and for ln of a resistance below the prior median the step that
    /// changes the resistance by about the median.
    pub fn resistance_scales(&self, vector: &[f64]) -> Vec<f64> {
        let resistances = self.places_at().end;
        let scale =
            |(i, ln): (usize, &f64)| if i < resistances { 1.0 } else { (-ln).exp().max(1.0) };
        vector.iter().enumerate().map(scale).collect()
    }

    /// Index of the sheet's anisotropy in the vector.
    #[cfg(test)]
    pub fn anisotropy(&self) -> usize {
        self.anisotropy
    }

    /// Range of the electrodes' moves in the vector.
    pub fn places_at(&self) -> Range<usize> {
        self.first_electrode..self.of_electrode(2, 0)
    }

    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        self.electrodes
    }

    /// Move of an electrode from its position in the sensor file, mm.
    pub fn move_of(&self, vector: &[f64], electrode: usize) -> [f64; 2] {
        [0, 1].map(|axis| vector[self.of_electrode(axis, electrode)])
    }

    /// Prior cost of a move.
    pub fn move_cost(&self, by_mm: [f64; 2]) -> f64 {
        (by_mm[0].powi(2) + by_mm[1].powi(2)) / self.prior.electrode_sd_mm.powi(2)
    }

    /// For each electrode, moves (mm) to the centres of the nearby triangles, the nearest first.
    ///
    /// # Errors
    /// `ModelError::Mesh` if the mesh does not fit the sensor.
    pub fn places(&self) -> Result<Vec<Vec<[f64; 2]>>, ModelError> {
        let mesh = Mesh::new(&self.sensor)?;
        let centres: Vec<_> = mesh.triangles.iter().map(|t| mesh.triangle_centre_mm(t)).collect();
        let reach_mm = REACH_SD * self.prior.electrode_sd_mm;
        let around = |&[x, y]: &[f64; 2]| {
            let moves = centres.iter().map(|c| [c[0] - x, c[1] - y]);
            let mut near: Vec<[f64; 2]> = moves.filter(|m| m[0].hypot(m[1]) < reach_mm).collect();
            near.sort_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
            near
        };
        Ok(self.sensor.electrodes_mm().iter().map(around).collect())
    }

    /// The sheet's anisotropy, limited to what the mesh can have.
    fn anisotropy_of(&self, vector: &[f64]) -> f64 {
        vector[self.anisotropy].clamp(-LARGEST_ANISOTROPY_LN, LARGEST_ANISOTROPY_LN)
    }

    /// Electrode sites; moves are limited to the skin.
    fn sites(&self, vector: &[f64]) -> Vec<ElectrodeSite> {
        let file = &self.sensor.file;
        let value = |kind: usize, k: usize| vector[self.of_electrode(kind, k)];
        let site = |(k, [x, y]): (usize, &[f64; 2])| ElectrodeSite {
            x_mm: (x + value(0, k)).clamp(0.0, file.width_mm),
            y_mm: (y + value(1, k)).clamp(0.0, file.height_mm),
            contact_ohm: self.prior.contact_ohm * value(2, k).exp(),
            lead_ohm: self.prior.lead_ohm * value(3, k).exp(),
        };
        self.sensor.electrodes_mm().iter().enumerate().map(site).collect()
    }

    /// Builds the model of a vector.
    ///
    /// # Errors
    /// `SkinFitError::Model` if the foam's law or an electrode is invalid.
    pub fn model(&self, vector: &[f64]) -> Result<ForwardModel, SkinFitError> {
        let over = |block: &FieldBlock| -> Vec<f64> {
            let values = &vector[block.at.clone()];
            let at =
                |corners: &[(usize, f64); 4]| corners.iter().map(|&(c, w)| w * values[c]).sum();
            block.corners.iter().map(at).collect()
        };
        let [ln_a, ln_b, ln_c, ln_compliance, ln_sheet_conductance] =
            std::array::from_fn(|field| over(&self.blocks[field]));
        let fields = NodeFields {
            ln_a,
            ln_b,
            ln_c,
            ln_compliance,
            ln_sheet_conductance,
            ln_sheet_anisotropy: self.anisotropy_of(vector),
            displacement: Some(self.foam(vector).law().map_err(ModelError::from)?),
        };
        let responses = Arc::clone(&self.responses);
        Ok(ForwardModel::with(&self.sensor, responses, fields, self.circuit(vector))?)
    }

    /// The readout circuit of a vector.
    pub fn circuit(&self, vector: &[f64]) -> ReadoutCircuit {
        let electrodes = self.sites(vector);
        ReadoutCircuit { electrodes, ..ReadoutCircuit::nominal(&self.sensor) }
    }

    /// The derivatives that are the same at every load, at the model of a vector.
    pub fn circuit_changes(&self, model: &ForwardModel) -> CircuitChanges {
        let sheet = &self.blocks[FIELDS.len() - 1];
        let mut modes: Vec<Mode> =
            sheet.at.clone().map(|_| Mode { field: sheet.field, entries: Vec::new() }).collect();
        for (triangle, corners) in sheet.corners.iter().enumerate() {
            for &(corner, weight) in corners.iter().filter(|(_, weight)| *weight != 0.0) {
                modes[corner].entries.push((triangle as u32, weight));
            }
        }
        modes.push(Mode { field: Field::LnSheetAnisotropy, entries: vec![(0, 1.0)] });
        let sites = &model.circuit().electrodes;
        let of_electrodes = |field: Field, moved: fn(&ElectrodeSite) -> f64| {
            let each = move |(k, site)| Mode { field, entries: vec![(k as u32, moved(site))] };
            sites.iter().enumerate().map(each)
        };
        modes.extend(of_electrodes(Field::ContactOhm, |site| site.contact_ohm));
        CircuitChanges {
            resistors: modes.iter().map(|mode| circuit_resistors(model, mode)).collect(),
            leads: of_electrodes(Field::LeadOhm, |site| site.lead_ohm).collect(),
            at: (sheet.at.start..=self.anisotropy)
                .chain(self.of_electrode(2, 0)..self.len())
                .collect(),
        }
    }

    fn foam(&self, vector: &[f64]) -> SkinFoam {
        SkinFoam { step_mm: LAW_STEP_MM, ln_slopes: vector[..LAW_PIECES].to_vec() }
    }

    /// Shares of the law's pieces in a node's compression, mm after the law: its derivative by the
    /// logarithm of each slope, over that by ln compliance.
    pub fn law_shares(slopes: &[f64; LAW_PIECES], compression_mm: f64) -> [f64; LAW_PIECES] {
        let (mut shares, mut left_mm, mut linear_mm) = ([0.0; LAW_PIECES], compression_mm, 0.0);
        let mut last = slopes[0];
        for (piece, (share, &slope)) in shares.iter_mut().zip(slopes).enumerate() {
            let whole = slope * LAW_STEP_MM;
            let inside = if piece + 1 == LAW_PIECES { left_mm } else { left_mm.min(whole) };
            if inside <= 0.0 {
                break;
            }
            *share = inside;
            linear_mm += inside / slope;
            left_mm -= inside;
            last = slope;
        }
        let by_compliance = last * linear_mm;
        if by_compliance > 0.0 { shares.map(|share| share / by_compliance) } else { shares }
    }

    /// The fields as a calibration stores them.
    pub fn skin_fields(&self, vector: &[f64]) -> SkinFields {
        let mut foam = self.foam(vector);
        foam.ln_slopes.iter_mut().for_each(|ln| *ln = rounded(*ln));
        let [ln_a, ln_b, ln_c, ln_compliance, ln_sheet_conductance] =
            std::array::from_fn(|field| {
                let block = &self.blocks[field];
                SkinField {
                    columns: block.grid.columns,
                    prior: block.prior,
                    values: vector[block.at.clone()].iter().map(|&v| rounded(v)).collect(),
                }
            });
        SkinFields {
            foam,
            ln_a,
            ln_b,
            ln_c,
            ln_compliance,
            ln_sheet_conductance,
            ln_sheet_anisotropy: rounded(self.anisotropy_of(vector)),
        }
    }

    /// The electrodes as a calibration stores them.
    pub fn skin_electrodes(&self, vector: &[f64]) -> SkinElectrodes {
        let sites = self.sites(vector);
        let all = |of: fn(&ElectrodeSite) -> f64| sites.iter().map(|s| rounded(of(s))).collect();
        SkinElectrodes {
            x_mm: all(|s| s.x_mm),
            y_mm: all(|s| s.y_mm),
            contact_ohm: all(|s| s.contact_ohm),
            lead_ohm: all(|s| s.lead_ohm),
        }
    }
}

/// Writes the inverse of a covariance to the diagonal of a matrix; `None` if it has none.
fn set_inverse(into: &mut Mat<f64>, first: usize, covariance: &Mat<f64>) -> Option<()> {
    let count = covariance.nrows();
    let inverse = covariance.llt(Side::Lower).ok()?.solve(Mat::<f64>::identity(count, count));
    into.as_mut().submatrix_mut(first, first, count, count).copy_from(inverse);
    Some(())
}
