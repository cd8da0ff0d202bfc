//! A virtual skin, selected by a seed: the reality gap on top of the nominal model, and the
//! mechanics of the tips.
//! Uses: `sim-core`, gap files. Never: wires, registers, the clock (process times are passed in).
//!
//! [`Skin`] returns the static voltages of a held load; [`Readout`] creates frames from them, with
//! drift and noise; [`mechanics::Mechanics`] determines the force of each tip.

mod any;
mod cache;
pub mod chance;
pub mod gap;
pub mod mechanics;
mod readout;
#[cfg(test)]
mod tests;

use std::path::Path;

use rand_distr::{Distribution, StandardNormal};
use sim_core::circuit::{ElectrodeSite, ReadoutCircuit};
use sim_core::deformation::NodeForce;
use sim_core::fields::{DisplacementLut, LutError, LutGrid, NodeFields};
use sim_core::forward::{ForwardModel, ModelError, POINT_TOLERANCE_MM, Workspace};
use sim_core::mesh::Mesh;
use sim_core::responses::ResponsesError;
use sim_core::sensor::Sensor;

pub use any::{AnyMechanics, AnyReadout, AnySkin, GapFile};
use chance::{SmoothField, normal_at, stream};
pub use gap::{Gap, GapError};
use mechanics::Stroke;
pub use readout::Readout;

/// Linear compression at the end of the table of the foam's law, mm; beyond it the table is
/// extrapolated (240 N compress 20 mm).
const LUT_GRID: LutGrid = LutGrid { step_mm: 0.01, end_mm: 30.0 };

/// Reason why a skin cannot be built.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SkinError {
    #[error(transparent)]
    Responses(#[from] ResponsesError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error("gap: foam law: {0}")]
    Foam(#[from] LutError),
    #[error("gap: laminate: {0}")]
    Laminate(#[from] laminate::LaminateError),
}

/// A tip or a weight that presses on the skin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipLoad {
    /// Index of the tip (0 = arm 1), which determines its tilt.
    pub arm: usize,
    /// x of its centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of its centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Force, N; a load without a positive force or without a valid position is ignored.
    pub force_n: f64,
    /// Whether the force has fallen since it was largest: only a skin of another physics knows it.
    pub stroke: Stroke,
}

/// One virtual skin: a sensor, a gap and a seed. `Send + Sync`.
#[derive(Debug)]
pub struct Skin {
    model: ForwardModel,
    tilt_sd: f64,
    seed: u64,
}

impl Skin {
    /// Builds a skin. The unit responses (seconds of work) are read from `cache_dir` if they are
    /// there, and left there if they are not.
    ///
    /// # Errors
    /// `SkinError` if the unit responses cannot be solved, or sensor and gap do not match.
    pub fn new(
        sensor: Sensor,
        gap: Gap,
        seed: u64,
        cache_dir: Option<&Path>,
    ) -> Result<Self, SkinError> {
        let responses = cache::unit_responses(&sensor, cache_dir)?;
        let mesh = Mesh::new(&sensor).map_err(ModelError::Mesh)?;
        let circuit = circuit(&sensor, &gap, seed);
        let fields = fields(&mesh, &sensor, &gap, seed)?;
        let model = ForwardModel::with(&sensor, responses, fields, circuit)?;
        Ok(Self { model, tilt_sd: gap.tips.tilt_sd, seed })
    }

    /// The forward model of this skin: the true values for a calibration.
    pub fn model(&self) -> &ForwardModel {
        &self.model
    }

    /// Static voltages of a held load, V after gain, injection-major, electrodes squared. The force
    /// of a tip between points is distributed over the three nearest.
    pub fn solve(&self, tips: &[TipLoad]) -> Vec<f64> {
        let mut forces = Vec::with_capacity(6 * tips.len());
        let presses = |t: &&TipLoad| {
            t.force_n > 0.0 && [t.force_n, t.x_mm, t.y_mm].into_iter().all(f64::is_finite)
        };
        for tip in tips.iter().filter(presses) {
            let points = points_under(self.model.sensor(), tip.x_mm, tip.y_mm);
            let Some(&(nearest, _)) = points.first() else { continue };
            let shares = self.vertex_shares(tip.arm, nearest);
            for (point, weight) in points {
                let vertices = self.model.mesh().points[point].vertices;
                for (node, share) in vertices.into_iter().zip(shares) {
                    forces.push(NodeForce { node, force_n: tip.force_n * weight * share });
                }
            }
        }
        let mut work = Workspace::default();
        self.model.voltages_of_node_forces(&forces, &mut work).to_vec()
    }

    /// Shares of a tip's force on its six vertices (sum 1): a fixed tilt of the tip, and one that
    /// depends on the nearest point, so that a tip that returns has the same tilt.
    fn vertex_shares(&self, arm: usize, nearest: usize) -> [f64; 6] {
        let half_sd = self.tilt_sd / 2f64.sqrt();
        let own = format!("tilt of tip {arm}");
        let press = format!("tilt of tip {arm} on point {nearest}");
        let tilt = [0, 1].map(|axis| {
            half_sd * (normal_at(self.seed, &own, axis) + normal_at(self.seed, &press, axis))
        });
        let shares: [f64; 6] = std::array::from_fn(|vertex| {
            // Vertices run counter-clockwise from +y.
            let angle =
                std::f64::consts::FRAC_PI_2 + std::f64::consts::FRAC_PI_3 * f64::from(vertex as u8);
            (1.0 + tilt[0] * angle.cos() + tilt[1] * angle.sin()).max(0.0)
        });
        let sum: f64 = shares.iter().sum();
        shares.map(|share| share / sum)
    }
}

/// Points that carry a tip, nearest first, with weights (sum 1): one, or the three nearest.
fn points_under(sensor: &Sensor, x_mm: f64, y_mm: f64) -> Vec<(usize, f64)> {
    let mut nearest: Vec<(f64, usize)> = Vec::with_capacity(4);
    for (index, p) in sensor.points().iter().enumerate() {
        let distance = (p.x_mm - x_mm).hypot(p.y_mm - y_mm);
        let at = nearest.partition_point(|&(d, _)| d <= distance);
        if at < 3 {
            nearest.insert(at, (distance, index));
            nearest.truncate(3);
        }
    }
    let single =
        |nearest: &[(f64, usize)]| nearest.first().map(|n| (n.1, 1.0)).into_iter().collect();
    if nearest.len() < 3 || nearest[0].0 <= POINT_TOLERANCE_MM {
        return single(&nearest);
    }
    let [a, b, c] = [0, 1, 2].map(|k| sensor.points()[nearest[k].1]);
    let area = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
        (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
    };
    let [a, b, c, at] = [[a.x_mm, a.y_mm], [b.x_mm, b.y_mm], [c.x_mm, c.y_mm], [x_mm, y_mm]];
    let whole = area(a, b, c);
    if whole.abs() < 1.0 {
        return single(&nearest); // three in a line, at the edge of the lattice
    }
    let weights =
        [area(at, b, c), area(a, at, c), area(a, b, at)].map(|part| (part / whole).max(0.0));
    let sum: f64 = weights.iter().sum();
    nearest.iter().zip(weights).map(|(n, w)| (n.1, w / sum)).filter(|p| p.1 > 0.0).collect()
}

/// Readout circuit of a seed: displaced electrodes, contacts, leads, loose electrodes.
fn circuit(sensor: &Sensor, gap: &Gap, seed: u64) -> ReadoutCircuit {
    let mut nominal = ReadoutCircuit::nominal(sensor);
    let g = &gap.electrodes;
    let mut rng = stream(seed, "electrodes");
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    for site in &mut nominal.electrodes {
        *site = ElectrodeSite {
            x_mm: (site.x_mm + g.offset_sd_mm * normal()).clamp(0.0, sensor.file.width_mm),
            y_mm: (site.y_mm + g.offset_sd_mm * normal()).clamp(0.0, sensor.file.height_mm),
            contact_ohm: g.contact_ohm,
            lead_ohm: g.lead_ohm * (g.lead_ln_sd * normal()).exp(),
        };
    }
    // The loose electrodes: those with the largest draws of a separate stream.
    let mut draws: Vec<(f64, usize)> = (0..nominal.electrodes.len())
        .map(|k| (normal_at(seed, "loose electrodes", k as u64), k))
        .collect();
    draws.sort_by(|a, b| b.0.total_cmp(&a.0));
    for &(_, k) in draws.iter().take(g.loose as usize) {
        nominal.electrodes[k].lead_ohm += g.loose_ohm;
    }
    nominal
}

fn fields(mesh: &Mesh, sensor: &Sensor, gap: &Gap, seed: u64) -> Result<NodeFields, LutError> {
    let g = &gap.fields;
    let smooth = |name: &str, sd: f64, places: &[[f64; 2]]| -> Vec<f64> {
        let share = sd / (g.correlation_mm.len() as f64).sqrt();
        let mut out = vec![0.0; places.len()];
        for (scale, &length_mm) in g.correlation_mm.iter().enumerate() {
            let mut rng = stream(seed, &format!("{name} at scale {scale}"));
            let field = SmoothField::draw(&mut rng, length_mm);
            for (value, &[x, y]) in out.iter_mut().zip(places) {
                *value += share * field.at([x, y, 0.0]);
            }
        }
        out
    };
    let nodes = &mesh.nodes_mm;
    let centres: Vec<[f64; 2]> =
        mesh.triangles.iter().map(|triangle| mesh.triangle_centre_mm(triangle)).collect();
    let mut ln_a = smooth("ln a", g.ln_a_sd, nodes);
    let mut rng = stream(seed, "ln a, white");
    for value in &mut ln_a {
        let white: f64 = StandardNormal.sample(&mut rng);
        *value += g.ln_a_white_sd * white;
    }
    let mut ln_compliance = smooth("ln compliance", g.ln_compliance_sd, nodes);
    let near_electrode = |&[x, y]: &[f64; 2]| {
        let near = |e: &[f64; 2]| (e[0] - x).hypot(e[1] - y) <= gap.electrodes.soft_radius_mm;
        sensor.electrodes_mm().iter().any(near)
    };
    for (value, place) in ln_compliance.iter_mut().zip(nodes) {
        if near_electrode(place) {
            *value += gap.electrodes.soft_compliance.ln_1p();
        }
    }
    let foam = &gap.foam;
    Ok(NodeFields {
        ln_a,
        ln_b: smooth("ln b", g.ln_b_sd, nodes),
        ln_c: smooth("ln c", g.ln_c_sd, nodes),
        ln_compliance,
        ln_sheet_conductance: smooth("ln sheet", g.ln_sheet_sd, &centres),
        ln_sheet_anisotropy: 0.0,
        displacement: Some(DisplacementLut::sample(LUT_GRID, |x| foam.apply(x))?),
    })
}
