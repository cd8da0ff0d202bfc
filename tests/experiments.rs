//! The experiment files that ship: each parses, plans and can be done on the virtual rig's bench.
//! And what they say when they cannot.

use std::path::PathBuf;
use std::time::Instant;

use palpate::rig::config::{LinearAxis, RigConfig};
use palpate::schedule::estimate::{Bench, Motion};
use palpate::schedule::experiment::Experiment;
use palpate::schedule::lint::lint;
use palpate::schedule::plan::Plan;
use palpate::schedule::preflight::Preflight;
use palpate::schedule::reach::Reach;
use sim_core::sensor::Sensor;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("experiments")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(folder().join(name)).unwrap()
}

fn sensor() -> Sensor {
    Sensor::from_toml(&read("sensors/ert-28.toml")).unwrap()
}

fn virtual_rig() -> RigConfig {
    RigConfig::from_toml("rigs/virtual.toml", &read("rigs/virtual.toml")).unwrap()
}

fn reach(rig: &RigConfig) -> Reach {
    Reach {
        file: "rigs/virtual.toml".into(),
        x_travel_mm: rig.axes.x.travel_mm,
        y_travel_mm: rig.axes.y.travel_mm,
        z_travel_mm: rig.axes.z.travel_mm,
        radius_mm: rig.slot.radius_mm,
        backlash_mm: rig.slot.backlash_mm,
        skin_origin_mm: [rig.skin.origin_x_mm, rig.skin.origin_y_mm],
        surface_z_mm: rig.skin.surface_z_mm,
        clearance_mm: rig.skin.clearance_mm,
        force_n: rig.limits.force_n,
        force_sum_n: rig.limits.force_sum_n,
        cell_update_ms: rig.cells.update_ms,
        electrodes: rig.ert.electrodes().into(),
    }
}

fn bench(rig: &RigConfig) -> Bench {
    let linear = |axis: &LinearAxis| Motion {
        speed_mm_s: axis.speed_mm_s,
        acceleration_mm_s2: axis.acceleration_mm_s2,
    };
    let per_deg = rig.slot.mm_per_deg.abs();
    Bench {
        x: linear(&rig.axes.x),
        y: linear(&rig.axes.y),
        z: linear(&rig.axes.z),
        radial: Motion {
            speed_mm_s: rig.axes.radial.speed_deg_s * per_deg,
            acceleration_mm_s2: rig.axes.radial.acceleration_deg_s2 * per_deg,
        },
        approach_mm_s: rig.approach_speed_mm_s(),
        clearance_mm: rig.skin.clearance_mm,
        surface_z_mm: rig.skin.surface_z_mm,
        backlash_mm: rig.slot.backlash_mm,
        cell_update_ms: rig.cells.update_ms,
        frame_rate_hz: rig.ert.frame_rate_hz(),
        clock_rate: rig.clock_rate,
    }
}

fn plan(name: &str) -> Plan {
    let experiment = Experiment::from_toml(name, &read(name)).unwrap();
    Plan::of(name, &experiment, &sensor()).unwrap()
}

#[test]
fn show() {
    for name in ["quickstart.toml", "real-hex.toml", "real-hex-6.toml", "real-random.toml"] {
        let start = Instant::now();
        let plan = plan(name);
        let planned = start.elapsed();
        let rig = virtual_rig();
        let experiment = Experiment::from_toml(name, &read(name)).unwrap();
        let problems = lint(name, &experiment, &sensor(), &reach(&rig));
        println!("{}", Preflight::of(&plan, &bench(&rig), problems));
        println!("{planned:?} {:?}", start.elapsed());
    }
}
