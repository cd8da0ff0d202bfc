//! The sensor file of imported trials: a complete one of Palpate, or the basic values of another
//! skin.
//! PURE. Uses: sim-core's sensor file, `syntax`. Never: a value that the file does not state.

use serde::Deserialize;
use sim_core::sensor::Sensor;

use crate::problem::{Checks, Problem};
use crate::syntax::parse_toml;

/// Largest number of voltages per frame.
const CHANNELS_MAX: usize = 65_536;
/// Largest side of a skin, mm.
const SIDE_MAX_MM: f64 = 100_000.0;

/// Values of a sensor that datasets need.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ImportedSensor {
    /// Name of the sensor.
    pub name: String,
    /// Number of voltages per frame.
    pub channels: usize,
    /// Extent along x, mm.
    pub width_mm: f64,
    /// Extent along y, mm.
    pub height_mm: f64,
    /// Diameter of the tips, mm; absent if it varies or is unknown.
    pub tip_diameter_mm: Option<f64>,
}

impl ImportedSensor {
    /// Parses a sensor file: a complete one of Palpate (its trials get simulated twins), or any
    /// TOML with `name`, `channels`, `width_mm` and `height_mm`. `file` is its name in messages.
    ///
    /// # Errors
    /// The syntax error, or all invalid values.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        if let Ok(sensor) = Sensor::from_toml(text) {
            return Ok(Self {
                name: sensor.file.name.clone(),
                channels: sensor.channels(),
                width_mm: sensor.file.width_mm,
                height_mm: sensor.file.height_mm,
                tip_diameter_mm: Some(sensor.file.tip_diameter_mm),
            });
        }
        let sensor: Self = parse_toml(file, text)?;
        let mut checks = Checks::of(file);
        let channels = sensor.channels;
        let limit = format!("must be from 1 to {CHANNELS_MAX}");
        checks.require((1..=CHANNELS_MAX).contains(&channels), "channels", channels, &limit);
        for (key, mm) in [
            ("width_mm", sensor.width_mm),
            ("height_mm", sensor.height_mm),
            ("tip_diameter_mm", sensor.tip_diameter_mm.unwrap_or(1.0)),
        ] {
            let fits = mm.is_finite() && mm > 0.0 && mm <= SIDE_MAX_MM;
            checks.require(fits, key, mm, &format!("must be above 0 and at most {SIDE_MAX_MM}"));
        }
        checks.done().map(|()| sensor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_complete_sensor_file_and_four_values_are_both_sensors() {
        let own = include_str!("../../../../experiments/sensors/ert-28.toml");
        let own = ImportedSensor::from_toml("own", own).unwrap();
        assert_eq!((own.channels, own.width_mm, own.tip_diameter_mm), (784, 540.0, Some(20.0)));
        let text = "name = \"pad\"\nchannels = 208\nwidth_mm = 100\nheight_mm = 100\nlab = \"x\"\n";
        assert_eq!(ImportedSensor::from_toml("pad", text).unwrap().channels, 208);
        let text = "name = \"pad\"\nchannels = 0\nwidth_mm = -1\nheight_mm = 100\n";
        let problems = ImportedSensor::from_toml("pad.toml", text).unwrap_err();
        let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
        assert_eq!(keys, ["channels", "width_mm"]);
    }
}
