//! Report of the control socket: the true state of the bench, which no device reports.
//! PURE. Uses: `bench`. Never: changes anything.

use serde::Serialize;

use super::{Bench, Weight, WireCounters};
use crate::config::{ARMS, AxisName};

/// A stop command that arrived over a wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StopReceipt {
    /// Name of the axis.
    pub axis: &'static str,
    /// Time at which its bytes were read, wall seconds since 1970.
    pub unix_s: f64,
    /// The same time, process s.
    pub process_s: f64,
    /// True position of the axis at that time, mm or degrees.
    pub position: f64,
}

/// True state of one axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisReport {
    /// Name: `x`, `y`, `z` or `radial`.
    pub name: &'static str,
    /// True position, mm or degrees.
    pub position: f64,
    /// Whether the axis moves.
    pub moving: bool,
    /// Whether the motor is on.
    pub servo: bool,
    /// Whether homing is complete.
    pub homed: bool,
    /// Whether an alarm is active.
    pub alarm: bool,
}

/// True state of the bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Process seconds since power-up.
    pub process_s: f64,
    /// State of the four axes.
    pub axes: Vec<AxisReport>,
    /// Number of attached tips.
    pub tips: usize,
    /// Number of connected cells.
    pub powered: usize,
    /// True radius of the circle of tips, mm.
    pub radius_mm: f64,
    /// Machine z of the nominal surface, mm.
    pub surface_z_mm: f64,
    /// True forces on the arms, N.
    pub forces_n: [f64; ARMS],
    /// Largest true force on a tip since the last `clear_peaks`, N.
    pub peak_force_n: f64,
    /// Deepest z relative to the nominal surface since then, mm; negative above it.
    pub deepest_below_surface_mm: f64,
    /// Positions of the tips, skin coordinates, mm.
    pub tips_mm: Vec<[f64; 2]>,
    /// Weights on the skin.
    pub weights: Vec<Weight>,
    /// Whether a tip is in contact.
    pub pressing: bool,
    /// Number of presses into contact.
    pub presses: u64,
    /// Number of lateral or radial motions in contact; must remain 0.
    pub lateral_in_contact: u64,
    /// Number of stop commands.
    pub stops: u64,
    /// The most recent of them.
    pub stop_receipts: Vec<StopReceipt>,
    /// Counters of the Modbus wires.
    pub wires: WireCounters,
    /// Sequence number of the frame in progress.
    pub frame: u32,
    /// Number of frames dropped because their load changed.
    pub frames_dropped: u64,
}

impl Bench {
    /// Returns the true state at a process time.
    pub fn report(&mut self, t_s: f64) -> Report {
        self.advance(t_s);
        let t_s = self.now_s;
        let pose = self.pose(t_s);
        let axis = |name: AxisName| {
            let drive = self.drive(name);
            AxisReport {
                name: name.as_str(),
                position: drive.position(t_s),
                moving: drive.moving(t_s),
                servo: drive.servo(),
                homed: drive.homed(),
                alarm: drive.alarm().is_some(),
            }
        };
        Report {
            process_s: t_s,
            axes: AxisName::ALL.map(axis).to_vec(),
            tips: self.indenter.mounted(),
            powered: self.powered,
            peak_force_n: self.peaks.force_n,
            deepest_below_surface_mm: self.peaks.z_mm - self.indenter.surface_z_mm(),
            radius_mm: pose.radius_mm,
            surface_z_mm: self.indenter.surface_z_mm(),
            forces_n: self.indenter.forces_n(&pose, self.stroke(pose.z_mm)),
            tips_mm: (0..self.indenter.mounted()).map(|a| self.indenter.tip(a, &pose)).collect(),
            weights: self.weights.clone(),
            pressing: self.pressing,
            presses: self.presses,
            lateral_in_contact: self.lateral_in_contact,
            stops: self.stops_total,
            stop_receipts: self.stops.iter().copied().collect(),
            wires: self.counters,
            frame: self.frames.sequence(),
            frames_dropped: self.frames.dropped(),
        }
    }
}
