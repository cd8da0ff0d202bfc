//! Guards: values in a rig file that a drive enforces without the service, against silence or
//! excessive torque. Which drives have them is stated in their folders.
//! PURE. Uses: serde. Never: registers (each device knows its own), their limits (`device`),
//! consequences for a run.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Guards of one drive. An absent value is left as it is set in the drive.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guard {
    /// Watchdog time, wall ms: the drive stops if no request arrives for this duration. Without it
    /// an axis continues to its target and stays there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watchdog_ms: Option<u64>,
    /// Torque limit of a motion, % of the rated torque.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_percent: Option<u32>,
}

impl Guard {
    /// Whether no guard is requested.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for Guard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.watchdog_ms, self.torque_percent) {
            (None, None) => write!(f, "no guard"),
            (Some(ms), None) => write!(f, "watchdog {ms} ms"),
            (None, Some(percent)) => write!(f, "torque {percent} %"),
            (Some(ms), Some(percent)) => write!(f, "watchdog {ms} ms, torque {percent} %"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::config::RigConfig;

    const IAI: &str = include_str!("../../../experiments/rigs/iai-modbus-tcp.toml");
    const AZ: &str = include_str!("../../../experiments/rigs/oriental-az-rtu.toml");

    /// The guard of z with these lines added to `[axes.z]`, or the problem found.
    fn parsed(text: &str, lines: &str) -> Result<Guard, String> {
        let text = text.replacen("[axes.z]", &format!("[axes.z]\n{lines}"), 1);
        let config = RigConfig::from_toml("r.toml", &text);
        let said = |p: Vec<crate::problem::Problem>| {
            p.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
        };
        config.map(|rig| rig.axes.z.guard).map_err(said)
    }

    #[test]
    fn a_drive_that_has_guards_takes_them_within_their_limits() {
        assert!(parsed(AZ, "").unwrap().is_none());
        let both = parsed(AZ, "guard = { watchdog_ms = 500, torque_percent = 60 }").unwrap();
        assert_eq!((both.watchdog_ms, both.torque_percent), (Some(500), Some(60)));
        assert_eq!(both.to_string(), "watchdog 500 ms, torque 60 %");
        assert_eq!(
            parsed(AZ, "guard = { watchdog_ms = 5, torque_percent = 0 }").unwrap_err(),
            "r.toml: axes.z.guard.watchdog_ms = 5: must be from 100 to 10000\n\
             r.toml: axes.z.guard.torque_percent = 0: must be from 5 to 100"
        );
    }

    #[test]
    fn a_guard_that_the_drive_lacks_is_refused_by_name() {
        assert_eq!(
            parsed(IAI, "guard = { watchdog_ms = 500 }").unwrap_err(),
            "r.toml: axes.z.guard.watchdog_ms = 500: iai has no communication watchdog that can be \
             set over its wire: remove it"
        );
        let unknown = parsed(AZ, "guard = { watchdog = 500 }").unwrap_err();
        assert!(unknown.contains("watchdog") && unknown.contains("unknown key"), "{unknown}");
    }
}
