//! The high-resistance fabric: finite volumes on squares, disc electrodes, the readout's differences.
//! Uses: `field`, `press::Grid`, faer. Never: pressures.
//!
//! Unknown are the potentials of the squares and of the electrodes below the top layer. With `Z = E' A^-1 E`
//! and electrode k at 0 V, the others are at `V_j = V0 (1 - Z_jk / Z_kk)`: superposition, as in any network
//! with one source.

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

use crate::field::{Field, normal, stream};
use crate::laws::Laws;
use crate::press::{Grid, solve};
use crate::{LaminateError, Plan};

/// Samples per side of a square that determine its share under an electrode.
const SAMPLES: u32 = 16;

/// The sheet of one skin with its electrodes.
#[derive(Debug)]
pub struct Sheet {
    grid: Grid,
    source_v: f64,
    leads_ohm: Vec<f64>,
    /// The network without leaks, its lower half by columns: squares, then electrodes.
    matrix: SparseColMat<usize, f64>,
    symbolic: SymbolicLlt<usize>,
    resistors: Vec<Resistor>,
}

/// A resistor of the network: squares, then electrodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistor {
    /// Indices of the two nodes that it connects.
    pub between: [usize; 2],
    /// Its conductance, S.
    pub conductance_s: f64,
}

impl Sheet {
    /// Draws the sheet of a seed.
    ///
    /// # Errors
    /// `LaminateError::Solve` if the network is not one.
    pub fn new(plan: &Plan, laws: &Laws, seed: u64) -> Result<Self, LaminateError> {
        let grid = Grid::new(plan.size_mm, laws.grid.sheet_mm);
        let resistors = resistors(&grid, plan, laws, seed);
        let mut rng = stream(seed, "leads");
        let e = &laws.electrodes;
        let leads =
            plan.electrodes_mm.iter().map(|_| e.lead_ohm * (e.lead_ln_sd * normal(&mut rng)).exp());
        let leads_ohm: Vec<f64> = leads.collect();
        let nodes = grid.cells() + leads_ohm.len();
        let mut entries = Vec::with_capacity(3 * resistors.len() + nodes);
        entries.extend((0..nodes).map(|n| Triplet::new(n, n, 0.0)));
        for &Resistor { between: [a, b], conductance_s } in &resistors {
            entries.push(Triplet::new(a, a, conductance_s));
            entries.push(Triplet::new(b, b, conductance_s));
            entries.push(Triplet::new(a.max(b), a.min(b), -conductance_s));
        }
        let matrix = SparseColMat::try_new_from_triplets(nodes, nodes, &entries)
            .map_err(|why| solve("sheet", &why))?;
        let symbolic = SymbolicLlt::try_new(matrix.symbolic(), Side::Lower)
            .map_err(|why| solve("sheet", &why))?;
        Ok(Self { grid, source_v: plan.source_v, leads_ohm, matrix, symbolic, resistors })
    }

    /// The resistors of the sheet and of the contacts of its electrodes, without leaks.
    pub fn resistors(&self) -> &[Resistor] {
        &self.resistors
    }

    /// Resistance of each electrode's lead, ohm: it carries current only during its injection.
    pub fn leads_ohm(&self) -> &[f64] {
        &self.leads_ohm
    }

    /// Returns the squares of the sheet.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Leaks of the sheet's squares, S, from conductances per area of finer ones, S/mm^2.
    pub fn gather(&self, from: &Grid, s_per_mm2: &[f64]) -> Vec<f64> {
        let area = from.side_mm.powi(2);
        let ratio = (self.grid.side_mm / from.side_mm).round() as usize;
        let mut leaks = vec![0.0; self.grid.cells()];
        for (cell, conductance) in s_per_mm2.iter().enumerate() {
            let at = [cell % from.counts[0] / ratio, cell / from.counts[0] / ratio];
            leaks[at[1] * self.grid.counts[0] + at[0]] += area * conductance;
        }
        leaks
    }

    /// Impedances between electrodes and top layer with leaks from each square to it, ohm, `[n * j + k]`,
    /// without leads.
    ///
    /// # Errors
    /// `LaminateError::Solve` if the network cannot be solved: without a leak there is no current.
    pub fn impedances_ohm(&self, leaks_s: &[f64]) -> Result<Vec<f64>, LaminateError> {
        let (squares, count) = (self.grid.cells(), self.leads_ohm.len());
        let mut matrix = self.matrix.clone();
        let starts: Vec<usize> = matrix.symbolic().col_ptr()[..squares].to_vec();
        for (start, leak) in starts.into_iter().zip(leaks_s) {
            matrix.val_mut()[start] += leak; // the diagonal is first in a lower column
        }
        let factor =
            Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower)
                .map_err(|why| solve("sheet", &why))?;
        let mut columns = Mat::<f64>::zeros(squares + count, count);
        for electrode in 0..count {
            columns[(squares + electrode, electrode)] = 1.0;
        }
        factor.solve_in_place(columns.as_mut());
        let z = (0..count * count).map(|n| columns[(squares + n / count, n % count)]);
        Ok(z.collect())
    }

    /// The frame with leaks from each square to the top layer, V after gain, `[n * k + j]`.
    ///
    /// # Errors
    /// As [`Sheet::impedances_ohm`].
    pub fn frame_v(&self, leaks_s: &[f64]) -> Result<Vec<f64>, LaminateError> {
        let count = self.leads_ohm.len();
        let z = self.impedances_ohm(leaks_s)?;
        let mut frame = Vec::with_capacity(count * count);
        for (k, lead_ohm) in self.leads_ohm.iter().enumerate() {
            let own = z[count * k + k] + lead_ohm;
            let volts: Vec<f64> = (0..count)
                .map(|j| if j == k { 0.0 } else { self.source_v * (own - z[count * j + k]) / own })
                .collect();
            frame.extend((0..count).map(|j| volts[j] - volts[(j + 1) % count]));
        }
        Ok(frame)
    }
}

/// Resistors between squares (half of each square's in series), and from the squares under each disc to its
/// electrode.
fn resistors(grid: &Grid, plan: &Plan, laws: &Laws, seed: u64) -> Vec<Resistor> {
    let [width, height] = grid.counts;
    let smooth = Field::draw(seed, "sheet", laws.sheet.correlation_mm);
    let nominal_s = 1.0 / plan.sheet_ohm_per_sq;
    let of_cell: Vec<f64> = (0..grid.cells())
        .map(|cell| nominal_s * (laws.sheet.ln_sd * smooth.at(grid.centre_mm(cell))).exp())
        .collect();
    let along = [laws.sheet.anisotropy.sqrt(), 1.0 / laws.sheet.anisotropy.sqrt()];
    let mut all = Vec::with_capacity(2 * grid.cells());
    for cell in 0..grid.cells() {
        let (x, y) = (cell % width, cell / width);
        for (axis, other) in
            [(0, (x + 1 < width).then(|| cell + 1)), (1, (y + 1 < height).then(|| cell + width))]
        {
            if let Some(other) = other {
                let (a, b) = (of_cell[cell], of_cell[other]);
                let conductance_s = along[axis] * 2.0 * a * b / (a + b);
                all.push(Resistor { between: [cell, other], conductance_s });
            }
        }
    }
    let e = &laws.electrodes;
    let mut rng = stream(seed, "electrodes");
    let radius_mm = e.diameter_mm / 2.0;
    for (electrode, nominal) in plan.electrodes_mm.iter().enumerate() {
        let mut at = [0.0; 2];
        for axis in 0..2 {
            let moved = nominal[axis] + e.offset_sd_mm * normal(&mut rng);
            at[axis] = moved.clamp(radius_mm, plan.size_mm[axis] - radius_mm);
        }
        let contact_ohm_mm2 = e.contact_ohm_mm2 * (e.contact_ln_sd * normal(&mut rng)).exp();
        for cell in 0..grid.cells() {
            let area = grid.share(cell, at, radius_mm, SAMPLES) * grid.side_mm.powi(2);
            if area > 0.0 {
                let between = [cell, grid.cells() + electrode];
                all.push(Resistor { between, conductance_s: area / contact_ohm_mm2 });
            }
        }
    }
    all
}
