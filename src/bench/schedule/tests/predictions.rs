//! Durations calculated manually, travel counted independently, and the preflight as read by people
//! and scripts.

use super::{bench, hex, planned};
use crate::problem::Problem;
use crate::schedule::estimate::{Bench, Estimate, Estimates, Motion, estimate};
use crate::schedule::plan::{Plan, Step};
use crate::schedule::preflight::Preflight;

fn small() -> Plan {
    planned(&hex(
        1,
        "tips = [1, 4]\nconfigurations = 12\nblock = 6\nreference_every = 6\n\
         [measure]\nsettle_ms = 1000.0\ntare_samples = 4\nframes_per_trial = 2\n",
    ))
}

fn whole(plan: &Plan, bench: &Bench) -> Estimate {
    estimate(plan, bench).whole
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * b.abs().max(1.0)
}

#[test]
fn a_move_is_a_triangle_or_a_trapezium() {
    let motion = Motion { speed_mm_s: 200.0, acceleration_mm_s2: 1000.0 };
    assert_eq!(motion.time_s(0.0), 0.0);
    assert!(near(motion.time_s(10.0), 0.2), "0.1 s up to 100 mm/s and 0.1 s down");
    assert!(near(motion.time_s(-40.0), 0.4), "just reaches its speed");
    assert!(near(motion.time_s(140.0), 0.9), "0.2 s up, 0.5 s at speed, 0.2 s down");
}

#[test]
fn parts_that_can_be_counted_are_what_was_counted() {
    let parts = whole(&small(), &bench()).parts;
    let trials = 2.0 * 12.0 * 11.0;
    assert!(near(parts.settle_s, trials * 1.0));
    assert!(near(parts.frames_s, trials * (2.0 + 1.5) / 30.0), "two kept, one and a half dropped");
    assert!(near(parts.tare_s, 24.0 * 4.5 * 0.1), "four samples, half a period to the first");
    assert!(near(parts.press_s, 24.0 * 10.0 * (0.5 / 2.0 + 2.0 / 1000.0)), "ten steps of 0.5 mm");
    assert!(near(parts.approach_s, 24.0 * (3.65 / 50.0 + 0.05)), "from 5 mm to 1.35 mm");
    assert!(near(parts.raise_s, 24.0 * (8.65 / 50.0 + 0.05)), "from 3.65 mm below to 5 mm above");
}

#[test]
fn the_whole_is_its_parts_and_its_settings() {
    let Estimates { settings, whole } = estimate(&small(), &bench());
    assert!(near(whole.duration_s, whole.parts.total_s()));
    assert_eq!(settings.iter().map(|s| s.tips).collect::<Vec<_>>(), [Some(1), Some(4)]);
    assert!(near(whole.duration_s, settings.iter().map(|s| s.duration_s).sum()));
    assert_eq!(whole.disk_bytes, settings.iter().map(|s| s.disk_bytes).sum::<u64>());
    assert_eq!(whole.trials, 264);
    assert!(whole.low_s < whole.duration_s && whole.duration_s < whole.high_s);
}

#[test]
fn an_accelerated_rig_shortens_processes_and_not_wires() {
    let fast = Bench { clock_rate: 100.0, ..bench() };
    let (slow, fast) = (whole(&small(), &bench()).parts, whole(&small(), &fast).parts);
    assert!(near(fast.settle_s, slow.settle_s / 100.0));
    assert!(near(fast.lateral_s, slow.lateral_s / 100.0));
    assert_eq!(fast.other_s, slow.other_s);
}

#[test]
fn a_smaller_radius_costs_its_overshoot() {
    let mut tight = bench();
    tight.stage.as_mut().unwrap().backlash_mm = 0.0;
    assert!(whole(&small(), &bench()).duration_s > whole(&small(), &tight).duration_s);
}

#[test]
fn travel_is_counted_over_every_step_in_both_orders() {
    let plan = small();
    let preflight = Preflight::of(&plan, &bench(), Vec::new());
    let length = |centres: &[[f64; 2]]| -> f64 {
        centres.windows(2).map(|p| (p[0][0] - p[1][0]).hypot(p[0][1] - p[1][1])).sum()
    };
    let mut planned = Vec::new();
    let mut drawn = Vec::new();
    let mut all: Vec<_> = plan.configurations().collect();
    all.sort_by_key(|c| (c.setting, c.draw));
    let mut in_drawn_order = all.iter().map(|c| c.stand.centre_mm);
    for step in &plan.steps {
        let fixed: Vec<[f64; 2]> = match step {
            Step::TouchOff { places, .. } => places.iter().map(|s| s.centre_mm).collect(),
            Step::Reference(press) => vec![press.stand.centre_mm],
            Step::Configuration(c) => {
                planned.push(c.stand.centre_mm);
                drawn.extend(in_drawn_order.next());
                continue;
            }
            Step::TipChange { .. } | Step::Manual(_) => continue,
        };
        planned.extend(&fixed);
        drawn.extend(fixed);
    }
    assert!(near(preflight.travel_mm, length(&planned)));
    assert!(near(preflight.travel_random_order_mm, length(&drawn)));
    assert!(preflight.travel_ratio.unwrap() < 1.0);
}

#[test]
fn scripts_find_the_fields_that_the_contract_names() {
    let preflight = Preflight::of(&small(), &bench(), Vec::new());
    let json = serde_json::to_value(&preflight).unwrap();
    assert_eq!(json["trials"], 264);
    assert_eq!(json["configurations"], 24);
    for key in ["distinct_configurations", "duration_s", "travel_mm", "travel_random_order_mm"] {
        assert!(json[key].as_f64().unwrap() > 0.0, "{key}");
    }
    let (disk, fixed) = (json["disk_bytes"].as_u64(), json["disk_fixed_bytes"].as_u64());
    // The paper's skin has 3503 nodes in our layout: 49 MB of unit responses.
    assert_eq!(fixed, Some((64 << 20) + 4 * 3503 * 3503));
    assert!(disk.unwrap() > fixed.unwrap() + 264 * 2 * 784 * 2, "the counts of its frames");
    assert_eq!(json["problems"], serde_json::json!([]));
}

#[test]
fn people_read_one_thing_on_a_line() {
    let problem = Problem::new("rig.toml", "axes.x.travel_mm", "[0, 9]", "too short");
    let mut preflight = Preflight::of(&small(), &bench(), vec![problem]);
    let text = preflight.to_string();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "test (real-hex, seed 1)");
    assert_eq!(lines[1], "  trials               264");
    assert_eq!(lines[2], "  configurations       24, 24 distinct");
    assert!(lines.contains(&"  waits for a person   2 times, not in the duration"), "{text}");
    assert_eq!(lines[lines.len() - 1], "    rig.toml: axes.x.travel_mm = [0, 9]: too short");
    preflight.waits_for_person = 1;
    let once = "  waits for a person   1 time, not in the duration\n";
    assert!(preflight.to_string().contains(once), "{preflight}");
}
