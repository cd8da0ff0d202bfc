//! Limits on every sample: forces, cells, positions. Returns trips as values.
//! PURE. Uses: `rig::{config, traits}`. Never: motion, wires, time.
//!
//! Decides each row of `docs/safety.md` that a single sample can decide. The cross-checks (skin
//! against cells, force against depth) are in `campaign::bench::evidence`.

use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::record::{ARMS, Pose};
use crate::rig::config::{CellsConfig, RigConfig};
use crate::rig::traits::CellVolts;

/// Force on an arm without a tip that contradicts the number of tips entered, N.
pub const FOREIGN_N: f64 = 5.0;

/// What latched the rig: kind and quantity, value, limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trip {
    /// Kind of the limit or fault.
    pub kind: TripKind,
    /// Message: device, value, limit.
    pub detail: String,
}

/// Kinds of trips; the policy treats them differently.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum TripKind {
    /// A person or a program pressed the stop.
    Estop,
    /// Force on one cell, or the sum of forces, above its limit.
    Force,
    /// A cell is disconnected, saturated, does not change, or contradicts another measurement.
    Cell,
    /// A position is outside its travel or away from its target.
    Position,
    /// A wire without reply, or with garbled replies, beyond its retries.
    Wire,
    /// A device reports an alarm or an exception.
    Device,
    /// No fresh frame or sample in time, or a module that returns the same values repeatedly.
    Stale,
    /// The service itself failed, or the computer was suspended.
    Service,
}

impl TripKind {
    /// All kinds.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name of the kind, as in the status.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// What it means, and what to do.
    pub fn about(self) -> &'static str {
        match self {
            TripKind::Estop => {
                "A person or a program pressed the stop. When there is no danger: reset, then home."
            }
            TripKind::Force => {
                "A force was beyond its limit. Find what the tip touched, then reset and home."
            }
            TripKind::Cell => {
                "A load cell left its range. Check its cable and its supply, then reset and home."
            }
            TripKind::Position => {
                "An axis is not where it should be. Check that nothing blocks it, then reset and home."
            }
            TripKind::Wire => {
                "A wire failed. Check cable and power of its devices, then reset and home."
            }
            TripKind::Device => {
                "A device reports a fault. Clear it at the device, then reset and home."
            }
            TripKind::Stale => {
                "Samples or frames were too old. Check the wires and the load of the computer, then reset and home."
            }
            TripKind::Service => {
                "The service itself failed, or its computer was suspended. Read the event log, then reset and home."
            }
        }
    }

    /// Whether a run that was armed with automatic resume may resume without a person once every
    /// check passes again: true for transient faults of wires, never for forces, positions or
    /// persons.
    pub fn may_pass(self) -> bool {
        match self {
            TripKind::Wire | TripKind::Stale => true,
            TripKind::Estop
            | TripKind::Force
            | TripKind::Cell
            | TripKind::Position
            | TripKind::Device
            | TripKind::Service => false,
        }
    }
}

/// Force limits in effect during one run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLimits {
    /// Limit of the force on one cell, N.
    pub each_n: f64,
    /// Limit of the sum of forces, N.
    pub sum_n: f64,
    /// Limit of the force below the tare, N: a force more than this below zero is a fault of the
    /// cell.
    pub below_n: f64,
}

/// Number of connected cells, given that a person has entered tips on arms 1 to `tips`. Six powered
/// cells under one tip are allowed, and so is an unplugged cell on an arm without a tip.
///
/// # Errors
/// The cell of an attached arm is disconnected; the message names the arms.
pub fn live_cells(cells: &CellsConfig, volts: &[f64; ARMS], tips: u8) -> Result<u8, String> {
    let dead: Vec<String> = (0..usize::from(tips))
        .filter(|&i| !cells.is_live(volts[i]))
        .map(|i| format!("{} ({:.3} V)", i + 1, volts[i]))
        .collect();
    if dead.is_empty() {
        Ok(volts.iter().filter(|&&v| cells.is_live(v)).count() as u8)
    } else {
        let arms = dead.join(", ");
        Err(format!("{tips} tips need live cells on arms 1 to {tips}; disconnected: arm {arms}"))
    }
}

/// Outputs of the cells of the arms.
#[derive(Debug, Clone, Copy)]
pub struct Outputs<'a> {
    /// Present outputs, V.
    pub volts: &'a [f64; ARMS],
    /// Outputs without load, V.
    pub tare_v: &'a [f64; ARMS],
}

impl Outputs<'_> {
    /// Forces of the arms after subtraction of the tare, N.
    pub fn forces_n(self, cells: &CellsConfig) -> [f64; ARMS] {
        std::array::from_fn(|i| (self.volts[i] - self.tare_v[i]) * cells.newtons_per_volt())
    }
}

/// Checks one reading of the cells.
///
/// # Errors
/// `Cell` for a disconnected, saturated or unchanging cell, a force below the tare, or a load on an
/// arm without a tip; `Force` above a force limit; `Stale` if all live cells repeat their values.
pub fn check_cells(
    cells: &CellsConfig,
    limits: ForceLimits,
    tips: u8,
    reading: &CellVolts,
    tare_v: &[f64; ARMS],
) -> Result<(), Trip> {
    let (volts, tips) = (&reading.volts, usize::from(tips));
    let trip = |kind, detail: String| Err(Trip { kind, detail });
    let forces = Outputs { volts, tare_v }.forces_n(cells);
    for (i, (&v, &force)) in volts.iter().zip(&forces).enumerate() {
        let arm = i + 1;
        if i >= tips {
            if cells.is_live(v) && force.abs() > FOREIGN_N {
                return trip(
                    TripKind::Cell,
                    format!(
                        "cell {arm} reads {force:.1} N and no tip is entered for arm {arm} \
                         (limit {FOREIGN_N} N): check which tips are mounted"
                    ),
                );
            }
            continue;
        }
        if !cells.is_live(v) {
            return trip(TripKind::Cell, format!("cell {arm} reads {v:.3} V: disconnected"));
        }
        if cells.is_saturated(v) {
            return trip(TripKind::Cell, format!("cell {arm} reads {v:.3} V: saturated"));
        }
        if force > limits.each_n {
            let limit = limits.each_n;
            let detail = format!("force on arm {arm} {force:.1} N over its limit {limit} N");
            return trip(TripKind::Force, detail);
        }
        if force < -limits.below_n {
            let limit = limits.below_n;
            let detail = format!("cell {arm} reads {force:.1} N, limit -{limit} N below its tare");
            return trip(TripKind::Cell, detail);
        }
    }
    let sum: f64 = forces[..tips].iter().sum();
    if sum > limits.sum_n {
        let detail = format!("sum of forces {sum:.1} N over its limit {} N", limits.sum_n);
        return trip(TripKind::Force, detail);
    }
    check_alive(cells, reading, tips)
}

/// Checks that no attached arm reads a load, before a lateral motion and during one.
///
/// # Errors
/// `Cell` with a load, although z reports to be clear of the surface; `Stale` if the module only repeats one.
pub fn check_unloaded(
    cells: &CellsConfig,
    tips: u8,
    reading: &CellVolts,
    tare_v: &[f64; ARMS],
) -> Result<(), Trip> {
    let (tips, limit_n) = (usize::from(tips), cells.in_air_n());
    let forces = Outputs { volts: &reading.volts, tare_v }.forces_n(cells);
    let Some(loaded) = forces[..tips].iter().position(|&force| force > limit_n) else {
        return Ok(());
    };
    check_alive(cells, reading, tips)?;
    let (arm, force_n) = (loaded + 1, forces[loaded]);
    let detail = format!(
        "no lateral motion: z reports to be clear, and cell {arm} reads {force_n:.1} N \
         (limit {limit_n} N, cells.in_air_n)"
    );
    Err(Trip { kind: TripKind::Cell, detail })
}

/// Checks that no cell reads more than when z began to home: the direction of a homing is a setting of the drive.
///
/// # Errors
/// `Force` if one does: z goes into the skin, or a hand is under a tip.
pub fn check_rises(cells: &CellsConfig, first: &CellVolts, now: &CellVolts) -> Result<(), Trip> {
    let (limit_n, is_live) = (cells.in_air_n(), |i: usize| cells.is_live(first.volts[i]));
    let grown_n = Outputs { volts: &now.volts, tare_v: &first.volts }.forces_n(cells);
    let Some(i) = (0..ARMS).find(|&i| is_live(i) && grown_n[i] > limit_n) else { return Ok(()) };
    let (arm, grown_n) = (i + 1, grown_n[i]);
    let detail = format!(
        "cell {arm} reads {grown_n:.1} N more than when z began to home (limit {limit_n} N, \
         cells.in_air_n): check in which direction z homes"
    );
    Err(Trip { kind: TripKind::Force, detail })
}

/// Checks for repeated values. The noise of a cell changes its last digit at nearly every update:
/// an input that returns one value for too long no longer measures.
pub(super) fn check_alive(
    cells: &CellsConfig,
    reading: &CellVolts,
    tips: usize,
) -> Result<(), Trip> {
    let still = |i: &usize| cells.is_hung(reading.repeats[*i]);
    let Some(first) = (0..tips).find(still) else { return Ok(()) };
    let live: Vec<usize> = (0..ARMS).filter(|&i| cells.is_live(reading.volts[i])).collect();
    let (updates, ms) = (reading.repeats[first], cells.update_ms);
    // The inputs of a module that hangs did not all change at its last conversion: one of them
    // reaches the limit first.
    let nearly_still = |i: &usize| reading.repeats[*i] > cells.repeats_max() / 2;
    let (kind, who) = if live.iter().all(nearly_still) {
        (TripKind::Stale, "cells: the module repeats itself".into())
    } else {
        (TripKind::Cell, format!("cell {} does not change", first + 1))
    };
    let limit = cells.repeats_max();
    let detail =
        format!("{who}: one value over {updates} updates of {ms} ms (cells.repeats_max = {limit})");
    Err(Trip { kind, detail })
}

/// Checks a measured position against the soft limits.
///
/// # Errors
/// `Position` if it is outside its travel by more than the tolerance.
pub fn check_position(
    axis: &str,
    position: f64,
    travel: [f64; 2],
    tolerance: f64,
) -> Result<(), Trip> {
    if position < travel[0] - tolerance || position > travel[1] + tolerance {
        let detail = format!(
            "{axis} measured at {position:.3}, outside its travel [{}, {}]",
            travel[0], travel[1]
        );
        return Err(Trip { kind: TripKind::Position, detail });
    }
    Ok(())
}

/// Compares a measured pose with its target. Returns the first axis that is off by more than 2
/// tolerances, as text. For z at least 0.5 mm are allowed: smaller deviations are stored with a
/// flag.
pub fn off_target(rig: &RigConfig, pose: &Pose, target: &Pose) -> Option<String> {
    /// Deviation of z above which the trial is refused instead of flagged, mm.
    const Z_OFF_MM: f64 = 0.5;
    let axes = &rig.axes;
    let radius_mm = 2.0 * axes.radial.tolerance_deg * rig.slot.mm_per_deg.abs();
    [
        ("x", pose.x_mm, target.x_mm, 2.0 * axes.x.tolerance_mm),
        ("y", pose.y_mm, target.y_mm, 2.0 * axes.y.tolerance_mm),
        ("z", pose.z_mm, target.z_mm, Z_OFF_MM.max(2.0 * axes.z.tolerance_mm)),
        ("radius", pose.radius_mm, target.radius_mm, radius_mm),
    ]
    .into_iter()
    .find(|(_, at, to, allowed)| (at - to).abs() > *allowed)
    .map(|(name, at, to, allowed)| {
        format!("{name} measured at {at:.3} mm, commanded {to:.3} mm, allowed {allowed} mm")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in::config as rig;

    fn cells() -> CellsConfig {
        rig().cells
    }

    const LIMITS: ForceLimits = ForceLimits { each_n: 50.0, sum_n: 120.0, below_n: 3.0 };
    const TARE: [f64; ARMS] = [0.5; ARMS];

    fn at_n(forces: [f64; ARMS]) -> [f64; ARMS] {
        forces.map(|f| 0.5 + f / cells().newtons_per_volt())
    }

    fn check(tips: u8, volts: [f64; ARMS], repeats: [u32; ARMS]) -> Result<(), Trip> {
        let reading = CellVolts { volts, repeats, at: tokio::time::Instant::now() };
        check_cells(&cells(), LIMITS, tips, &reading, &TARE)
    }

    #[test]
    fn a_force_over_its_limit_trips_and_names_the_arm() {
        let trip = check(2, at_n([1.0, 50.5, 0.0, 0.0, 0.0, 0.0]), [0; ARMS]).unwrap_err();
        assert_eq!(trip.kind, TripKind::Force);
        assert_eq!(trip.detail, "force on arm 2 50.5 N over its limit 50 N");
    }

    #[test]
    fn forces_within_each_limit_can_still_be_too_much_in_sum() {
        let trip = check(3, at_n([45.0, 45.0, 45.0, 0.0, 0.0, 0.0]), [0; ARMS]).unwrap_err();
        assert_eq!(trip.kind, TripKind::Force);
    }

    #[test]
    fn a_force_far_below_the_tare_trips() {
        assert_eq!(check(1, at_n([-2.9, 0.0, 0.0, 0.0, 0.0, 0.0]), [0; ARMS]), Ok(()));
        let trip = check(1, at_n([-3.1, 0.0, 0.0, 0.0, 0.0, 0.0]), [0; ARMS]).unwrap_err();
        assert_eq!(trip.detail, "cell 1 reads -3.1 N, limit -3 N below its tare");
    }

    #[test]
    fn an_unplugged_cell_beyond_the_tips_is_legal_and_a_load_there_is_not() {
        let mut volts = at_n([10.0; ARMS]);
        volts[3..].fill(0.0);
        assert_eq!(check(3, volts, [0; ARMS]), Ok(()));
        assert_eq!(check(4, volts, [0; ARMS]).unwrap_err().kind, TripKind::Cell);
        let trip = check(3, at_n([10.0, 10.0, 10.0, 0.0, 8.0, 0.0]), [0; ARMS]).unwrap_err();
        assert!(trip.detail.starts_with("cell 5 reads 8.0 N and no tip"), "{}", trip.detail);
    }

    #[test]
    fn a_still_cell_and_a_module_that_repeats_itself_are_told_apart() {
        let volts = at_n([0.0, 10.0, 0.0, 0.0, 0.0, 0.0]);
        let repeats = |n: [u32; ARMS]| check(2, volts, n);
        assert_eq!(repeats([8, 0, 8, 8, 8, 8]), Ok(()));
        let cell = repeats([9, 0, 0, 0, 0, 0]).unwrap_err();
        assert_eq!((cell.kind, &cell.detail[..22]), (TripKind::Cell, "cell 1 does not change"));
        assert_eq!(repeats([9, 4, 5, 5, 5, 5]).unwrap_err().kind, TripKind::Cell);
        assert_eq!(repeats([7, 9, 6, 8, 7, 5]).unwrap_err().kind, TripKind::Stale);
        assert_eq!(repeats([0, 0, 99, 99, 99, 99]), Ok(()), "arms without a tip");
    }

    #[test]
    fn a_load_although_z_is_clear_refuses_a_lateral_motion_unless_the_module_hangs() {
        let check = |force_n, repeats| {
            let volts = at_n([0.0, force_n, 90.0, 0.0, 0.0, 0.0]);
            let reading = CellVolts { volts, repeats, at: tokio::time::Instant::now() };
            check_unloaded(&cells(), 2, &reading, &TARE).map_err(|trip| trip.kind)
        };
        let limit_n = cells().in_air_n();
        assert_eq!(check(0.9 * limit_n, [0; ARMS]), Ok(()));
        assert_eq!(check(1.1 * limit_n, [0; ARMS]), Err(TripKind::Cell));
        assert_eq!(check(1.1 * limit_n, [99; ARMS]), Err(TripKind::Stale));
    }

    #[test]
    fn a_load_ends_a_homing_of_z_if_it_grows_and_its_cell_was_connected() {
        let check = |first, now| {
            let at = tokio::time::Instant::now();
            let reading = |volts| CellVolts { volts, repeats: [0; ARMS], at };
            check_rises(&cells(), &reading(first), &reading(now)).map_err(|trip| trip.kind)
        };
        let (free, loaded) = (at_n([0.0; ARMS]), at_n([0.0, 40.0, 0.0, 0.0, 0.0, 0.0]));
        assert_eq!(check(free, loaded), Err(TripKind::Force));
        assert_eq!(check(loaded, free), Ok(()), "z takes it off");
        assert_eq!(check(loaded, loaded), Ok(()), "it was there before");
        let mut unplugged = free;
        unplugged[1] = 0.0;
        assert_eq!(check(unplugged, loaded), Ok(()));
        assert_eq!(check(free, unplugged), Ok(()));
    }

    #[test]
    fn attached_arms_need_live_cells_and_others_may_have_them() {
        let live = |volts, tips| live_cells(&cells(), &volts, tips);
        assert_eq!(live([0.5; ARMS], 1), Ok(6));
        assert_eq!(live([0.5, 0.51, 0.0, 0.0, 0.0, 0.0], 2), Ok(2));
        assert!(live([0.5, 0.0, 0.5, 0.0, 0.0, 0.0], 2).unwrap_err().contains("arm 2 (0.000 V)"));
    }

    #[test]
    fn an_axis_outside_its_travel_by_more_than_its_tolerance_trips() {
        let check = |at| check_position("x", at, [0.0, 600.0], 0.05);
        for inside in [-0.04, 0.0, 300.0, 600.04] {
            assert_eq!(check(inside), Ok(()));
        }
        for outside in [-0.06, 600.06] {
            assert_eq!(check(outside).unwrap_err().kind, TripKind::Position);
        }
        let detail = check(601.5).unwrap_err().detail;
        assert_eq!(detail, "x measured at 601.500, outside its travel [0, 600]");
    }

    #[test]
    fn every_axis_is_compared_with_its_target_before_a_trial_is_stored() {
        let rig = rig();
        let target = Pose { x_mm: 100.0, y_mm: 200.0, z_mm: 60.0, radius_mm: 80.0 };
        assert_eq!(off_target(&rig, &target, &target), None);
        let (mut x, mut y, mut z, mut radius) = (target, target, target, target);
        x.x_mm += 2.1 * rig.axes.x.tolerance_mm;
        y.y_mm -= 2.1 * rig.axes.y.tolerance_mm;
        radius.radius_mm += 2.1 * rig.axes.radial.tolerance_deg * rig.slot.mm_per_deg.abs();
        z.z_mm += 0.4;
        assert_eq!(off_target(&rig, &z, &target), None, "stored with a flag");
        z.z_mm += 0.2;
        for (name, pose) in [("x", x), ("y", y), ("z", z), ("radius", radius)] {
            let words = off_target(&rig, &pose, &target).expect(name);
            assert!(words.starts_with(&format!("{name} measured at ")), "{words}");
        }
    }
}
