//! Parses and checks faults: a script in TOML, or one fault in JSON.
//! Uses: serde, toml. Never: a fault that the rig of the script cannot have.

use serde::Deserialize;

use super::{CellFault, Damage, Fault, Kind, Part, Start, Target, WireFault};
use crate::config::{ARMS, AxisName, RigFile};

/// Error in a fault script.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum FaultError {
    /// The text is not TOML (or JSON), or has a key or a type that a fault does not have.
    #[error("{0}")]
    Syntax(String),
    #[error("fault {index}: {key} = {value}: {limit}")]
    Value { index: usize, key: &'static str, value: String, limit: String },
}

/// A fault as written in a script.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultEntry {
    /// Number in the script, from 1.
    #[serde(skip)]
    index: usize,
    kind: String,
    device: String,
    at_s: Option<f64>,
    at_frame: Option<u32>,
    at_press: Option<u64>,
    for_s: Option<f64>,
    count: Option<u32>,
    code: Option<u16>,
    delay_ms: Option<u64>,
    part: Option<Part>,
    executed: Option<bool>,
    arm: Option<u8>,
    n_per_s: Option<f64>,
    n: Option<f64>,
    rate: Option<f64>,
    alarm_after_s: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Script {
    #[serde(default)]
    fault: Vec<FaultEntry>,
}

/// Parses and checks a fault script for a rig.
///
/// # Errors
/// `FaultError` for the first invalid fault.
pub fn script(text: &str, rig: &RigFile) -> Result<Vec<Fault>, FaultError> {
    let script: Script = toml::from_str(text).map_err(|e| FaultError::Syntax(e.to_string()))?;
    let entries = script.fault.into_iter().enumerate();
    entries.map(|(i, entry)| FaultEntry { index: i + 1, ..entry }.check(rig)).collect()
}

/// Parses and checks one fault from the control socket; without a start it begins immediately.
///
/// # Errors
/// `FaultError` if the fault is not valid.
pub fn from_json(value: serde_json::Value, rig: &RigFile) -> Result<Fault, FaultError> {
    let entry: FaultEntry =
        serde_json::from_value(value).map_err(|e| FaultError::Syntax(e.to_string()))?;
    FaultEntry { index: 1, ..entry }.check(rig)
}

impl FaultEntry {
    fn bad(&self, key: &'static str, value: impl ToString, limit: &str) -> FaultError {
        let (index, value) = (self.index, value.to_string());
        FaultError::Value { index, key, value, limit: limit.to_owned() }
    }

    /// A value that the kind needs, from 1 to `most`.
    fn needed(&self, key: &'static str, value: Option<u64>, most: u64) -> Result<u64, FaultError> {
        value.filter(|value| (1..=most).contains(value)).ok_or_else(|| {
            let shown = value.map_or(String::new(), |value| value.to_string());
            self.bad(key, shown, &format!("is needed: 1 to {most}"))
        })
    }

    fn arm(&self) -> Result<usize, FaultError> {
        match self.arm {
            Some(arm) if (1..=ARMS as u8).contains(&arm) => Ok(usize::from(arm) - 1),
            Some(arm) => Err(self.bad("arm", arm, "must be 1 to 6")),
            None => Err(self.bad("arm", "", "is needed: 1 to 6")),
        }
    }

    /// Load on a cell, N, positive: the kind determines whether it pushes or pulls.
    fn load_n(&self) -> Result<f64, FaultError> {
        match self.n {
            Some(n) if n > 0.0 && n <= 1000.0 => Ok(n),
            Some(n) => Err(self.bad("n", n, "must be above 0, at most 1000")),
            None => Err(self.bad("n", "", "is needed: newtons")),
        }
    }

    fn rate(&self) -> Result<f64, FaultError> {
        let rate = self.rate.unwrap_or(1.0);
        let ok = rate > 0.0 && rate <= 1.0;
        if ok { Ok(rate) } else { Err(self.bad("rate", rate, "must be in (0, 1]")) }
    }

    fn cell(&self, fault: CellFault) -> Result<Kind, FaultError> {
        Ok(Kind::Cell { arm: self.arm()?, fault })
    }

    fn bytes(&self, damage: Damage) -> Result<Kind, FaultError> {
        Ok(Kind::Bytes { rate: self.rate()?, damage })
    }

    fn kind(&self) -> Result<Kind, FaultError> {
        let executed = self.executed.unwrap_or(false);
        Ok(match self.kind.as_str() {
            "no_reply" => Kind::Wire(WireFault::NoReply { executed }),
            "disconnect" => Kind::Wire(WireFault::Disconnect { executed }),
            "exception" => {
                let code = self.needed("code", self.code.map(u64::from), 255)?;
                Kind::Wire(WireFault::Exception(code as u8))
            }
            "late_reply" => {
                let delay_ms = self.needed("delay_ms", self.delay_ms, 60_000)?;
                Kind::Wire(WireFault::Late { delay_ms })
            }
            "garbled_reply" => Kind::Wire(WireFault::Garbled(self.part.unwrap_or(Part::Header))),
            "stuck_axis" => Kind::StuckAxis { alarm_after_s: self.alarm_after_s },
            "alarm" => Kind::Alarm { code: self.code.unwrap_or(0xFF) },
            "power_loss" => Kind::PowerLoss,
            "motor_off" => Kind::MotorOff,
            // A hanging module repeats its last conversion.
            "stale_registers" | "hung_module" => Kind::StaleRegisters,
            "dead_cell" => self.cell(CellFault::Dead)?,
            "saturated_cell" => self.cell(CellFault::Saturated)?,
            "frozen_cell" => self.cell(CellFault::Frozen)?,
            "drifting_cell" => {
                let n_per_s = self.n_per_s.ok_or_else(|| self.bad("n_per_s", "", "is needed"))?;
                self.cell(CellFault::Drifting { n_per_s })?
            }
            "foreign_load" => self.cell(CellFault::Loaded { n: self.load_n()? })?,
            "pulling_cell" => self.cell(CellFault::Loaded { n: -self.load_n()? })?,
            "missing_tip" => self.cell(CellFault::MissingTip)?,
            "uncoupled_cell" => self.cell(CellFault::Uncoupled)?,
            "drop_bytes" => self.bytes(Damage::Drop)?,
            "flip_bytes" => self.bytes(Damage::Flip)?,
            "double_bytes" => self.bytes(Damage::Double)?,
            "stall_stream" => Kind::StallStream,
            other => return Err(self.bad("kind", other, KINDS)),
        })
    }

    fn target(&self, rig: &RigFile) -> Result<Target, FaultError> {
        let device = self.device.as_str();
        if let Some(&axis) = AxisName::ALL.iter().find(|a| a.as_str() == device) {
            return Ok(Target::Axis(axis));
        }
        match device {
            "ert" => Ok(Target::Ert),
            "cells" if !rig.lines.contains_key("cells") || self.affects_cells() => {
                Ok(Target::Cells)
            }
            line if rig.lines.contains_key(line) => Ok(Target::Line(line.to_owned())),
            other => {
                let lines: Vec<&str> = rig.lines.keys().map(String::as_str).collect();
                let limit =
                    format!("must be x, y, z, radial, cells, ert or a line: {}", lines.join(", "));
                Err(self.bad("device", other, &limit))
            }
        }
    }

    /// A line may be called `cells`: then only faults of a module refer to the module.
    fn affects_cells(&self) -> bool {
        let kind = self.kind.as_str();
        let of_module = ["stale_registers", "hung_module", "foreign_load", "missing_tip"];
        kind.ends_with("_cell") || of_module.contains(&kind)
    }

    fn start(&self) -> Result<Start, FaultError> {
        match (self.at_s, self.at_frame, self.at_press) {
            (Some(t), None, None) if t.is_finite() && t >= 0.0 => Ok(Start::Time(t)),
            (Some(t), None, None) => Err(self.bad("at_s", t, "must be 0 or more")),
            (None, Some(frame), None) => Ok(Start::Frame(frame)),
            (None, None, Some(press)) if press >= 1 => Ok(Start::Press(press)),
            (None, None, Some(press)) => Err(self.bad("at_press", press, "counts from 1")),
            (None, None, None) => Ok(Start::Now),
            _ => Err(self.bad("at_s", "", "give one of at_s, at_frame, at_press")),
        }
    }

    fn check(&self, rig: &RigFile) -> Result<Fault, FaultError> {
        let (kind, target) = (self.kind()?, self.target(rig)?);
        let (fits, targets) = match kind {
            Kind::Wire(WireFault::Disconnect { .. }) => (true, ""),
            Kind::Wire(_) => (target != Target::Ert, "an axis, cells or a line"),
            Kind::StaleRegisters if self.kind == "hung_module" => {
                (target == Target::Cells, "cells")
            }
            Kind::StaleRegisters => {
                (matches!(target, Target::Axis(_) | Target::Cells), "an axis or cells")
            }
            Kind::StuckAxis { .. } | Kind::Alarm { .. } | Kind::PowerLoss | Kind::MotorOff => {
                (matches!(target, Target::Axis(_)), "an axis")
            }
            Kind::Cell { .. } => (target == Target::Cells, "cells"),
            Kind::Bytes { .. } | Kind::StallStream => (target == Target::Ert, "ert"),
        };
        if !fits {
            let limit = format!("{} affects only {targets}", self.kind);
            return Err(self.bad("device", &self.device, &limit));
        }
        if let Some(for_s) = self.for_s.filter(|f| !(f.is_finite() && *f > 0.0)) {
            return Err(self.bad("for_s", for_s, "must be a positive number"));
        }
        if self.count == Some(0) {
            return Err(self.bad("count", 0, "must be at least 1"));
        }
        Ok(Fault { kind, target, start: self.start()?, for_s: self.for_s, count: self.count })
    }
}

const KINDS: &str = "must be no_reply, exception, disconnect, late_reply, garbled_reply, \
    stuck_axis, alarm, power_loss, motor_off, stale_registers, hung_module, dead_cell, \
    saturated_cell, frozen_cell, drifting_cell, pulling_cell, foreign_load, missing_tip, \
    uncoupled_cell, drop_bytes, flip_bytes, double_bytes or stall_stream";

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> RigFile {
        RigFile::from_toml(include_str!("../../../experiments/rigs/virtual.toml")).unwrap()
    }

    fn parse(lines: &str) -> Result<Vec<Fault>, String> {
        script(&format!("[[fault]]\n{lines}"), &rig()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_script_becomes_faults() {
        let faults = parse("kind = \"no_reply\"\ndevice = \"z\"\nat_s = 2.5\nfor_s = 1.0").unwrap();
        let expected = Fault {
            kind: Kind::Wire(WireFault::NoReply { executed: false }),
            target: Target::Axis(AxisName::Z),
            start: Start::Time(2.5),
            for_s: Some(1.0),
            count: None,
        };
        assert_eq!(faults, [expected]);
        assert_eq!(script("", &rig()).unwrap(), []);
    }

    #[test]
    fn the_example_has_every_kind() {
        let text = include_str!("../../../experiments/faults/each-kind.toml");
        script(text, &rig()).unwrap();
        let shown: std::collections::BTreeSet<&str> = text
            .lines()
            .filter_map(|line| line.strip_prefix("kind = \"")?.strip_suffix('"'))
            .collect();
        let named = KINDS.trim_start_matches("must be ").replace(" or ", ", ");
        assert_eq!(shown, named.split(", ").collect());
    }

    #[test]
    fn a_line_called_cells_and_the_module_on_it_are_told_apart() {
        let wire = parse("kind = \"no_reply\"\ndevice = \"cells\"").unwrap();
        assert_eq!(wire[0].target, Target::Line("cells".into()));
        let module = parse("kind = \"dead_cell\"\ndevice = \"cells\"\narm = 2").unwrap();
        assert_eq!(module[0].target, Target::Cells);
        assert_eq!(module[0].kind, Kind::Cell { arm: 1, fault: CellFault::Dead });
    }

    #[test]
    fn nonsense_is_named() {
        let cases = [
            ("kind = \"no_reply\"\ndevice = \"w\"", "fault 1: device = w: must be x, y, z"),
            ("kind = \"explode\"\ndevice = \"z\"", "fault 1: kind = explode: must be no_reply"),
            ("kind = \"dead_cell\"\ndevice = \"cells\"\narm = 7", "arm = 7: must be 1 to 6"),
            ("kind = \"stall_stream\"\ndevice = \"z\"", "stall_stream affects only ert"),
            ("kind = \"hung_module\"\ndevice = \"z\"", "hung_module affects only cells"),
            ("kind = \"motor_off\"\ndevice = \"cells\"", "motor_off affects only an axis"),
            ("kind = \"pulling_cell\"\ndevice = \"cells\"\narm = 1", "n = : is needed"),
            ("kind = \"exception\"\ndevice = \"z\"", "code = : is needed: 1 to 255"),
            ("kind = \"no_reply\"\ndevice = \"z\"\nat_s = 1.0\nat_press = 2", "give one of"),
            ("kind = \"no_reply\"\ndevice = \"z\"\nfor_s = 0.0", "for_s = 0"),
            ("kind = \"no_reply\"\ndevice = \"z\"\nwhen = 3", "unknown field `when`"),
        ];
        for (lines, expected) in cases {
            let error = parse(lines).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
