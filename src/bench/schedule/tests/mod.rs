//! Properties of every plan, and of the predictions from it.

mod plans;
mod predictions;
mod schema;

use sim_core::sensor::Sensor;

use super::estimate::{Bench, Motion, StageTimes};
use super::experiment::Experiment;
use super::plan::{Plan, Step};

/// The paper's skin.
pub(super) fn skin() -> Sensor {
    Sensor::from_toml(include_str!("../../../../experiments/sensors/ert-28.toml")).unwrap()
}

pub(crate) fn hex(seed: u64, keys: &str) -> Experiment {
    let text = format!(
        "name = \"test\"\nseed = {seed}\nsensor = \"sensors/ert-28.toml\"\n[real_hex]\n{keys}"
    );
    Experiment::from_toml("test.toml", &text).unwrap()
}

pub(crate) fn planned(experiment: &Experiment) -> Plan {
    Plan::of("test.toml", experiment, &skin()).unwrap()
}

/// Round numbers, so that times can be calculated manually.
fn bench() -> Bench {
    let motion = |speed_mm_s, acceleration_mm_s2| Motion { speed_mm_s, acceleration_mm_s2 };
    let stage = StageTimes {
        x: motion(200.0, 1000.0),
        y: motion(200.0, 1000.0),
        z: motion(50.0, 1000.0),
        radial: motion(100.0, 1000.0),
        approach_mm_s: 2.0,
        clearance_mm: 5.0,
        surface_z_mm: [50.0, 70.0],
        backlash_mm: 0.4,
        cell_update_ms: 100.0,
        z_watchdog_ms: None,
    };
    Bench { stage: Some(stage), frame_rate_hz: 30.0, clock_rate: 1.0 }
}

fn references(plan: &Plan) -> usize {
    plan.steps.iter().filter(|s| matches!(s, Step::Reference(_))).count()
}
