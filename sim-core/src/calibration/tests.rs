//! Calibration files: what is read back, what is refused, and what a sensor gets of them.
//! Uses: the file of the default sensor. Never: a fit.

use super::*;
use crate::inverse::skin::SkinPrior;
use crate::skin::{FvuSummary, SkinElectrodes, SkinEvidence, SkinField, SkinFields, SkinFoam};

fn sensor() -> Sensor {
    Sensor::from_toml(include_str!("../../../experiments/sensors/ert-28.toml")).unwrap()
}

fn about(value: f64) -> Fitted {
    Fitted { value, low_95: 0.9 * value, high_95: 1.1 * value }
}

fn piezo() -> Calibration {
    let piezo = PiezoCalibration {
        data_sha256: "00".into(),
        rows: 12,
        compression_mm: [0.05, 3.0],
        residual_sd_ln: 0.1,
        a_ohm: about(2.0e8),
        b_per_mm: about(1.5),
        c_ohm: Some(about(6.0e5)),
    };
    Calibration { sensor: "ert-28".into(), piezo: Some(piezo), ..Calibration::default() }
}

fn foam() -> Calibration {
    let foam = FoamCalibration {
        data_sha256: "11".into(),
        rows: 20,
        mesh: mesh_id(&sensor()).unwrap(),
        force_n: 40.0,
        bottom_mpa: 20.0,
        top_mpa: 20.0,
        foam_mpa: about(0.05),
        fabric_factor: None,
        displacement: Accuracy { rmse: 0.2, nrmse_by_sd: 0.25, nrmse_by_range: 0.07, values: 20 },
    };
    Calibration { sensor: "ert-28".into(), foam: Some(foam), ..Calibration::default() }
}

fn skin() -> Calibration {
    let field = |value: f64| SkinField {
        columns: 2,
        values: vec![value, 0.25, -0.125, 0.0],
        prior: SkinPrior::default().ln_a,
    };
    let sensor = sensor();
    let places = |axis: usize| sensor.electrodes_mm().iter().map(|e| e[axis] + 1.5).collect();
    let fvu = |median: f64| FvuSummary { median, mean: 2.0 * median };
    let skin = SkinCalibration {
        offsets_mv: vec![0.1; sensor.channels()],
        evidence: SkinEvidence {
            run: "0199".into(),
            label: "virtual".into(),
            data_sha256: "22".into(),
            model: "sim-0".into(),
            trials: 1200,
            held_out: 300,
            doubted: 3,
            noise_v: 1.2e-3,
            model_error: 0.05,
            before: fvu(0.126),
            after: fvu(0.019),
        },
        electrodes: SkinElectrodes {
            x_mm: places(0),
            y_mm: places(1),
            contact_ohm: vec![30.0; 28],
            lead_ohm: vec![500.0; 28],
        },
        fields: SkinFields {
            foam: SkinFoam { step_mm: 0.5, ln_slopes: vec![0.1, 0.0, -0.1] },
            ln_a: field(0.5),
            ln_b: field(0.1),
            ln_c: field(0.0),
            ln_compliance: field(0.05),
            ln_sheet_conductance: field(0.2),
            ln_sheet_anisotropy: 0.25,
        },
    };
    Calibration { sensor: "ert-28".into(), skin: Some(skin), ..Calibration::default() }
}

#[test]
fn a_file_is_read_back_as_the_same() {
    let all = skin().over(&foam().over(&piezo()).unwrap()).unwrap();
    let text = all.to_toml().unwrap();
    assert_eq!(Calibration::from_toml(&text).unwrap(), all);
}

#[test]
fn a_skin_rides_on_the_sensor_and_does_not_outlive_its_values() {
    let applied = skin().over(&piezo()).unwrap().apply(&sensor()).unwrap();
    assert_eq!(applied.skin(), skin().skin.as_ref());
    assert_eq!(applied.file.piezo.b_per_mm, 1.5);
    assert_eq!(CalibratedSensor::from(sensor()).skin(), None);
    assert_eq!(piezo().over(&skin()).unwrap().skin, None);
}

/// Error text of a skin after an invalid change.
fn refused(change: impl Fn(&mut SkinCalibration)) -> String {
    let mut wrong = skin();
    change(wrong.skin.as_mut().unwrap());
    let read = Calibration::from_toml(&wrong.to_toml().unwrap());
    let found = read.and_then(|calibration| calibration.apply(&sensor()).map(|_| ()));
    found.unwrap_err().to_string()
}

#[test]
fn wrong_values_of_a_skin_are_named() {
    let said = |change: &dyn Fn(&mut SkinCalibration), start: &str| {
        let words = refused(change);
        assert!(words.starts_with(start), "{words}");
    };
    said(&|s| s.fields.ln_a.columns = 3, "skin.fields.ln_a = 4 values in 3 columns: ");
    said(&|s| s.fields.ln_b.values[1] = f64::NAN, "skin.fields.ln_b = NaN: ");
    said(&|s| s.fields.ln_sheet_anisotropy = -1.1, "skin.fields.ln_sheet_anisotropy = -1.1: ");
    said(&|s| s.fields.foam.step_mm = 0.0, "skin.fields.foam.step_mm = 0: ");
    said(&|s| s.fields.foam.ln_slopes[2] = 50.0, "skin.fields.foam.ln_slopes = 50: ");
    said(&|s| s.electrodes.lead_ohm[4] = -1.0, "skin.electrodes.lead_ohm = -1: ");
    said(&|s| s.electrodes.contact_ohm[4] = 0.0, "skin.electrodes.contact_ohm = 0: ");
    said(&|s| s.electrodes.y_mm.truncate(27), "skin.electrodes.y_mm = 27 values: ");
    said(&|s| s.electrodes.x_mm[2] = 541.0, "skin.electrodes.x_mm = 541: ");
    said(&|s| s.offsets_mv.truncate(783), "skin.offsets_mv = 783 values: ");
}

#[test]
fn the_id_is_of_the_content_and_stays_what_it_is() {
    // Existing files contain it: a change of this number is a change of the format.
    assert_eq!(piezo().id().unwrap(), "cal-c5258dd7737cff82");
    assert_ne!(piezo().id().unwrap(), foam().id().unwrap());
    let mut isotropic = skin();
    isotropic.skin.as_mut().unwrap().fields.ln_sheet_anisotropy = 0.0;
    let text = isotropic.to_toml().unwrap();
    assert!(!text.contains("anisotropy") && Calibration::from_toml(&text).unwrap() == isotropic);
    let edited = piezo().to_toml().unwrap().replace("1.5", "1.6");
    assert!(matches!(Calibration::from_toml(&edited), Err(CalibrationError::Id { .. })));
}

#[test]
fn applied_to_its_sensor_it_replaces_what_it_knows_and_leaves_its_id() {
    let both = foam().over(&piezo()).unwrap();
    let applied = both.apply(&sensor()).unwrap();
    assert_eq!(applied.file.piezo.b_per_mm, 1.5);
    assert_eq!(applied.file.layers.foam.youngs_mpa, 0.05);
    assert_eq!(applied.file.circuit, sensor().file.circuit);
    assert_eq!(applied.calibration(), Some(both.id().unwrap().as_str()));
    assert_eq!(CalibratedSensor::from(sensor()).calibration(), None);
}

#[test]
fn another_sensor_and_another_mesh_are_refused() {
    let mut other = sensor().file;
    other.name = "mine".into();
    let other = Sensor::new(other).unwrap();
    assert!(matches!(piezo().apply(&other), Err(CalibrationError::OtherSensor { .. })));
    let mut thicker = sensor().file;
    thicker.layers.foam.elements = 4;
    let thicker = Sensor::new(thicker).unwrap();
    assert!(matches!(foam().apply(&thicker), Err(CalibrationError::OtherMesh { .. })));
    // Moduli are not part of the mesh id.
    let mut softer = sensor().file;
    softer.layers.foam.youngs_mpa = 0.06;
    assert!(foam().apply(&Sensor::new(softer).unwrap()).is_ok());
}

#[test]
fn the_accuracy_of_voltages_does_not_outlive_its_combination() {
    let mut with = piezo();
    with.voltage = foam().foam.map(|f| f.displacement);
    assert!(with.clone().over(&piezo()).unwrap().voltage.is_some());
    assert!(with.over(&foam()).unwrap().voltage.is_none());
}

#[test]
fn a_wrong_value_or_key_is_named() {
    let mut wrong = piezo();
    wrong.piezo.as_mut().unwrap().a_ohm.low_95 = -1.0;
    let error = Calibration::from_toml(&wrong.to_toml().unwrap()).unwrap_err().to_string();
    assert!(error.starts_with("piezo.a_ohm = 200000000 (-1 to"), "{error}");
    let none = Calibration { piezo: None, ..piezo() };
    assert!(Calibration::from_toml(&none.to_toml().unwrap()).is_err());
    let unknown = piezo().to_toml().unwrap().replace("rows", "rwos");
    let error = Calibration::from_toml(&unknown).unwrap_err().to_string();
    assert!(error.contains("rwos"), "{error}");
}
