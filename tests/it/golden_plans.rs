//! The plans of the carried experiments do not change: a run that was planned by an earlier version
//! must find the same steps, or its resume is refused.
//!
//! `UPDATE=1 cargo test --test it golden` writes the digests of today's plans. A changed line
//! means that no run planned before can resume: state it in the commit.

use std::path::Path;

use palpate::digest::sha256_hex;
use palpate::schedule::experiment::Experiment;
use palpate::schedule::plan::Plan;
use sim_core::sensor::Sensor;

use crate::support::with_extension;

#[test]
fn the_plans_of_the_carried_experiments_are_the_golden_ones() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (carried, golden) = (here.join("experiments"), here.join("tests/it/golden_plans.txt"));
    let mut lines = String::new();
    for path in with_extension(&carried, "toml") {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        let experiment =
            Experiment::from_toml(&file, &std::fs::read_to_string(&path).unwrap()).unwrap();
        let sensor = std::fs::read_to_string(carried.join(&experiment.sensor)).unwrap();
        let plan = Plan::of(&file, &experiment, &Sensor::from_toml(&sensor).unwrap()).unwrap();
        let (steps, digest) = (plan.steps.len(), sha256_hex(plan.text()));
        lines += &format!("{file} {steps} steps {digest}\n");
    }
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&golden, &lines).unwrap();
    }
    let kept = std::fs::read_to_string(&golden).unwrap();
    assert_eq!(lines, kept, "a plan has changed: see the head of this file");
}
