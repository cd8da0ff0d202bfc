//! The skin of a work order: the texts of its sensor file and of its calibration file are inputs.
//! PURE. Uses: `order`, sim-core. Never: what else a kind of chunks needs.

use std::collections::BTreeMap;

use sim_core::calibrated::CalibratedSensor;
use sim_core::calibration::Calibration;
use sim_core::sensor::Sensor;

use super::order::{WorkOrder, invalid};
use crate::problem::Problem;

/// Input of a work order: text of the sensor file.
const SENSOR_INPUT: &str = "sensor_file";
/// Input of a work order: text of the calibration file.
pub const CALIBRATION_INPUT: &str = "calibration";

/// Inputs with the texts of a sensor file and of a calibration file, if any.
pub fn skin_inputs(sensor: String, calibration: Option<String>) -> BTreeMap<String, String> {
    let calibration = calibration.map(|text| (CALIBRATION_INPUT.to_owned(), text));
    [(SENSOR_INPUT.to_owned(), sensor)].into_iter().chain(calibration).collect()
}

/// The skin of a work order, calibrated if it has a calibration.
///
/// # Errors
/// The input that is wrong.
pub fn ordered_skin(order: &WorkOrder) -> Result<CalibratedSensor, Problem> {
    let text = order.inputs.get(SENSOR_INPUT).map_or("", String::as_str);
    let sensor = Sensor::from_toml(text).map_err(|error| invalid("inputs.sensor_file", error))?;
    match order.inputs.get(CALIBRATION_INPUT) {
        None => Ok(sensor.into()),
        Some(text) => Calibration::from_toml(text)
            .and_then(|calibration| calibration.apply(&sensor))
            .map_err(|error| invalid("inputs.calibration", error)),
    }
}
