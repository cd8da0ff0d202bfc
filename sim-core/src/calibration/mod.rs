//! A calibration: measured values of a skin's foam and layers, with the id that simulations carry.
//! Uses: `sensor`, `responses` (identity of meshes), serde and toml. Never: fitting, files (the
//! text is passed in), a clock.
//!
//! A compression test determines a, b and c of Eq. 1 (paper III-B), indentations determine the
//! moduli (III-A), measured trials determine the differences between positions. The first two are
//! independent, the third is valid on top of them, and [`Calibration::over`] joins them. The id is
//! `cal-` and the start of the sha256 over the file's content, so that an edit is detected.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::calibrated::CalibratedSensor;
use crate::digest::Digest;
use crate::responses::UnitResponses;
use crate::sensor::{Sensor, SensorError};
use crate::skin::{SkinCalibration, SkinValueError};

/// Why a calibration is invalid or cannot be applied.
#[derive(Debug, thiserror::Error, PartialEq)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum CalibrationError {
    /// The text is not TOML, or has a key or a type that a calibration does not have.
    #[error("{0}")]
    Syntax(String),
    #[error("{key} = {value}: {limit}")]
    Value { key: String, value: String, limit: String },
    /// `found`: `none` if the file has no id.
    #[error("id = {found}: the content's id is {needed}; calibrate again, do not edit")]
    Id { found: String, needed: String },
    #[error("sensor = {found}: the calibration is of another sensor than {needed}")]
    OtherSensor { found: String, needed: String },
    /// The moduli were fitted on another mesh: point loads make them depend on it.
    #[error("foam.mesh = {found}: the moduli are of another mesh than {needed}")]
    OtherMesh { found: String, needed: String },
    #[error("calibrated sensor: {0}")]
    Sensor(#[from] SensorError),
}

/// A fitted number with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fitted {
    /// Estimate, in the unit of the field.
    pub value: f64,
    /// Lower end of the interval.
    pub low_95: f64,
    /// Upper end of the interval.
    pub high_95: f64,
}

/// Difference of a model from measurements, absolute and relative to their variation.
///
/// The paper states "a normalized root-mean-square error (RMSE) of 24.1%" for the displacement
/// (III-A) and "a normalized RMSE of 28.3%" for the voltages (III-C); its main text does not define
/// the normalisation. Both usual definitions are stated. For voltages the first agrees with the
/// rest of the paper: it is the square root of the FVU of Eq. 2, and 28.3 % is an FVU of 0.08,
/// where Fig. 7 has medians of about 0.1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accuracy {
    /// Root mean square of model minus measurement, in the measurement's unit (mm or V).
    pub rmse: f64,
    /// The same over the standard deviation of the measurements.
    pub nrmse_by_sd: f64,
    /// The same over the range (largest minus smallest) of the measurements.
    pub nrmse_by_range: f64,
    /// Number of values compared.
    pub values: usize,
}

/// Coefficients of Eq. 1 from a compression test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PiezoCalibration {
    /// sha256 of the measurements' file.
    pub data_sha256: String,
    /// Number of rows in the file.
    pub rows: usize,
    /// Smallest and largest compression measured, mm; the law is extrapolated outside.
    pub compression_mm: [f64; 2],
    /// Residual standard deviation of ln(resistance).
    pub residual_sd_ln: f64,
    /// Coefficient a of Eq. 1, ohm.
    pub a_ohm: Fitted,
    /// b, 1/mm.
    pub b_per_mm: Fitted,
    /// c, ohm; absent if the test ends before the resistance levels off: the value of the sensor
    /// file remains.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub c_ohm: Option<Fitted>,
}

/// Moduli from single-point indentations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoamCalibration {
    /// sha256 of the measurements' file.
    pub data_sha256: String,
    /// Number of rows in the file.
    pub rows: usize,
    /// Id of the mesh on which the moduli were fitted, see [`mesh_id`].
    pub mesh: String,
    /// Largest force measured, N.
    pub force_n: f64,
    /// Young's modulus of the bottom fabric, MPa.
    pub bottom_mpa: f64,
    /// Young's modulus of the top fabric, MPa.
    pub top_mpa: f64,
    /// Young's modulus of the foam, MPa.
    pub foam_mpa: Fitted,
    /// Factor on the moduli of both fabrics in the sensor file; absent if the data do not identify
    /// it: the values of the sensor file remain.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fabric_factor: Option<Fitted>,
    /// Displacement of the model compared with the measured one, mm.
    pub displacement: Accuracy,
}

/// Calibrated values of a skin. They replace those of the sensor file; other values remain.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Name of the sensor of the sensor file used.
    pub sensor: String,
    /// From a compression test; absent if none was used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub piezo: Option<PiezoCalibration>,
    /// From indentations; absent if none were used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub foam: Option<FoamCalibration>,
    /// Voltages of single contacts under this calibration compared with measured ones, V.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltage: Option<Accuracy>,
    /// From measured trials: fields of one skin, on top of the parts above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skin: Option<SkinCalibration>,
}

/// Id of everything that moduli depend on in addition to the measurements: lattice, layers,
/// element, solver. It is the start of the unit responses' key with every modulus set to 1 MPa.
///
/// # Errors
/// `SensorError` if the sensor is invalid with these moduli.
pub fn mesh_id(sensor: &Sensor) -> Result<String, SensorError> {
    let mut file = sensor.file.clone();
    for layer in [&mut file.layers.bottom, &mut file.layers.foam, &mut file.layers.top] {
        layer.youngs_mpa = 1.0;
    }
    Ok(hex::encode(&UnitResponses::key(&Sensor::new(file)?)[..8]))
}

impl Calibration {
    /// Parses and checks a calibration file's text.
    ///
    /// # Errors
    /// `Syntax` if the text is not a calibration file; `Value` if a value is outside its limits;
    /// `Id` if the id is not that of the content.
    pub fn from_toml(text: &str) -> Result<Self, CalibrationError> {
        let syntax = |e: toml::de::Error| CalibrationError::Syntax(e.to_string());
        let mut table: toml::Table = toml::from_str(text).map_err(syntax)?;
        let id = table.remove("id");
        let calibration: Self = table.try_into().map_err(syntax)?;
        calibration.check()?;
        let found = id.as_ref().and_then(toml::Value::as_str).unwrap_or("none").to_owned();
        let needed = calibration.id()?;
        if found != needed {
            return Err(CalibrationError::Id { found, needed });
        }
        Ok(calibration)
    }

    /// Returns the file's text; [`Self::from_toml`] restores the same calibration from it.
    ///
    /// # Errors
    /// `CalibrationError::Syntax` if the content cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String, CalibrationError> {
        Ok(format!("id = \"{}\"\n{}", self.id()?, self.content()?))
    }

    /// Returns the id: `cal-` and the start of the sha256 over the content.
    ///
    /// # Errors
    /// `CalibrationError::Syntax` if the content cannot be written as TOML.
    pub fn id(&self) -> Result<String, CalibrationError> {
        let mut digest = Digest::new("calibration 1");
        digest.word(&self.content()?);
        Ok(format!("cal-{}", hex::encode(&digest.finish()[..8])))
    }

    /// Returns this calibration, completed with the moduli and Eq. 1 of an earlier one where it has
    /// none. The accuracy of the voltages belongs to a combination: it is dropped if a part is
    /// added. The skin of the earlier calibration is dropped: it was fitted with other values. This
    /// calibration's skin is assumed to be fitted with the earlier values that are joined here.
    ///
    /// # Errors
    /// `CalibrationError::OtherSensor` if the two are of different sensors.
    pub fn over(mut self, earlier: &Self) -> Result<Self, CalibrationError> {
        if earlier.sensor != self.sensor {
            let (found, needed) = (earlier.sensor.clone(), self.sensor);
            return Err(CalibrationError::OtherSensor { found, needed });
        }
        let adds = (self.piezo.is_none() && earlier.piezo.is_some())
            || (self.foam.is_none() && earlier.foam.is_some());
        if adds {
            self.voltage = None;
        }
        self.piezo = self.piezo.or_else(|| earlier.piezo.clone());
        self.foam = self.foam.or_else(|| earlier.foam.clone());
        Ok(self)
    }

    /// Returns the sensor with the calibrated values in place of the nominal ones, and this calibration's
    /// id.
    ///
    /// # Errors
    /// `OtherSensor` or `OtherMesh` if the calibration is of another sensor or mesh; `Sensor` or
    /// `Value` if the result is invalid.
    pub fn apply(&self, sensor: &Sensor) -> Result<CalibratedSensor, CalibrationError> {
        let mut file = sensor.file.clone();
        if self.sensor != file.name {
            let (found, needed) = (self.sensor.clone(), file.name);
            return Err(CalibrationError::OtherSensor { found, needed });
        }
        if let Some(piezo) = &self.piezo {
            file.piezo.a_ohm = piezo.a_ohm.value;
            file.piezo.b_per_mm = piezo.b_per_mm.value;
            file.piezo.c_ohm = piezo.c_ohm.map_or(file.piezo.c_ohm, |c| c.value);
        }
        if let Some(foam) = &self.foam {
            let needed = mesh_id(sensor)?;
            if foam.mesh != needed {
                return Err(CalibrationError::OtherMesh { found: foam.mesh.clone(), needed });
            }
            file.layers.bottom.youngs_mpa = foam.bottom_mpa;
            file.layers.foam.youngs_mpa = foam.foam_mpa.value;
            file.layers.top.youngs_mpa = foam.top_mpa;
        }
        let calibrated = Sensor::new(file)?;
        if let Some(skin) = &self.skin {
            skin.check_for(&calibrated)?;
        }
        Ok(CalibratedSensor::new(calibrated, self.id()?, self.skin.clone().map(Arc::new)))
    }

    fn content(&self) -> Result<String, CalibrationError> {
        toml::to_string(self).map_err(|e| CalibrationError::Syntax(e.to_string()))
    }

    fn check(&self) -> Result<(), CalibrationError> {
        if self.piezo.is_none() && self.foam.is_none() && self.skin.is_none() {
            return Err(bad("piezo, foam, skin", "none", "a calibration holds at least one"));
        }
        self.skin.as_ref().map_or(Ok(()), SkinCalibration::check)?;
        if let Some(p) = &self.piezo {
            fitted("piezo.a_ohm", &p.a_ohm)?;
            fitted("piezo.b_per_mm", &p.b_per_mm)?;
            p.c_ohm.as_ref().map_or(Ok(()), |c| fitted("piezo.c_ohm", c))?;
        }
        if let Some(f) = &self.foam {
            fitted("foam.foam_mpa", &f.foam_mpa)?;
            f.fabric_factor.as_ref().map_or(Ok(()), |x| fitted("foam.fabric_factor", x))?;
            for (key, mpa) in [("foam.bottom_mpa", f.bottom_mpa), ("foam.top_mpa", f.top_mpa)] {
                if !(mpa > 0.0 && mpa.is_finite()) {
                    return Err(bad(key, mpa, "must be a positive number"));
                }
            }
        }
        Ok(())
    }
}

fn bad(key: &str, value: impl ToString, limit: &str) -> CalibrationError {
    CalibrationError::Value { key: key.into(), value: value.to_string(), limit: limit.into() }
}

impl From<SkinValueError> for CalibrationError {
    fn from(SkinValueError { key, value, limit }: SkinValueError) -> Self {
        Self::Value { key: format!("skin.{key}"), value, limit }
    }
}

fn fitted(key: &str, f: &Fitted) -> Result<(), CalibrationError> {
    let ordered = 0.0 < f.low_95 && f.low_95 <= f.value && f.value <= f.high_95;
    if ordered && f.high_95.is_finite() {
        return Ok(());
    }
    let found = format!("{} ({} to {})", f.value, f.low_95, f.high_95);
    Err(bad(key, found, "must be positive, within its interval"))
}
