//! The load cells of a rig file: conversion of an output to a force, and the outputs that no
//! working cell returns. One set of thresholds, for the rig check and for the interlocks of a run.
//! PURE. Uses: `problem`, `device`, `station`. Never: ports, times, consequences of a finding (the caller decides).

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::device::{CellsDevice, CellsParts};
use super::station::Station;
use crate::clock::Clock;
use crate::problem::Checks;
use crate::record::ARMS;

/// Fraction of the supply up to which a cell counts as disconnected (its zero is at 0.1).
const DEAD_SHARE: f64 = 0.05;
/// Fraction of the supply at which the amplified output saturates.
const SATURATED_SHARE: f64 = 0.9;
/// Default of `in_air_n` on the cells of the paper, N.
const IN_AIR_N: f64 = 10.0;

/// FC22 amplified load cells on an analog input module (`docs/references.md`, "FC22 load cells").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellsConfig {
    /// Register map of the module.
    pub device: CellsDevice,
    /// Name of the wire.
    pub line: String,
    /// Modbus address of the module.
    pub unit: u8,
    /// Input channels of arms 1 to 6.
    pub channels: [u8; ARMS],
    /// Actual update period of the module, process ms.
    pub update_ms: f64,
    /// Supply voltage of the ratiometric cells, V.
    pub supply_v: f64,
    /// Full scale of a cell, N.
    pub full_scale_n: f64,
    /// Force up to which the output of a cell counts as noise, N.
    pub force_noise_n: f64,
    /// Update periods over which a working cell may return the same value; beyond them the module
    /// hangs. 0 disables the check; absent: the value of the device.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats_max: Option<u32>,
    /// Largest force on an attached arm in the air, N; absent: 10 N, but from 5 to 10 % of the full scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub in_air_n: Option<f64>,
    /// Days on which the cells of arms 1 to 6 were calibrated, as `2026-05-04`; absent: unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibrated_on: Option<[Date; ARMS]>,
}

impl CellsConfig {
    /// Force change of one volt, N/V: (V / supply - 0.1) / 0.8 x full scale (FC22 amplified).
    pub fn newtons_per_volt(&self) -> f64 {
        self.full_scale_n / (0.8 * self.supply_v)
    }

    /// Output without load, V.
    pub fn zero_v(&self) -> f64 {
        0.1 * self.supply_v
    }

    /// Whether an output, V, is that of a connected cell.
    pub fn is_live(&self, volts: f64) -> bool {
        volts > DEAD_SHARE * self.supply_v
    }

    /// Output at which the amplifier saturates, V.
    pub fn saturated_v(&self) -> f64 {
        SATURATED_SHARE * self.supply_v
    }

    /// Whether an output, V, is saturated: the true force may be larger.
    pub fn is_saturated(&self, volts: f64) -> bool {
        volts >= self.saturated_v()
    }

    /// What the driver of the cells is built from, with their module at a station.
    pub fn parts(&self, station: Station, clock: Clock) -> CellsParts {
        CellsParts {
            station,
            channels: self.channels,
            update_ms: self.update_ms,
            full_output_v: self.saturated_v(),
            clock,
        }
    }

    /// Update periods over which a value may repeat; 0: unlimited.
    pub fn repeats_max(&self) -> u32 {
        self.repeats_max.unwrap_or_else(|| self.device.repeats_max())
    }

    /// Largest force on an attached arm in the air, N: the weight of a tip, and the offset of a cell. In a zero it may
    /// have either direction, and a force limit is exceeded by as much before it trips.
    pub fn in_air_n(&self) -> f64 {
        let range_n = self.full_scale_n;
        self.in_air_n.unwrap_or(IN_AIR_N.max(range_n / 20.0).min(range_n / 10.0))
    }

    /// Whether `repeats`, the number of update periods over which a working cell has repeated its
    /// value (`CellVolts::repeats`), exceeds the limit, so that its module hangs.
    pub fn is_hung(&self, repeats: u32) -> bool {
        let most = self.repeats_max();
        most > 0 && repeats > most
    }

    pub(super) fn check(&self, c: &mut Checks<'_>) {
        c.within("cells.update_ms", self.update_ms, 0.1..=10_000.0);
        c.within("cells.supply_v", self.supply_v, 1.0..=24.0);
        c.within("cells.full_scale_n", self.full_scale_n, 1.0..=5000.0);
        c.within("cells.force_noise_n", self.force_noise_n, 0.001..=5.0);
        if let Some(in_air_n) = self.in_air_n {
            let ok = (0.1..=self.full_scale_n / 10.0).contains(&in_air_n);
            let limit = "must be from 0.1 to a tenth of cells.full_scale_n";
            c.require(ok, "cells.in_air_n", in_air_n, limit);
        }
        let channels = &self.channels;
        let distinct = (0..ARMS).all(|i| !channels[..i].contains(&channels[i]) && channels[i] < 8);
        let shown = format!("{channels:?}");
        c.require(distinct, "cells.channels", shown, "must be six different channels from 0 to 7");
        let most = self.repeats_max();
        let limit = "must be 2 to 1000, or 0 for off";
        c.require(most == 0 || (2..=1000).contains(&most), "cells.repeats_max", most, limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;

    const FILE: &str = include_str!("../../../experiments/rigs/virtual.toml");

    fn parsed(more: &str) -> Result<CellsConfig, String> {
        let text = FILE.replacen("force_noise_n = 0.1", &format!("force_noise_n = 0.1\n{more}"), 1);
        let parsed = RigConfig::from_toml("r.toml", &text);
        parsed.map(|rig| rig.cells).map_err(|problems| problems[0].to_string())
    }

    #[test]
    fn a_cell_is_live_above_a_twentieth_of_its_supply_and_saturated_from_nine_tenths_on() {
        let cells = parsed("").unwrap();
        assert_eq!([0.0, 0.25, 0.26, 0.5].map(|v| cells.is_live(v)), [false, false, true, true]);
        assert_eq!([4.49, 4.5, 4.6].map(|v| cells.is_saturated(v)), [false, true, true]);
    }

    #[test]
    fn the_days_of_calibration_are_known_for_all_cells_or_for_none() {
        assert_eq!(parsed("").unwrap().calibrated_on, None);
        let six = ["\"2026-05-04\""; ARMS].join(", ");
        let known = parsed(&format!("calibrated_on = [{six}]")).unwrap().calibrated_on;
        assert_eq!(known.map(|days| days[5].to_string()).as_deref(), Some("2026-05-04"));
        assert!(parsed("calibrated_on = [\"2026-05-04\"]").is_err());
        assert!(parsed(&format!("calibrated_on = [{}]", six.replace("-05-", "-13-"))).is_err());
    }

    #[test]
    fn the_largest_force_in_the_air_follows_from_the_range_or_is_entered_up_to_a_tenth_of_it() {
        let cells = parsed("").unwrap();
        let of_range = |full_scale_n| CellsConfig { full_scale_n, ..cells.clone() }.in_air_n();
        assert_eq!([111.2, 445.0, 44.0].map(of_range), [10.0, 22.25, 4.4]);
        assert_eq!(parsed("in_air_n = 4.5").unwrap().in_air_n(), 4.5);
        let refused = parsed("in_air_n = 12.0").unwrap_err();
        assert!(
            refused.starts_with("r.toml: cells.in_air_n = 12: must be from 0.1 to"),
            "{refused}"
        );
    }

    #[test]
    fn a_module_hangs_past_its_devices_repeats_or_past_the_files() {
        let cells = parsed("").unwrap();
        assert_eq!([8, 9].map(|n| cells.is_hung(n)), [false, true]);
        let patient = parsed("repeats_max = 40").unwrap();
        assert_eq!([40, 41].map(|n| patient.is_hung(n)), [false, true]);
        assert!(!parsed("repeats_max = 0").unwrap().is_hung(u32::MAX));
        let refused = parsed("repeats_max = 1").unwrap_err();
        assert_eq!(refused, "r.toml: cells.repeats_max = 1: must be 2 to 1000, or 0 for off");
    }
}
