//! Rigid tips on a fabric that is bonded to foam: where the fabric goes, and which pressure the foam feels.
//! Uses: `foam`, `field`, faer. Never: voltages, depths of the stage.
//!
//! Unknown are the fabric's descent `w` in each square of a patch around tips that are near each other, and
//! the depth `d` of each tip. In equilibrium, for a square of area A,
//!
//! ```text
//! A s p(w / h) + K w = A sum_t a_t c(d_t + slope_t (x - x_t) - w)        squares
//! sum_squares A a_t c(..) = F_t                                           tips
//! ```
//!
//! with the foam's law p, its local stiffness s, the contact's law c, the share a_t of the square under the
//! tip, and K the tension of the fabric, the shear of the foam (`G h / 3`, V. Z. Vlasov's two-parameter
//! foundation) and the bending of the fabric. Newton's method with the tips eliminated.

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

use crate::field::{Field, normal, stream};
use crate::laws::{CoverLaw, Foam, FoamLaw, Laws};
use crate::{LaminateError, Plan, Touch};

/// Distance from a tip's rim at which the fabric is taken as flat, mm.
const MARGIN_MM: f64 = 20.0;
/// Gap between rims below which tips are solved together, mm.
const NEAR_MM: f64 = 25.0;
/// Samples per side of a square that determine its share under a tip.
const SAMPLES: u32 = 4;
/// Largest residual of an equilibrium, relative to the largest force.
const TOLERANCE: f64 = 1e-8;
const STEPS_MAX: usize = 60;
/// Largest change of a descent in one step, mm.
const STEP_MM: f64 = 0.5;

/// Squares over the skin, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Size of the skin, mm.
    pub size_mm: [f64; 2],
    /// Side of a square, mm.
    pub side_mm: f64,
    /// Number of squares along x and y.
    pub counts: [usize; 2],
}

impl Grid {
    /// Squares of a side that divides the size.
    pub fn new(size_mm: [f64; 2], side_mm: f64) -> Self {
        Self { size_mm, side_mm, counts: size_mm.map(|size| (size / side_mm).round() as usize) }
    }

    /// Number of squares.
    pub fn cells(&self) -> usize {
        self.counts[0] * self.counts[1]
    }

    /// Centre of a square, mm.
    pub fn centre_mm(&self, cell: usize) -> [f64; 2] {
        let at = [cell % self.counts[0], cell / self.counts[0]];
        at.map(|n| (n as f64 + 0.5) * self.side_mm)
    }

    /// Share of a square inside a disc, from `samples` points per side.
    pub fn share(&self, cell: usize, [x_mm, y_mm]: [f64; 2], radius_mm: f64, samples: u32) -> f64 {
        let [cx, cy] = self.centre_mm(cell);
        let away = (cx - x_mm).hypot(cy - y_mm);
        if away > radius_mm + self.side_mm {
            return 0.0;
        }
        let step_mm = self.side_mm / f64::from(samples);
        let place = |n: u32| (f64::from(n) + 0.5) * step_mm - 0.5 * self.side_mm;
        let inside = (0..samples * samples)
            .filter(|n| {
                (cx + place(n % samples) - x_mm).hypot(cy + place(n / samples) - y_mm) <= radius_mm
            })
            .count();
        inside as f64 / f64::from(samples * samples)
    }
}

/// A tip, or a weight, that presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Punch {
    /// Centre of the tip, skin coordinates, mm.
    pub at_mm: [f64; 2],
    /// Normal force, N.
    pub force_n: f64,
    /// Slope of its face against the skin along x and y.
    pub slope: [f64; 2],
}

/// The equilibrium of tips that are near each other.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Indices of its punches.
    pub punches: Vec<usize>,
    /// Depth of the centre of each of them below the untouched fabric, mm.
    pub depths_mm: Vec<f64>,
    /// Pressure in the foam of each square of the patch, MPa.
    pub pressures_mpa: Vec<(usize, f64)>,
    /// Steps of Newton's method.
    pub steps: usize,
}

/// The foam and the fabric of one skin.
#[derive(Debug)]
pub struct Foundation {
    grid: Grid,
    law: FoamLaw,
    cover: CoverLaw,
    foam_mm: f64,
    tip_radius_mm: f64,
    tension_n_per_mm: f64,
    stiffness: Vec<f64>,
    tilts: Tilts,
}

/// Slopes between tips and skin.
#[derive(Debug)]
struct Tilts {
    arms: Vec<[f64; 2]>,
    skin: [Field; 2],
    skin_sd: f64,
}

impl Foundation {
    /// Draws the foundation of a seed.
    pub fn new(plan: &Plan, laws: &Laws, seed: u64) -> Self {
        let smooth = Field::draw(seed, "stiffness", laws.foam.correlation_mm);
        let stiffness = |at: [f64; 2]| (laws.foam.ln_sd * smooth.at(at)).exp();
        let mut rng = stream(seed, "tilts of arms");
        let sd = laws.tips.tilt_sd_deg.to_radians();
        let arms = laws.stage.arm_offsets_mm.iter().map(|_| [0, 1].map(|_| sd * normal(&mut rng)));
        let tilts = Tilts {
            arms: arms.collect(),
            skin: ["slope along x", "slope along y"]
                .map(|name| Field::draw(seed, name, laws.tips.slope_correlation_mm)),
            skin_sd: laws.tips.slope_sd_deg.to_radians(),
        };
        Self::with(plan, laws, plan.size_mm, stiffness, tilts)
    }

    /// A piece of nominal skin, `side_mm` squared, without tilts.
    pub fn nominal(plan: &Plan, laws: &Laws, side_mm: f64) -> Self {
        let flat = || Field::draw(0, "flat", 1.0);
        let tilts = Tilts { arms: Vec::new(), skin: [flat(), flat()], skin_sd: 0.0 };
        Self::with(plan, laws, [side_mm; 2], |_| 1.0, tilts)
    }

    fn with(
        plan: &Plan,
        laws: &Laws,
        size_mm: [f64; 2],
        stiffness: impl Fn([f64; 2]) -> f64,
        tilts: Tilts,
    ) -> Self {
        let grid = Grid::new(size_mm, laws.grid.foam_mm);
        let Foam { law, shear_mpa, .. } = laws.foam;
        Self {
            stiffness: (0..grid.cells()).map(|cell| stiffness(grid.centre_mm(cell))).collect(),
            grid,
            law,
            cover: laws.cover,
            foam_mm: plan.foam_mm,
            tip_radius_mm: plan.tip_diameter_mm / 2.0,
            tension_n_per_mm: laws.cover.tension_n_per_mm + shear_mpa * plan.foam_mm / 3.0,
            tilts,
        }
    }

    /// Returns the squares of the mechanics.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// A touch with the slope of its face.
    pub fn punch(&self, touch: &Touch) -> Punch {
        let slope = self.slope(touch.arm, touch.at_mm);
        Punch { at_mm: touch.at_mm, force_n: touch.force_n, slope }
    }

    /// Slope between the face of an arm's tip and the skin at a place; a weight lies on the skin.
    pub fn slope(&self, arm: usize, at_mm: [f64; 2]) -> [f64; 2] {
        let Some(own) = self.tilts.arms.get(arm) else { return [0.0; 2] };
        [0, 1].map(|axis| own[axis] + self.tilts.skin_sd * self.tilts.skin[axis].at(at_mm))
    }

    /// Mean stiffness of the foam under a tip, relative.
    pub fn stiffness_under(&self, at_mm: [f64; 2]) -> f64 {
        let cells = self.cells_around(&[at_mm], 0.0);
        let shares = cells
            .map(|c| (self.grid.share(c, at_mm, self.tip_radius_mm, SAMPLES), self.stiffness[c]));
        let (sum, share) =
            shares.fold((0.0, 0.0), |(sum, all), (share, s)| (sum + share * s, all + share));
        if share > 0.0 { sum / share } else { 1.0 }
    }

    /// Equilibria of punches, those near each other together.
    ///
    /// # Errors
    /// `LaminateError::Equilibrium` if Newton's method does not converge, `Solve` if its matrix cannot be
    /// factorised.
    pub fn press(&self, punches: &[Punch]) -> Result<Vec<Patch>, LaminateError> {
        self.groups(punches).into_iter().map(|group| self.equilibrium(punches, group)).collect()
    }

    /// Indices of punches that are near each other, directly or through others.
    fn groups(&self, punches: &[Punch]) -> Vec<Vec<usize>> {
        let limit_mm = 2.0 * self.tip_radius_mm + NEAR_MM;
        let near = |a: usize, b: usize| {
            let [p, q] = [punches[a].at_mm, punches[b].at_mm];
            (p[0] - q[0]).hypot(p[1] - q[1]) < limit_mm
        };
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for punch in 0..punches.len() {
            let (with, apart): (Vec<_>, Vec<_>) =
                groups.into_iter().partition(|group| group.iter().any(|&other| near(punch, other)));
            groups = apart;
            groups.push(with.into_iter().flatten().chain([punch]).collect());
        }
        groups
    }

    /// Squares of the smallest rectangle around tips, with a margin.
    fn cells_around(
        &self,
        places_mm: &[[f64; 2]],
        margin_mm: f64,
    ) -> impl Iterator<Item = usize> + use<> {
        let reach_mm = self.tip_radius_mm + margin_mm;
        let range = |axis: usize| {
            let of = |fold: fn(f64, f64) -> f64, from: f64| {
                places_mm.iter().map(|place| place[axis]).fold(from, fold)
            };
            let low = (of(f64::min, f64::INFINITY) - reach_mm) / self.grid.side_mm;
            let high = (of(f64::max, f64::NEG_INFINITY) + reach_mm) / self.grid.side_mm;
            (low.floor().max(0.0) as usize)..(high.ceil() as usize).min(self.grid.counts[axis])
        };
        let (columns, rows, width) = (range(0), range(1), self.grid.counts[0]);
        rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
    }

    fn equilibrium(&self, all: &[Punch], group: Vec<usize>) -> Result<Patch, LaminateError> {
        let punches: Vec<Punch> = group.iter().map(|&n| all[n]).collect();
        let places: Vec<_> = punches.iter().map(|p| p.at_mm).collect();
        let cells: Vec<usize> = self.cells_around(&places, MARGIN_MM).collect();
        let area = self.grid.side_mm.powi(2);
        // Under each tip: the square in the patch, its area under the tip, the height of the face above
        // its centre.
        let faces: Vec<Vec<(usize, f64, f64)>> = punches
            .iter()
            .map(|punch| {
                let under = cells.iter().enumerate().map(|(n, &cell)| {
                    let [x, y] = self.grid.centre_mm(cell);
                    let share = self.grid.share(cell, punch.at_mm, self.tip_radius_mm, SAMPLES);
                    let [dx, dy] = [x - punch.at_mm[0], y - punch.at_mm[1]];
                    (n, area * share, punch.slope[0] * dx + punch.slope[1] * dy)
                });
                under.filter(|&(_, share, _)| share > 0.0).collect()
            })
            .collect();
        let coupling = Coupling::new(self, &cells)?;
        let (mut w, mut d) = self.first_guess(&punches, &faces, cells.len());
        let largest_n = punches.iter().map(|p| p.force_n).fold(0.0, f64::max);
        let mut state = self.state(&cells, &punches, &faces, &coupling, &w, &d);
        for steps in 0..STEPS_MAX {
            let residual_n = state.residual_n();
            if residual_n < TOLERANCE * largest_n {
                let pressure = |(n, &cell): (usize, &usize)| {
                    let strain = w[n] / self.foam_mm;
                    (cell, self.stiffness[cell] * self.law.pressure(strain).pressure_mpa)
                };
                let pressures_mpa = cells.iter().enumerate().map(pressure).collect();
                return Ok(Patch { punches: group, depths_mm: d, pressures_mpa, steps });
            }
            let (dw, dd) = coupling.step(&state, &faces)?;
            let longest = dw.iter().chain(&dd).fold(0.0, |m: f64, v| m.max(v.abs()));
            let mut share = (STEP_MM / longest).min(1.0);
            // The contact's law is exponential: a step that is too long is halved.
            loop {
                let moved = |from: &[f64], by: &[f64]| -> Vec<f64> {
                    from.iter().zip(by).map(|(v, dv)| v + share * dv).collect()
                };
                let (next_w, next_d) = (moved(&w, &dw), moved(&d, &dd));
                let next = self.state(&cells, &punches, &faces, &coupling, &next_w, &next_d);
                if next.residual_n() < residual_n || share < 1e-3 {
                    (w, d, state) = (next_w, next_d, next);
                    break;
                }
                share /= 2.0;
            }
        }
        Err(LaminateError::Equilibrium {
            steps: STEPS_MAX,
            residual_n: state.residual_n(),
            force_n: largest_n,
        })
    }

    /// Each tip alone on foam whose columns do not touch.
    fn first_guess(
        &self,
        punches: &[Punch],
        faces: &[Vec<(usize, f64, f64)>],
        cells: usize,
    ) -> (Vec<f64>, Vec<f64>) {
        let mut w = vec![0.0; cells];
        let mut d = Vec::with_capacity(punches.len());
        for (punch, face) in punches.iter().zip(faces) {
            let area: f64 = face.iter().map(|(_, share, _)| share).sum();
            let pressure_mpa = punch.force_n / area.max(f64::MIN_POSITIVE);
            let under_mm = self.foam_mm * self.law.strain(pressure_mpa);
            for &(n, share, _) in face {
                w[n] = under_mm * (share / self.grid.side_mm.powi(2));
            }
            d.push(under_mm + self.cover.overlap_mm(pressure_mpa));
        }
        (w, d)
    }

    fn state(
        &self,
        cells: &[usize],
        punches: &[Punch],
        faces: &[Vec<(usize, f64, f64)>],
        coupling: &Coupling,
        w: &[f64],
        d: &[f64],
    ) -> State {
        let area = self.grid.side_mm.powi(2);
        let mut squares_n = coupling.forces_n(w);
        let mut slopes = vec![0.0; cells.len()];
        for ((n, &cell), &w) in cells.iter().enumerate().zip(w) {
            let value = self.law.pressure(w / self.foam_mm);
            squares_n[n] += area * self.stiffness[cell] * value.pressure_mpa;
            slopes[n] = area * self.stiffness[cell] * value.slope / self.foam_mm;
        }
        let mut tips_n: Vec<f64> = punches.iter().map(|p| p.force_n).collect();
        let mut contacts: Vec<Vec<f64>> = Vec::with_capacity(faces.len());
        for ((face, d), tip_n) in faces.iter().zip(d).zip(&mut tips_n) {
            let each = face.iter().map(|&(n, share, height_mm)| {
                let contact = self.cover.contact(d + height_mm - w[n]);
                squares_n[n] -= share * contact.pressure_mpa;
                *tip_n -= share * contact.pressure_mpa;
                slopes[n] += share * contact.slope;
                share * contact.slope
            });
            contacts.push(each.collect());
        }
        State { squares_n, tips_n, slopes, contacts }
    }
}

/// Residuals and their slopes.
struct State {
    /// Force that is not balanced in each square, N.
    squares_n: Vec<f64>,
    /// Force that each tip still lacks, N.
    tips_n: Vec<f64>,
    /// Slope of the square's own forces, N/mm.
    slopes: Vec<f64>,
    /// Slope of the contact of each square under each tip, N/mm.
    contacts: Vec<Vec<f64>>,
}

impl State {
    /// Largest force that is not balanced, N; infinite if one is not a number.
    fn residual_n(&self) -> f64 {
        let size = |v: &f64| if v.is_nan() { f64::INFINITY } else { v.abs() };
        self.squares_n.iter().chain(&self.tips_n).map(size).fold(0.0, f64::max)
    }
}

/// Tension and bending between the squares of a patch: K, its lower half by columns.
struct Coupling {
    matrix: SparseColMat<usize, f64>,
    symbolic: SymbolicLlt<usize>,
}

impl Coupling {
    fn new(foundation: &Foundation, cells: &[usize]) -> Result<Self, LaminateError> {
        let grid = &foundation.grid;
        let [width, height] = grid.counts;
        let first = cells.first().copied().unwrap_or(0);
        let columns = cells.iter().take_while(|&&cell| cell / width == first / width).count();
        let inside = |x: usize, y: usize| {
            let (left, top) = (first % width, first / width);
            let at = (x.checked_sub(left)?, y.checked_sub(top)?);
            (at.0 < columns && at.1 * columns + at.0 < cells.len()).then(|| at.1 * columns + at.0)
        };
        let bending = foundation.cover.bending_n_mm / grid.side_mm.powi(2);
        let mut entries = Vec::with_capacity(cells.len() * 20);
        let mut add = |a: usize, b: usize, value: f64| {
            if a >= b {
                entries.push(Triplet::new(a, b, value));
            }
        };
        for (n, &cell) in cells.iter().enumerate() {
            let (x, y) = (cell % width, cell / width);
            let beside = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            // The row of the Laplacian: a neighbour outside the patch is flat, one outside the skin absent.
            let mut row = vec![(n, 0.0)];
            for (x, y) in beside.into_iter().filter(|&(x, y)| x < width && y < height) {
                row[0].1 += 1.0;
                if let Some(other) = inside(x, y) {
                    row.push((other, -1.0));
                }
            }
            for &(a, value) in &row {
                add(n, a, foundation.tension_n_per_mm * value);
            }
            for &(a, left) in &row {
                for &(b, right) in &row {
                    add(a, b, bending * left * right);
                }
            }
        }
        let matrix = SparseColMat::try_new_from_triplets(cells.len(), cells.len(), &entries)
            .map_err(|why| solve("press", &why))?;
        let symbolic = SymbolicLlt::try_new(matrix.symbolic(), Side::Lower)
            .map_err(|why| solve("press", &why))?;
        Ok(Self { matrix, symbolic })
    }

    /// Returns `K w`: the force on each square, N, under the displacements `w`, mm.
    fn forces_n(&self, w: &[f64]) -> Vec<f64> {
        let mut forces = vec![0.0; w.len()];
        for entry in self.matrix.triplet_iter() {
            forces[entry.row] += entry.val * w[entry.col];
            if entry.row != entry.col {
                forces[entry.col] += entry.val * w[entry.row];
            }
        }
        forces
    }

    /// A step of Newton's method: changes of descents and depths.
    fn step(
        &self,
        state: &State,
        faces: &[Vec<(usize, f64, f64)>],
    ) -> Result<(Vec<f64>, Vec<f64>), LaminateError> {
        let (squares, tips) = (state.squares_n.len(), faces.len());
        let mut matrix = self.matrix.clone();
        let starts: Vec<usize> = matrix.symbolic().col_ptr()[..squares].to_vec();
        for (start, slope) in starts.into_iter().zip(&state.slopes) {
            matrix.val_mut()[start] += slope; // the diagonal is first in a lower column
        }
        let factor =
            Llt::try_new_with_symbolic(self.symbolic.clone(), matrix.as_ref(), Side::Lower)
                .map_err(|why| solve("press", &why))?;
        // The last column is the residual, the others what moves with each tip.
        let mut columns = Mat::<f64>::zeros(squares, tips + 1);
        for (tip, (face, contacts)) in faces.iter().zip(&state.contacts).enumerate() {
            for (&(n, ..), slope) in face.iter().zip(contacts) {
                columns[(n, tip)] += slope;
            }
        }
        let pushes = columns.clone();
        for (n, residual) in state.squares_n.iter().enumerate() {
            columns[(n, tips)] = -residual;
        }
        factor.solve_in_place(columns.as_mut());
        let product = |tip: usize, column: usize| -> f64 {
            faces[tip].iter().map(|&(n, ..)| pushes[(n, tip)] * columns[(n, column)]).sum()
        };
        let mut small = Mat::<f64>::zeros(tips, tips);
        let mut right = Mat::<f64>::zeros(tips, 1);
        for tip in 0..tips {
            for other in 0..tips {
                small[(tip, other)] = -product(tip, other);
            }
            small[(tip, tip)] += state.contacts[tip].iter().sum::<f64>();
            right[(tip, 0)] = state.tips_n[tip] + product(tip, tips);
        }
        small.partial_piv_lu().solve_in_place(right.as_mut());
        let depths: Vec<f64> = (0..tips).map(|tip| right[(tip, 0)]).collect();
        let descents = (0..squares).map(|n| {
            let with_tips: f64 =
                depths.iter().enumerate().map(|(tip, d)| columns[(n, tip)] * d).sum();
            columns[(n, tips)] + with_tips
        });
        Ok((descents.collect(), depths))
    }
}

pub(crate) fn solve(part: &'static str, why: &dyn std::fmt::Debug) -> LaminateError {
    LaminateError::Solve { part, why: format!("{why:?}") }
}
