//! A sensor with the values of a calibration, and the skin that was fitted on top of them.
//! Uses: `sensor`, `skin`. Never: the file of a calibration (`calibration` applies it), a mesh.

use std::ops::Deref;
use std::sync::Arc;

use crate::sensor::Sensor;
use crate::skin::SkinCalibration;

/// A sensor, calibrated or not. It dereferences to the sensor, whose values are the calibrated
/// ones.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedSensor {
    sensor: Sensor,
    calibration: Option<String>,
    skin: Option<Arc<SkinCalibration>>,
}

impl CalibratedSensor {
    /// Adds the id of the calibration of a sensor's values, and the calibration of the individual
    /// skin.
    pub(crate) fn new(sensor: Sensor, id: String, skin: Option<Arc<SkinCalibration>>) -> Self {
        Self { sensor, calibration: Some(id), skin }
    }

    /// Id of the calibration that was applied to the file's values, if any.
    pub fn calibration(&self) -> Option<&str> {
        self.calibration.as_deref()
    }

    /// Calibration of the individual skin, if one was applied.
    pub fn skin(&self) -> Option<&SkinCalibration> {
        self.skin.as_deref()
    }

    /// Offset of each channel of the readout, V; zero if the offsets are unknown.
    pub fn offsets_v(&self) -> Vec<f64> {
        let channels = self.sensor.channels();
        let known = self.skin().filter(|skin| skin.offsets_mv.len() == channels);
        let of = |skin: &SkinCalibration| skin.offsets_mv.iter().map(|mv| 1e-3 * mv).collect();
        known.map_or_else(|| vec![0.0; channels], of)
    }

    /// Returns the sensor without the id and the skin; its values remain the calibrated ones.
    pub fn into_sensor(self) -> Sensor {
        self.sensor
    }
}

impl Deref for CalibratedSensor {
    type Target = Sensor;

    fn deref(&self) -> &Sensor {
        &self.sensor
    }
}

impl From<Sensor> for CalibratedSensor {
    fn from(sensor: Sensor) -> Self {
        Self { sensor, calibration: None, skin: None }
    }
}

impl From<&Sensor> for CalibratedSensor {
    fn from(sensor: &Sensor) -> Self {
        sensor.clone().into()
    }
}

impl From<&CalibratedSensor> for CalibratedSensor {
    fn from(sensor: &CalibratedSensor) -> Self {
        sensor.clone()
    }
}
