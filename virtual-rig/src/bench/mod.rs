//! The bench as one value: four axes, the indenter, its cells, the skin's readout, and their
//! faults. Everything happens at process times that are passed in.
//! PURE. Uses: `device`, `drive`, `fault`, `skin`. Never: clocks, sockets, threads, solving.

mod cells;
mod contact;
mod frames;
mod hands;
mod report;

pub use contact::{Load, Weight};
pub use frames::TakenFrame;
pub use hands::Refusal;
pub use report::{AxisReport, Report, StopReceipt};

use std::collections::VecDeque;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use self::cells::CellBank;
use self::contact::{Indenter, Play, Pose};
use self::frames::FrameLedger;
use crate::config::{ARMS, AxisName, RigFile};
use crate::device::{AxisMap, CellsMap, INPUTS};
use crate::drive::{Alarm, Drive, Mechanism, Servo};
use crate::fault::{Board, Fault, Kind, Target, WireFault};
use crate::modbus::{Exception, Request, answer};
use crate::skin::AnyMechanics;
use crate::skin::mechanics::Stroke;

/// Largest number of stop receipts that are stored.
const RECEIPTS_MAX: usize = 4096;
/// Rise of a tip above its deepest position at which it is unloading, mm.
const UNLOADING_MM: f64 = 0.005;

/// When the bytes of a request arrived.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Process time, s.
    pub process_s: f64,
    /// The same time, wall seconds since 1970.
    pub unix_s: f64,
}

/// Result of a request to a wire.
#[derive(Debug, Clone, PartialEq)]
pub struct Served {
    /// Protocol data unit of the reply; absent: no device has this address.
    pub answer: Option<Vec<u8>>,
    /// Fault that affects the reply; absent: none.
    pub fault: Option<WireFault>,
}

/// Counters of the Modbus wires.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct WireCounters {
    /// Number of requests received.
    pub requests: u64,
    /// Number of writes among them.
    pub writes: u64,
    /// Number of exceptions returned.
    pub exceptions: u64,
    /// Number of requests affected by a fault.
    pub struck: u64,
}

/// Extreme values since the last reset.
#[derive(Debug, Clone, Copy)]
struct Peaks {
    /// Largest true force on a tip, N.
    force_n: f64,
    /// Deepest machine z, mm.
    z_mm: f64,
}

struct Axis {
    drive: Drive,
    map: Box<dyn AxisMap>,
    line: String,
    unit: u8,
    /// State of the device as stale reads show it, and the process time since which they are stale,
    /// s.
    stale: Option<(Box<dyn AxisMap>, Drive, f64)>,
}

/// The bench of the rig.
pub struct Bench {
    axes: [Axis; 4],
    cells_map: Box<dyn CellsMap>,
    cells_at: (String, u8),
    stale_cells: Option<[f64; INPUTS]>,
    cells: CellBank,
    indenter: Indenter,
    play: Play,
    weights: Vec<Weight>,
    frames: FrameLedger,
    faults: Board,
    now_s: f64,
    /// The held load; none after a motion until it is computed again.
    load: Option<Arc<Load>>,
    pressing: bool,
    deepest_z_mm: f64,
    /// Number of connected cells, on arms 1 to n.
    powered: usize,
    peaks: Peaks,
    presses: u64,
    lateral_in_contact: u64,
    /// Last motion of each axis that was counted as lateral motion in contact.
    counted_motion: [u64; 4],
    stops: VecDeque<StopReceipt>,
    stops_total: u64,
    counters: WireCounters,
    /// Loads that are expected to be held soon.
    expected: Vec<Arc<Load>>,
}

impl Bench {
    /// Creates a bench at power-up: axes at random positions (z clear of the skin), not homed, six
    /// tips attached.
    pub fn power_up(
        rig: &RigFile,
        skin_size_mm: [f64; 2],
        mechanics: AnyMechanics,
        faults: Vec<Fault>,
        seed: u64,
    ) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let [top, bottom] = rig.skin.surface_z_mm;
        let surface_z_mm = top + rng.random_range(0.2..0.6) * (bottom - top);
        let mut axis = |name: AxisName| {
            let file = rig.axis(name);
            let [lower, upper] = file.travel;
            let upper =
                if name == AxisName::Z { upper.min(top - 5.0).max(lower + 1.0) } else { upper };
            let at = lower + rng.random_range(0.05..0.95) * (upper - lower);
            let (speed, acceleration) = (file.speed, file.acceleration);
            let mechanism = Mechanism { travel: file.travel, speed, acceleration };
            Axis {
                drive: Drive::power_up(mechanism, at, file.device.servo_at_power_up),
                map: (file.device.map)(file.counts_per_unit, rig.clock_rate),
                line: file.line.clone(),
                unit: file.unit,
                stale: None,
            }
        };
        let axes = AxisName::ALL.map(&mut axis);
        let play = Play::new(rig.slot, axes[AxisName::Radial.index()].drive.position(0.0));
        let z_mm = axes[AxisName::Z.index()].drive.position(0.0);
        Self {
            axes,
            cells_map: (rig.cells.device.map)(),
            cells_at: (rig.cells.line.clone(), rig.cells.unit),
            stale_cells: None,
            cells: CellBank::new(rig.cells.clone(), rng.random()),
            indenter: Indenter::new(rig.skin, skin_size_mm, surface_z_mm, mechanics),
            play,
            weights: Vec::new(),
            frames: FrameLedger::new(rig.ert.frame_rate_hz),
            faults: Board::new(faults),
            now_s: 0.0,
            load: None,
            pressing: false,
            deepest_z_mm: f64::NEG_INFINITY,
            powered: ARMS,
            peaks: Peaks { force_n: 0.0, z_mm },
            presses: 0,
            lateral_in_contact: 0,
            counted_motion: [0; 4],
            stops: VecDeque::new(),
            stops_total: 0,
            counters: WireCounters::default(),
            expected: Vec::new(),
        }
    }

    fn drive(&self, name: AxisName) -> &Drive {
        &self.axes[name.index()].drive
    }

    fn pose(&self, t_s: f64) -> Pose {
        self.pose_of(|drive| drive.position(t_s))
    }

    /// Pose with each drive at the position that `at` returns.
    fn pose_of(&self, at: impl Fn(&Drive) -> f64) -> Pose {
        let at = |name| at(self.drive(name));
        Pose {
            x_mm: at(AxisName::X),
            y_mm: at(AxisName::Y),
            z_mm: at(AxisName::Z),
            radius_mm: self.play.radius_mm(at(AxisName::Radial)),
        }
    }

    /// Advances the process time, without a command in between.
    pub fn advance(&mut self, t_s: f64) {
        self.frames.skip_to(t_s);
        while self.now_s < t_s {
            let end_s = self.frames.end_s();
            let watchdogs_s = self.axes.iter().filter_map(|axis| axis.map.watchdog_s());
            let until = watchdogs_s.fold(end_s.min(t_s), f64::min).max(self.now_s);
            self.pass(self.now_s, until);
            self.now_s = until;
            self.watch();
            if until >= end_s {
                if !self.frames.spoilt() {
                    self.hold_load();
                }
                let load = self.load.clone();
                self.frames.finish(|| load.unwrap_or_default());
            }
        }
        for axis in &mut self.axes {
            axis.drive.refresh(t_s);
        }
        if !self.faults.is_empty() {
            self.strike();
        }
    }

    /// Lets expired watchdogs stop their motors.
    fn watch(&mut self) {
        let t_s = self.now_s;
        let ran_out = |axis: &Axis| axis.map.watchdog_s().is_some_and(|end_s| end_s <= t_s);
        if self.axes.iter().any(ran_out) {
            self.hold_cells();
            for axis in &mut self.axes {
                axis.drive.refresh(t_s);
                axis.map.watch(&mut axis.drive, t_s);
            }
        }
    }

    /// Applies the effects of motion between two times within one frame.
    fn pass(&mut self, from_s: f64, to_s: f64) {
        let turning = AxisName::ALL.map(|n| self.drive(n).turns_between(from_s));
        if turning == [false; 4] {
            return;
        }
        self.load = None;
        let deepest_mm = self.drive(AxisName::Z).range(from_s..=to_s)[1];
        let end = self.pose(to_s);
        let lowest = Pose { z_mm: deepest_mm, ..end };
        let forces = self.indenter.forces_n(&lowest, Stroke::Loading);
        let largest_n = forces.iter().copied().fold(0.0, f64::max);
        let touching = largest_n > 0.0;
        self.peaks.force_n = self.peaks.force_n.max(largest_n);
        self.peaks.z_mm = self.peaks.z_mm.max(deepest_mm);
        if touching || self.pressing {
            self.frames.spoil();
        }
        if touching {
            self.presses += u64::from(!self.pressing);
            self.deepest_z_mm = self.deepest_z_mm.max(deepest_mm);
            self.count_lateral(turning);
        }
        self.pressing = touching && self.indenter.touches(&end);
        if !self.pressing {
            self.deepest_z_mm = f64::NEG_INFINITY;
        }
        self.play.follow(self.drive(AxisName::Radial).position(to_s));
    }

    fn count_lateral(&mut self, turning: [bool; 4]) {
        for name in [AxisName::X, AxisName::Y, AxisName::Radial] {
            let motion = self.drive(name).motions();
            let counted = &mut self.counted_motion[name.index()];
            if turning[name.index()] && *counted != motion {
                *counted = motion;
                self.lateral_in_contact += 1;
            }
        }
    }

    fn stroke(&self, z_mm: f64) -> Stroke {
        let risen = z_mm < self.deepest_z_mm - UNLOADING_MM;
        if risen { Stroke::Unloading } else { Stroke::Loading }
    }

    /// Computes the held load if it is unknown.
    fn hold_load(&mut self) {
        if self.load.is_none() {
            let pose = self.pose(self.now_s);
            let stroke = self.stroke(pose.z_mm);
            self.load = Some(Arc::new(self.indenter.load(&pose, stroke, &self.weights)));
        }
    }

    /// Applies the faults that change the bench itself.
    fn strike(&mut self) {
        let t_s = self.now_s;
        self.faults.update(t_s, self.frames.sequence(), self.presses);
        for name in AxisName::ALL {
            let jam = self.faults.stuck(name, t_s);
            let sudden = self.faults.sudden(name, t_s);
            let stale = self.faults.stale_since(&Target::Axis(name), t_s).is_some();
            if jam.is_some() || sudden.is_some() {
                self.hold_cells();
            }
            let axis = &mut self.axes[name.index()];
            match jam {
                Some(alarm_after_s) => axis.drive.jam(t_s, alarm_after_s),
                None => axis.drive.free(t_s),
            }
            match sudden {
                Some(Kind::Alarm { code }) => axis.drive.trip(t_s, Alarm::Scripted(code)),
                Some(Kind::PowerLoss) => {
                    axis.drive.power_cycle(t_s);
                    axis.map.power_cycle();
                }
                Some(Kind::MotorOff) => axis.drive.set_servo(t_s, Servo::Off),
                _ => {}
            }
            if !stale {
                axis.stale = None;
            } else if axis.stale.is_none() {
                axis.stale = Some((axis.map.copy(), axis.drive.clone(), t_s));
            }
        }
        let missing = self.faults.missing_tips(t_s);
        if missing != self.indenter.missing() {
            self.hold_cells();
            self.indenter.lose(missing);
            self.load = None;
            self.frames.spoil();
        }
        if self.faults.stale_since(&Target::Cells, t_s).is_none() {
            self.stale_cells = None;
        } else if self.stale_cells.is_none() {
            self.stale_cells = Some(self.cell_volts());
        }
    }

    /// Evaluates the last conversion of the module now, before motion changes its input.
    fn hold_cells(&mut self) {
        self.cell_volts();
    }

    /// Inputs of the analog module at its last conversion, V.
    fn cell_volts(&mut self) -> [f64; INPUTS] {
        let conversion = self.cells.conversion(self.now_s);
        if let Some(held) = self.cells.held(conversion) {
            return held;
        }
        let pose = self.pose(self.cells.time_s(conversion));
        let forces = self.indenter.forces_n(&pose, self.stroke(pose.z_mm));
        let faults = self.faults.cells(self.now_s);
        self.cells.convert(conversion, &forces, self.powered, &faults)
    }

    /// Device that a request addresses.
    fn target(&self, line: &str, unit: u8) -> Option<Target> {
        let axis = |&n: &AxisName| {
            let axis = &self.axes[n.index()];
            axis.line == line && axis.unit == unit
        };
        if self.cells_at.0 == line && self.cells_at.1 == unit {
            return Some(Target::Cells);
        }
        AxisName::ALL.iter().copied().find(axis).map(Target::Axis)
    }

    /// Executes one request that arrived over a wire.
    pub fn serve(&mut self, line: &str, unit: u8, pdu: &[u8], arrival: Arrival) -> Served {
        self.advance(arrival.process_s);
        self.counters.requests += 1;
        let target = self.target(line, unit);
        let fault = self.faults.strike_request(target.as_ref(), line, self.now_s);
        self.counters.struck += u64::from(fault.is_some());
        let Some(target) = target else { return Served { answer: None, fault } };
        let answer = match fault {
            Some(WireFault::NoReply { executed: false })
            | Some(WireFault::Disconnect { executed: false }) => Vec::new(),
            Some(WireFault::Exception(code)) => answer(pdu, &Err(Exception::Scripted(code))),
            None
            | Some(WireFault::NoReply { executed: true })
            | Some(WireFault::Disconnect { executed: true })
            | Some(WireFault::Late { .. })
            | Some(WireFault::Garbled(_)) => self.carry_out(&target, pdu, arrival.unix_s),
        };
        self.counters.exceptions += u64::from(answer.first().is_some_and(|f| f & 0x80 != 0));
        Served { answer: Some(answer), fault }
    }

    fn carry_out(&mut self, target: &Target, pdu: &[u8], received_unix_s: f64) -> Vec<u8> {
        let request = match Request::parse(pdu) {
            Ok(request) => request,
            Err(exception) => return answer(pdu, &Err(exception)),
        };
        self.counters.writes += u64::from(request.writes());
        let outcome = match target {
            Target::Axis(name) => self.carry_out_axis(*name, &request, received_unix_s),
            Target::Cells | Target::Ert | Target::Line(_) => {
                let volts = self.cell_volts();
                let volts = self.stale_cells.unwrap_or(volts);
                self.cells_map.serve(&request, &volts)
            }
        };
        answer(pdu, &outcome)
    }

    fn carry_out_axis(
        &mut self,
        name: AxisName,
        request: &Request,
        received_unix_s: f64,
    ) -> Result<crate::modbus::Reply, Exception> {
        let t_s = self.now_s;
        if request.writes() {
            self.hold_cells();
        }
        let axis = &mut self.axes[name.index()];
        axis.map.hear(t_s);
        if let Some((map, drive, since_s)) = &mut axis.stale
            && !request.writes()
        {
            return map.serve(request, drive, *since_s);
        }
        let (motions, stops) = (axis.drive.motions(), axis.drive.stops());
        let outcome = axis.map.serve(request, &mut axis.drive, t_s);
        let (moved, stopped) = (axis.drive.motions() != motions, axis.drive.stops() != stops);
        if stopped {
            self.stops_total += 1;
            if self.stops.len() >= RECEIPTS_MAX {
                self.stops.pop_front();
            }
            let (axis, position) = (name.as_str(), axis.drive.position(t_s));
            let (unix_s, process_s) = (received_unix_s, t_s);
            self.stops.push_back(StopReceipt { axis, unix_s, process_s, position });
        }
        if moved && name == AxisName::Z {
            self.expect_load();
        }
        outcome
    }

    /// Predicts the load at the end of the active motions, so that it can be solved in advance.
    fn expect_load(&mut self) {
        let pose = self.pose_of(Drive::resting_position);
        if self.indenter.surely_clear(pose.z_mm) {
            return;
        }
        let stroke = self.stroke(pose.z_mm);
        self.expected.push(Arc::new(self.indenter.load(&pose, stroke, &self.weights)));
    }

    /// Returns the loads that are expected to be held soon, for the solver.
    pub fn take_expected(&mut self) -> Vec<Arc<Load>> {
        std::mem::take(&mut self.expected)
    }

    /// Returns the frames taken since the last call.
    pub fn take_frames(&mut self) -> VecDeque<TakenFrame> {
        self.frames.take()
    }

    /// Process time at which the frame in progress ends, s.
    pub fn frame_end_s(&self) -> f64 {
        self.frames.end_s()
    }

    /// Active faults of the stream.
    pub fn stream_faults(&mut self) -> Vec<Kind> {
        if self.faults.is_empty() { Vec::new() } else { self.faults.stream(self.now_s) }
    }

    /// Whether a wire is disconnected.
    pub fn disconnected(&mut self, line: &str, t_s: f64) -> bool {
        self.advance(t_s);
        self.faults.disconnected(line, t_s)
    }

    /// Adds a fault while the rig runs.
    pub fn add_fault(&mut self, fault: Fault) {
        self.faults.add(fault);
        self.strike();
    }

    /// Removes all faults and repairs their effects.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
        self.strike();
    }
}
