//! The physics compared with closed forms, other methods and earlier prototypes
//! (`docs/references.md`, "Feasibility study"). One binary, so that the elastic solve (seconds) is
//! done once.

use std::sync::{Arc, OnceLock};

use sim_core::forward::{Contact, ForwardModel};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

mod batch;
mod calculix;
mod contacts;
mod convergence;
mod deformation;
mod elements;
mod forward;
mod jacobian;
mod linear;
mod mesh;
mod network;
mod ngspice;
mod steady;
mod surface;
mod tip;
mod tools;

/// The paper's skin.
fn sensor() -> &'static Sensor {
    static SENSOR: OnceLock<Sensor> = OnceLock::new();
    SENSOR.get_or_init(|| {
        let text = include_str!("../../../experiments/sensors/ert-28.toml");
        Sensor::from_toml(text).expect("the sensor file is sound")
    })
}

fn responses() -> Arc<UnitResponses> {
    static RESPONSES: OnceLock<Arc<UnitResponses>> = OnceLock::new();
    let solve = || Arc::new(UnitResponses::solve(sensor()).expect("the skin can be solved"));
    Arc::clone(RESPONSES.get_or_init(solve))
}

fn model() -> &'static ForwardModel {
    static MODEL: OnceLock<ForwardModel> = OnceLock::new();
    MODEL.get_or_init(|| ForwardModel::new(sensor(), responses()).expect("the model can be built"))
}

fn press(point: usize, force_n: f64) -> Contact {
    let p = sensor().points()[point];
    Contact { x_mm: p.x_mm, y_mm: p.y_mm, force_n }
}

/// Index of the point nearest to a position, mm.
fn point_at(x_mm: f64, y_mm: f64) -> usize {
    let distance = |i: &usize| {
        let p = sensor().points()[*i];
        (p.x_mm - x_mm).hypot(p.y_mm - y_mm)
    };
    (0..sensor().points().len())
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .expect("the skin has points")
}

/// Standard deviation over a frame's values.
fn sd(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}
