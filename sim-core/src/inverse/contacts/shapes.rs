//! Table of the contribution of a contact at any position, with any force, to a projected frame.
//! Uses: the batch model, the lattice under the tips, the basis. Never: final results (the exact
//! model refines the contacts).
//!
//! The table contains the frame of one contact on each node of the lattice at some forces, divided
//! by the strength of a reference contact of that force. Between nodes it is linear in the
//! lattice's triangles, between forces linear in ln F. Frames of several contacts are approximated
//! by the sum: the error is small, and known after one exact frame ([`super::search`]).

use super::FitterError;
use super::basis::Basis;
use super::dense::dot;
use crate::batch::{BatchModel, BatchWork};
use crate::forward::{Contact, ForwardModel};

/// Forces of the table, N.
const LEVELS_N: [f64; 8] = [1.5, 3.0, 5.5, 9.0, 15.0, 24.0, 40.0, 80.0];
/// Smallest and largest force of the reference contact, N, and the number of steps between them.
const STRENGTH_N: [f64; 2] = [0.2, 160.0];
const STRENGTH_STEPS: usize = 64;
/// Trials in a batch.
const SHAPE_TRIALS: usize = 256;

/// x (mm), y (mm), ln of the force in N.
pub(super) type Place = [f64; 3];

/// The contact of a place in parameter space.
pub(super) fn contact([x_mm, y_mm, ln_force]: Place) -> Contact {
    Contact { x_mm, y_mm, force_n: ln_force.exp() }
}

/// The table of one model.
#[derive(Debug, Clone)]
pub(super) struct Shapes {
    width: usize,
    /// `[(node * levels + level) * width + number]`, per strength.
    table: Vec<f32>,
    /// ln of the reference contact's strength, evenly spaced in ln F.
    strength: Vec<f64>,
    /// Nodes of a search: every third node, the points included.
    sites: Vec<u32>,
    sites_mm: Vec<[f64; 2]>,
    /// Limits of a contact's position, mm: `[axis][end]`.
    pub limits_mm: [[f64; 2]; 2],
}

impl Shapes {
    /// Computes the table; takes some seconds.
    ///
    /// # Errors
    /// `FitterError::Batch` if the model rejects a load of the table.
    pub fn new(
        model: &ForwardModel,
        batch: &BatchModel,
        basis: &Basis,
    ) -> Result<Self, FitterError> {
        let file = &model.sensor().file;
        let radius = file.tip_diameter_mm / 2.0;
        let limits_mm = [file.width_mm, file.height_mm].map(|extent| [radius, extent - radius]);
        let inside = |axis: usize, mm: f64| mm.clamp(limits_mm[axis][0], limits_mm[axis][1]);
        let mut run = Runs { batch, basis, work: BatchWork::default() };
        let centre = [file.width_mm / 2.0, file.height_mm / 2.0];
        let strength = run.strength(model, centre)?;
        let mut shapes = Self {
            width: basis.width(),
            table: Vec::new(),
            strength,
            sites: Vec::new(),
            sites_mm: Vec::new(),
            limits_mm,
        };
        let scales = LEVELS_N.map(|force_n| 1.0 / shapes.strength(force_n.ln()).0);
        let nodes = &model.mesh().nodes_mm;
        let loads: Vec<Contact> = nodes
            .iter()
            .flat_map(|&[x, y]| LEVELS_N.map(|f| [inside(0, x), inside(1, y), f]))
            .map(|[x_mm, y_mm, force_n]| Contact { x_mm, y_mm, force_n })
            .collect();
        shapes.table.reserve(loads.len() * shapes.width);
        run.each(&loads, |index, z| {
            let scale = scales[index % LEVELS_N.len()];
            shapes.table.extend(z.iter().map(|z| (z * scale) as f32));
        })?;
        let mut six_valent: Vec<u32> = model.mesh().triangles.iter().map(|t| t[0]).collect();
        six_valent.sort_unstable();
        six_valent.dedup();
        let legal = |&node: &u32| {
            let [x, y] = nodes[node as usize];
            x == inside(0, x) && y == inside(1, y)
        };
        shapes.sites = six_valent.into_iter().filter(legal).collect();
        shapes.sites_mm = shapes.sites.iter().map(|&node| nodes[node as usize]).collect();
        Ok(shapes)
    }

    /// Positions of the sites of a search, mm.
    pub fn sites_mm(&self) -> &[[f64; 2]] {
        &self.sites_mm
    }

    /// Frame of a site at the force of the table nearest to `ln_force`, per strength.
    pub fn of_site(&self, site: usize, ln_force: f64) -> &[f32] {
        let distance = |level: &usize| (LEVELS_N[*level].ln() - ln_force).abs();
        let level = (0..LEVELS_N.len())
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .unwrap_or_default();
        self.row(self.sites[site], level)
    }

    fn row(&self, node: u32, level: usize) -> &[f32] {
        &self.table[(node as usize * LEVELS_N.len() + level) * self.width..][..self.width]
    }

    /// Strength of the reference contact, and its relative slope in ln F.
    pub fn strength(&self, ln_force: f64) -> (f64, f64) {
        let [low, high] = STRENGTH_N.map(f64::ln);
        let step = (high - low) / STRENGTH_STEPS as f64;
        let place = ((ln_force - low) / step).clamp(0.0, STRENGTH_STEPS as f64 - 1e-9);
        let cell = place as usize;
        let (a, b) = (self.strength[cell], self.strength[cell + 1]);
        let beyond = (ln_force - low) / step - place;
        let slope = (b - a) / step;
        ((a + (b - a) * (place - cell as f64 + beyond)).exp(), slope)
    }

    /// Force that has a given strength, as ln F.
    pub fn ln_force_of(&self, strength: f64) -> f64 {
        let [low, high] = STRENGTH_N.map(f64::ln);
        let step = (high - low) / STRENGTH_STEPS as f64;
        let ln = strength.max(1e-12).ln();
        let cell = self.strength.partition_point(|s| *s < ln).clamp(1, STRENGTH_STEPS) - 1;
        let (a, b) = (self.strength[cell], self.strength[cell + 1]);
        (low + step * (cell as f64 + (ln - a) / (b - a))).clamp(low, high)
    }

    /// Adds a contact's frame to `sum`, and writes its slopes in x, y and ln F (each of `width`
    /// values).
    pub fn add(&self, model: &ForwardModel, place: Place, sum: &mut [f64], slopes: &mut [f64]) {
        let [x_mm, y_mm, ln_force] = place;
        let (strength, rise) = self.strength(ln_force);
        let ends = LEVELS_N.map(f64::ln);
        let level = ends.partition_point(|l| *l < ln_force).clamp(1, ends.len() - 1) - 1;
        let step = ends[level + 1] - ends[level];
        let raw = (ln_force - ends[level]) / step;
        let share = raw.clamp(0.0, 1.0);
        // Per ln F: the strength grows, and the shape changes towards the next level.
        let moves = if raw == share { 1.0 / step } else { 0.0 };
        let mix = [strength * (1.0 - share), strength * share];
        let grow = [rise * mix[0] - strength * moves, rise * mix[1] + strength * moves];
        slopes.fill(0.0);
        let (along_x, rest) = slopes.split_at_mut(self.width);
        let (along_y, along_f) = rest.split_at_mut(self.width);
        for corner in model.lattice().around([x_mm, y_mm]).into_iter().flatten() {
            let (low, high) = (self.row(corner.node, level), self.row(corner.node, level + 1));
            let [slope_x, slope_y] = corner.slope_per_mm;
            let weight = corner.sixths;
            for d in 0..self.width {
                let (low, high) = (f64::from(low[d]), f64::from(high[d]));
                let value = mix[0] * low + mix[1] * high;
                sum[d] += weight * value;
                along_x[d] += slope_x * value;
                along_y[d] += slope_y * value;
                along_f[d] += weight * (grow[0] * low + grow[1] * high);
            }
        }
    }
}

/// Runs of the batch model, projected.
struct Runs<'a> {
    batch: &'a BatchModel,
    basis: &'a Basis,
    work: BatchWork,
}

impl Runs<'_> {
    fn each(
        &mut self,
        loads: &[Contact],
        mut take: impl FnMut(usize, &[f64]),
    ) -> Result<(), FitterError> {
        let channels = self.batch.frame_len();
        let mut frames = vec![0f32; SHAPE_TRIALS * channels];
        let (mut frame_v, mut scratch, mut z) = (Vec::new(), Vec::new(), Vec::new());
        for (first, loads) in loads.chunks(SHAPE_TRIALS).enumerate() {
            let trials: Vec<&[Contact]> = loads.iter().map(std::slice::from_ref).collect();
            let frames = &mut frames[..trials.len() * channels];
            self.batch.voltages(&trials, frames, &mut self.work)?;
            for (index, frame) in frames.chunks_exact(channels).enumerate() {
                frame_v.clear();
                frame_v.extend(frame.iter().map(|&v| f64::from(v)));
                self.basis.project_frame(&frame_v, &mut scratch, &mut z);
                take(first * SHAPE_TRIALS + index, &z);
            }
        }
        Ok(())
    }

    /// ln of the projected length of a reference contact, at even steps of ln F.
    fn strength(
        &mut self,
        model: &ForwardModel,
        [x, y]: [f64; 2],
    ) -> Result<Vec<f64>, FitterError> {
        let nearest = model.sensor().nearest_point([x, y]);
        let [x_mm, y_mm] = nearest.map_or([x, y], |p| [p.x_mm, p.y_mm]);
        let [low, high] = STRENGTH_N.map(f64::ln);
        let step = (high - low) / STRENGTH_STEPS as f64;
        let loads: Vec<Contact> = (0..=STRENGTH_STEPS)
            .map(|i| Contact { x_mm, y_mm, force_n: (low + step * i as f64).exp() })
            .collect();
        let mut strength = Vec::new();
        self.each(&loads, |_, z| strength.push(dot(z, z).sqrt().max(1e-9).ln()))?;
        Ok(strength)
    }
}
