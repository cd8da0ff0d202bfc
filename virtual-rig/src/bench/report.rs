//! What the control socket tells about the bench: the truth, as no device would tell it.
//! PURE. Uses: `bench`. Never: changes anything.

use serde::Serialize;

use super::{Bench, Weight, WireCounters};
use crate::config::{ARMS, AxisName};

/// A stop command that came over a wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StopReceipt {
    /// Which axis.
    pub axis: &'static str,
    /// When its bytes were read, wall seconds since 1970.
    pub unix_s: f64,
    /// The same in process seconds.
    pub process_s: f64,
    /// True position of the axis at that time, mm or degrees.
    pub position: f64,
}

/// One axis, as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisReport {
    /// `x`, `y`, `z` or `radial`.
    pub name: &'static str,
    /// True position, mm or degrees.
    pub position: f64,
    /// Motion is under way.
    pub moving: bool,
    /// Motor on.
    pub servo: bool,
    /// Homing has been done.
    pub homed: bool,
    /// Something has stopped it.
    pub alarm: bool,
}

/// The whole bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Process seconds since power-up.
    pub process_s: f64,
    /// The axes.
    pub axes: Vec<AxisReport>,
    /// Attached tips.
    pub tips: usize,
    /// Cells on their cables.
    pub powered: usize,
    /// True radius of the tips' circle, mm.
    pub radius_mm: f64,
    /// Machine z of the nominal surface, mm.
    pub surface_z_mm: f64,
    /// True forces on the arms, N.
    pub forces_n: [f64; ARMS],
    /// Largest true force on a tip since the last `clear_peaks`, N.
    pub peak_force_n: f64,
    /// Deepest that z has been below the nominal surface since then, mm; above it is negative.
    pub deepest_below_surface_mm: f64,
    /// Places of the tips from the skin's corner, mm.
    pub tips_mm: Vec<[f64; 2]>,
    /// Weights put down.
    pub weights: Vec<Weight>,
    /// Tips press.
    pub pressing: bool,
    /// Presses into contact so far.
    pub presses: u64,
    /// Lateral or radial motions in contact: must stay 0.
    pub lateral_in_contact: u64,
    /// Stop commands so far.
    pub stops: u64,
    /// The latest of them.
    pub stop_receipts: Vec<StopReceipt>,
    /// Counters of the Modbus wires.
    pub wires: WireCounters,
    /// Frame in progress.
    pub frame: u32,
    /// Frames dropped because their load changed.
    pub frames_dropped: u64,
}

impl Bench {
    /// The truth at a process time.
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
            forces_n: self.indenter.forces_n(&pose, self.unloading(pose.z_mm)),
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
