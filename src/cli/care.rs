//! Text of what needs care: disk, age of the last trial, what may suspend the run, wear of the rig.
//! Uses: the service's answers, `output`, `times`. Never: a request.

use jiff::Timestamp;
use serde::Deserialize;
use serde_json::Value;

use super::output::{bytes, counted, duration, grouped};
use super::times::local;
use crate::api::{DiskStatus, Suspender};

/// What the status reports in addition to rig and run. Absent in the answer of an older service.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct CareView {
    /// Space of the disk of the data folder.
    pub disk: Option<DiskStatus>,
    /// Time of the newest durable trial of the active run.
    pub last_trial_at: Option<Timestamp>,
    /// What may suspend the active run.
    pub suspenders: Vec<Suspender>,
}

impl CareView {
    /// Lines of `palpate status`.
    pub fn lines(&self, now: Timestamp) -> Vec<String> {
        let mut lines = Vec::new();
        let ago = |at: Timestamp| duration(now.duration_since(at).as_secs_f64());
        if let Some(at) = self.last_trial_at {
            lines.push(format!("stored   the last trial {} ago", ago(at)));
        }
        if let Some(DiskStatus { free_bytes, needed_bytes }) = self.disk {
            let mark = if free_bytes < needed_bytes { "TOO LITTLE: " } else { "" };
            let (free, needed) = (bytes(free_bytes as f64), bytes(needed_bytes as f64));
            lines.push(format!("disk     {mark}{free} free, run and queue need {needed}"));
        }
        let others = self.suspenders.iter().filter(|s| s.name != "disk");
        for (n, suspender) in others.enumerate() {
            let head = if n == 0 { "watched " } else { "        " };
            let since = suspender.since.map_or_else(String::new, |at| {
                let effect = if suspender.suspends { "suspends the run" } else { "warning" };
                format!(", BEYOND IT for {} ({effect})", ago(at))
            });
            lines.push(format!("{head} {}{since}", suspender_words(suspender)));
        }
        lines
    }
}

fn suspender_words(suspender: &Suspender) -> String {
    let shown = |value: f64| match suspender.unit.as_str() {
        "bytes" => bytes(value),
        "1" => format!("{value:.2}"),
        unit => format!("{value:.0} {unit}"),
    };
    let value = suspender.value.map_or_else(|| "unknown".into(), shown);
    let (name, threshold) = (suspender.name.replace('_', " "), shown(suspender.threshold));
    format!("{name} {value}, limit {threshold}")
}

/// Text of `palpate rig wear`.
pub fn wear_words(wear: &Value) -> String {
    let text = |value: &Value| value.as_str().unwrap_or("-").to_owned();
    let time = |value: &Value| {
        let at = value.as_str().and_then(|at| at.parse().ok());
        at.map_or_else(|| "-".into(), local)
    };
    let trials = counted(wear["trials"].as_u64().unwrap_or_default(), "trial", "trials");
    let runs = counted(wear["runs"].as_u64().unwrap_or_default(), "run", "runs");
    let hours =
        wear["run_h"].as_f64().map_or_else(String::new, |hours| format!(" of {hours:.1} h"));
    let mut lines =
        vec![format!("trials   {trials} in {runs}{hours}, since {}", time(&wear["since"]))];
    let numbers = |key: &str| {
        let list = wear["points"][key].as_array().cloned().unwrap_or_default();
        list.iter().filter_map(Value::as_f64).collect::<Vec<f64>>()
    };
    let presses = numbers("presses");
    let places = numbers("x_mm").into_iter().zip(numbers("y_mm"));
    let busiest = presses.iter().zip(places).max_by(|a, b| a.0.total_cmp(b.0));
    lines.push(match busiest {
        None => "skin     never pressed".into(),
        Some((most, (x, y))) => format!(
            "skin     {} on {}, most at x {x:.1}, y {y:.1} mm: {}",
            counted(presses.iter().sum::<f64>() as u64, "press", "presses"),
            counted(presses.len() as u64, "place", "places"),
            grouped(*most as u64)
        ),
    });
    let axes = wear["axes"].as_array().into_iter().flatten().map(|axis| {
        format!("{} {:.1} m", text(&axis["axis"]), axis["travel_m"].as_f64().unwrap_or_default())
    });
    lines.push(format!("travel   at least {}", axes.collect::<Vec<_>>().join(", ")));
    let cells = wear["cells"].as_array().into_iter().flatten().map(|cell| {
        let age = cell["age_days"].as_i64();
        let age = age.map_or_else(|| "unknown".into(), |days| format!("{days} d ago"));
        format!("{} {age}", cell["arm"])
    });
    let cells = cells.collect::<Vec<_>>().join(", ");
    lines.push(format!("cells    calibrated, by arm: {cells} (`cells.calibrated_on`)"));
    lines.push(format!("checked  {}", time(&wear["checked_at"])));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_status_names_what_is_beyond_its_limit() {
        let view = json!({
            "disk": { "free_bytes": 2_000_000_000_u64, "needed_bytes": 3_000_000_000_u64 },
            "last_trial_at": "2026-11-23T00:00:00Z",
            "suspenders": [
                { "name": "disk", "title": "", "value": 2e9, "threshold": 3e9, "unit": "bytes",
                    "since": "2026-11-23T00:00:00Z", "suspends": true },
                { "name": "frame_age", "title": "", "value": 12.4, "threshold": 2000.0, "unit": "ms",
                    "since": null, "suspends": true },
                { "name": "twin_fvu", "title": "", "value": 0.4, "threshold": 0.3, "unit": "1",
                    "since": "2026-11-22T23:59:00Z", "suspends": false },
            ],
        });
        let care: CareView = serde_json::from_value(view).unwrap();
        let now = "2026-11-23T00:00:04Z".parse().unwrap();
        let wanted = [
            "stored   the last trial 4.0 s ago",
            "disk     TOO LITTLE: 2.00 GB free, run and queue need 3.00 GB",
            "watched  frame age 12 ms, limit 2000 ms",
            "         twin fvu 0.40, limit 0.30, BEYOND IT for 1 min 4 s (warning)",
        ];
        assert_eq!(care.lines(now), wanted);
        let older: CareView = serde_json::from_value(json!({ "rig": {} })).unwrap();
        assert_eq!(older.lines(now), [""; 0]);
    }

    #[test]
    fn the_wear_names_the_busiest_place() {
        let wear = json!({
            "since": null, "trials": 22, "runs": 1, "run_h": 3.3, "checked_at": null,
            "points": { "x_mm": [17.32, 34.64], "y_mm": [55.0, 55.0], "presses": [1, 3000] },
            "axes": [{ "axis": "x", "travel_m": 12.34 }, { "axis": "z", "travel_m": 0.5 }],
            "cells": [{ "arm": 1, "calibrated_on": null, "age_days": null },
                { "arm": 2, "calibrated_on": "2026-05-04", "age_days": 30 }],
        });
        let words = wear_words(&wear);
        assert!(words.contains("22 trials in 1 run of 3.3 h, since -"), "{words}");
        assert!(
            words.contains("3,001 presses on 2 places, most at x 34.6, y 55.0 mm: 3,000"),
            "{words}"
        );
        assert!(words.contains("at least x 12.3 m, z 0.5 m"), "{words}");
        assert!(words.contains("1 unknown, 2 30 d ago"), "{words}");
        let at: Timestamp = "2026-05-04T22:00:07.299Z".parse().unwrap();
        let words = wear_words(&json!({ "since": at, "checked_at": at }));
        assert!(words.contains(&format!("since {}\n", local(at))), "{words}");
        assert!(words.ends_with(&format!("checked  {}", local(at))), "{words}");
    }
}
