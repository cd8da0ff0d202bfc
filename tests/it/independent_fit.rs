//! The fit of Eq. 1 and Student's t against scipy. Without Python and scipy the test reports that it was
//! left out; with `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::process::Command;

use palpate::calibrate::{piezo, regression};
use sim_core::calibration::Fitted;

use crate::support::{self, sensor, succeeded};

#[derive(serde::Deserialize)]
struct Scipy {
    /// exp of estimate, lower and upper end, for a, b, c.
    fitted: [[f64; 3]; 3],
    /// Degrees of freedom and Student's t at 97.5 %.
    t_95: Vec<(usize, f64)>,
}

#[test]
fn scipy_finds_the_same_numbers_and_intervals() {
    let Some(python) = support::python("scipy.optimize") else { return };
    let root = env!("CARGO_MANIFEST_DIR");
    let table = format!("{root}/examples/calibration/compression.csv");
    let script = format!("{root}/tests/it/independent/curve_fit.py");
    let output = Command::new(&python).args([&script, &table]).output().unwrap();
    let scipy: Scipy = serde_json::from_str(&succeeded(&output)).unwrap();
    let text = std::fs::read_to_string(&table).unwrap();
    let paper = sensor().file.piezo;
    let ours = piezo::calibrate("compression.csv", &text, &paper).unwrap().calibration;
    let c_ohm = ours.c_ohm.expect("the example holds c");
    for (fitted, theirs) in [ours.a_ohm, ours.b_per_mm, c_ohm].iter().zip(scipy.fitted) {
        let Fitted { value, low_95, high_95 } = *fitted;
        for (ours, theirs) in [value, low_95, high_95].into_iter().zip(theirs) {
            assert!((ours / theirs - 1.0).abs() < 1e-5, "{fitted:?}, scipy {theirs}");
        }
    }
    assert!(!scipy.t_95.is_empty());
    for (freedom, theirs) in scipy.t_95 {
        let ours = regression::t_95(freedom);
        assert!((ours / theirs - 1.0).abs() < 1e-8, "{freedom}: {ours}, scipy {theirs}");
    }
}
