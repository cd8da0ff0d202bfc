//! The paper's sensor and its model, for the tests of this chapter.
//! Uses: sim-core. Never: outside of tests.

use std::sync::{Arc, LazyLock};

use sim_core::forward::ForwardModel;
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

/// Text of the sensor file.
pub const SENSOR: &str = include_str!("../../../experiments/sensors/ert-28.toml");

/// The sensor of the paper, as the carried file describes it.
pub fn sensor() -> Sensor {
    Sensor::from_toml(SENSOR).unwrap()
}

/// The model of its foam as printed, before any fit to a skin.
pub static MODEL: LazyLock<ForwardModel> = LazyLock::new(|| {
    let sensor = sensor();
    let responses = Arc::new(UnitResponses::solve(&sensor).unwrap());
    ForwardModel::new(&sensor, responses).unwrap()
});
