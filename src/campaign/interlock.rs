//! Limits on every sample: forces, cells, positions. What trips the rig, as values.
//! PURE. Uses: `rig::config`. Never: motion, wires, time.
//!
//! `design.md` 8, law 3; load cells: `design.md` 5 (saturation, 0 V, a cell that stays still while
//! depth grows).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::rig::config::{ARMS, CellsConfig};

/// What latched the rig: the quantity, its value, its limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trip {
    /// What kind of thing happened.
    pub kind: TripKind,
    /// In words: device, value, limit.
    pub detail: String,
}

/// Kinds of trips; the policy treats them differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TripKind {
    /// A person (or a script) pressed the stop.
    Estop,
    /// Force on one cell or in sum.
    Force,
    /// A cell is disconnected, saturated or still.
    Cell,
    /// A position outside the soft limits, or not where it was sent.
    Position,
    /// A wire that stayed silent or wrong past its retries.
    Wire,
    /// A device reports an alarm or an exception.
    Device,
    /// No fresh frame or sample in time.
    Stale,
}

impl TripKind {
    /// Whether a run that was armed with automatic resume may go on by itself once every check
    /// passes again: only weather on the wires, never a force, a position or a person.
    pub fn may_pass(self) -> bool {
        match self {
            TripKind::Wire | TripKind::Stale => true,
            TripKind::Estop
            | TripKind::Force
            | TripKind::Cell
            | TripKind::Position
            | TripKind::Device => false,
        }
    }
}

/// Limits of forces that hold in one run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLimits {
    /// On one cell, N.
    pub each_n: f64,
    /// In sum, N.
    pub sum_n: f64,
}

/// Whether a cell is connected, from its output.
pub fn is_live(cells: &CellsConfig, volts: f64) -> bool {
    cells.is_live(volts)
}

/// Arms whose cells are connected, counted from arm 1; an error names the arms if they are not
/// exactly the first ones.
pub fn live_tips(cells: &CellsConfig, volts: &[f64; ARMS]) -> Result<u8, String> {
    let live: Vec<usize> = (0..ARMS).filter(|&i| is_live(cells, volts[i])).map(|i| i + 1).collect();
    if live.iter().copied().eq(1..=live.len()) {
        Ok(live.len() as u8)
    } else {
        Err(format!("live cells on arms {live:?}; tips must be mounted on arms 1 to n"))
    }
}

/// Forces over the tare of the first `tips` arms, N.
pub fn forces_n(cells: &CellsConfig, volts: &[f64; ARMS], tare_v: &[f64; ARMS]) -> [f64; ARMS] {
    std::array::from_fn(|i| (volts[i] - tare_v[i]) * cells.newtons_per_volt())
}

/// Checks one reading of the cells.
pub fn check_cells(
    cells: &CellsConfig,
    limits: ForceLimits,
    tips: u8,
    volts: &[f64; ARMS],
    tare_v: &[f64; ARMS],
) -> Result<(), Trip> {
    let forces = forces_n(cells, volts, tare_v);
    for i in 0..usize::from(tips) {
        let arm = i + 1;
        if !is_live(cells, volts[i]) {
            let detail = format!("cell {arm} reads {:.3} V: disconnected", volts[i]);
            return Err(Trip { kind: TripKind::Cell, detail });
        }
        if cells.is_saturated(volts[i]) {
            let end = cells.saturated_v();
            let detail = format!("cell {arm} reads {:.3} V: saturated (ends at {end} V)", volts[i]);
            return Err(Trip { kind: TripKind::Cell, detail });
        }
        if forces[i] > limits.each_n {
            let detail =
                format!("force on arm {arm} {:.1} N over its limit {} N", forces[i], limits.each_n);
            return Err(Trip { kind: TripKind::Force, detail });
        }
    }
    let sum: f64 = forces[..usize::from(tips)].iter().sum();
    if sum > limits.sum_n {
        let detail = format!("sum of forces {sum:.1} N over its limit {} N", limits.sum_n);
        return Err(Trip { kind: TripKind::Force, detail });
    }
    Ok(())
}

/// Checks a measured position against the soft limits.
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

/// A cell in contact must feel growing depth: finds one that stayed still, by its raw output.
/// `before` and `after` are settled readings one depth step apart.
pub fn still_cell(
    cells: &CellsConfig,
    tips: u8,
    before: &[f64; ARMS],
    after: &[f64; ARMS],
    tare_v: &[f64; ARMS],
) -> Option<u8> {
    const IN_CONTACT_N: f64 = 2.0;
    const STILL_N: f64 = 0.02;
    let scale = cells.newtons_per_volt();
    (0..usize::from(tips))
        .find(|&i| {
            (before[i] - tare_v[i]) * scale > IN_CONTACT_N
                && ((after[i] - before[i]) * scale).abs() < STILL_N
        })
        .map(|i| i as u8 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;

    fn cells() -> CellsConfig {
        let text = include_str!("../../experiments/rigs/virtual.toml");
        RigConfig::from_toml("virtual.toml", text).expect("the virtual rig file is sound").cells
    }

    const LIMITS: ForceLimits = ForceLimits { each_n: 50.0, sum_n: 120.0 };
    const TARE: [f64; ARMS] = [0.5; ARMS];

    fn at_n(forces: [f64; ARMS]) -> [f64; ARMS] {
        forces.map(|f| 0.5 + f / cells().newtons_per_volt())
    }

    #[test]
    fn a_force_over_its_limit_trips_and_names_the_arm() {
        let trip = check_cells(&cells(), LIMITS, 2, &at_n([1.0, 50.5, 0.0, 0.0, 0.0, 0.0]), &TARE);
        let trip = trip.unwrap_err();
        assert_eq!(trip.kind, TripKind::Force);
        assert_eq!(trip.detail, "force on arm 2 50.5 N over its limit 50 N");
    }

    #[test]
    fn forces_within_each_limit_can_still_be_too_much_in_sum() {
        let trip = check_cells(&cells(), LIMITS, 3, &at_n([45.0; ARMS]), &TARE).unwrap_err();
        assert_eq!(trip.kind, TripKind::Force);
    }

    #[test]
    fn unattached_arms_are_not_looked_at() {
        let mut volts = at_n([10.0; ARMS]);
        volts[3..].fill(0.0);
        assert_eq!(check_cells(&cells(), LIMITS, 3, &volts, &TARE), Ok(()));
        assert_eq!(
            check_cells(&cells(), LIMITS, 4, &volts, &TARE).unwrap_err().kind,
            TripKind::Cell
        );
    }

    #[test]
    fn live_tips_must_be_the_first_arms() {
        assert_eq!(live_tips(&cells(), &[0.5, 0.51, 0.0, 0.0, 0.0, 0.0]), Ok(2));
        assert!(live_tips(&cells(), &[0.5, 0.0, 0.5, 0.0, 0.0, 0.0]).is_err());
    }

    #[test]
    fn a_cell_that_feels_nothing_while_depth_grows_is_found() {
        let before = at_n([10.0, 12.0, 0.0, 0.0, 0.0, 0.0]);
        let after = at_n([15.0, 12.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(still_cell(&cells(), 2, &before, &after, &TARE), Some(2));
        assert_eq!(still_cell(&cells(), 1, &before, &after, &TARE), None);
    }
}
