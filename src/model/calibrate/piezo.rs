//! Eq. 1 fitted to a compression test: `f(x) = a / (exp(b x) - 1) + c` (paper III-B, Fig. 5).
//! PURE. Uses: `table`, `regression`, sim-core's piezo. Never: another law than sim-core's.
//!
//! Columns `displacement_mm` (compression of the specimen) and `resistance_ohm`. Resistance spans
//! four decades and its scatter is relative, not absolute: ln(resistance) is therefore fitted, with
//! the same weight for each row; in ohms the first 0.1 mm would determine the result. Unknowns are
//! ln a, ln b, ln c, which keeps all three above 0.

use std::convert::Infallible;

use sim_core::calibration::{Fitted, PiezoCalibration};
use sim_core::piezo::LEAST_COMPRESSION_MM;
use sim_core::sensor::Piezo;

use super::CalibrateError;
use super::regression::{self, Prediction, Regression, RegressionError};
use super::table::{self, Column};
use crate::digest::sha256_hex;
use crate::record::Label;

const PIEZO_COLUMNS: [Column; 2] = [
    Column::number(
        "displacement_mm",
        [LEAST_COMPRESSION_MM, 100.0],
        "must be a number from 0.0001 to 100 (untouched foam has no finite resistance)",
    ),
    Column::number(
        "resistance_ohm",
        [f64::MIN_POSITIVE, f64::MAX],
        "must be a finite number above 0",
    ),
];

/// Names of the unknowns, in their order.
const UNKNOWNS: [&str; 3] = ["a_ohm", "b_per_mm", "c_ohm"];
/// Largest ratio of an interval's ends: with a larger one the data do not determine the number.
const ENDS_RATIO_MAX: f64 = 100.0;

/// A row of a compression test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compression {
    /// Compression of the specimen, mm.
    pub displacement_mm: f64,
    /// Resistance through its thickness, ohm.
    pub resistance_ohm: f64,
}

/// Eq. 1 fitted to a compression test.
#[derive(Debug, Clone, PartialEq)]
pub struct PiezoFit {
    /// Result for the calibration file.
    pub calibration: PiezoCalibration,
    /// Origin of the table.
    pub label: Label,
    /// Rows of the table.
    pub rows: Vec<Compression>,
    regression: Regression<3>,
}

/// The fitted curve at a compression, ohm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Value of the curve, ohm.
    pub middle_ohm: f64,
    /// 95 % confidence interval of the curve, ohm.
    pub curve_ohm: [f64; 2],
    /// 95 % interval of a further measurement, ohm.
    pub measurement_ohm: [f64; 2],
}

impl PiezoFit {
    /// Curve and bands at a compression, mm.
    pub fn band(&self, displacement_mm: f64) -> Band {
        let (ln, slope) = ln_resistance(&self.regression.parameters, displacement_mm);
        let (sd, t) = (self.regression.prediction_sd(&slope), self.regression.t_95());
        let around = |half: f64| [(ln - half).exp(), (ln + half).exp()];
        Band {
            middle_ohm: ln.exp(),
            curve_ohm: around(t * sd),
            measurement_ohm: around(t * sd.hypot(self.regression.residual_sd)),
        }
    }
}

/// Reads a compression test and fits Eq. 1 to it. If the test does not determine c, the value of
/// the sensor remains: with the paper's numbers c is half of the resistance at 4 mm, the whole
/// thickness.
///
/// # Errors
/// `CalibrateError::Measurements` if a cell is invalid, or the data do not determine a or b.
pub fn calibrate(file: &str, text: &str, sensor: &Piezo) -> Result<PiezoFit, CalibrateError> {
    let rows = read(file, text)?;
    let failed = |error: RegressionError<Infallible>| match error {
        RegressionError::Undetermined { parameter } => undetermined(file, parameter),
        other => CalibrateError::undetermined(file, other),
    };
    let (regression, holds_c) = match fit(&rows) {
        Ok(free) if is_narrow(&free.exponential(2)) => (free, true),
        Err(error @ RegressionError::TooFew { .. }) => return Err(failed(error)),
        _ => (fit_with_c(&rows, sensor.c_ohm.ln()).map_err(failed)?, false),
    };
    let [a_ohm, b_per_mm, c_ohm] = [0, 1, 2].map(|k| regression.exponential(k));
    for (parameter, fitted) in [a_ohm, b_per_mm].iter().enumerate() {
        if !is_narrow(fitted) {
            return Err(undetermined(file, parameter));
        }
    }
    let compressions = rows.iter().map(|r| r.displacement_mm);
    let calibration = PiezoCalibration {
        data_sha256: sha256_hex(text),
        rows: rows.len(),
        compression_mm: [
            compressions.clone().fold(f64::MAX, f64::min),
            compressions.fold(f64::MIN, f64::max),
        ],
        residual_sd_ln: regression.residual_sd,
        a_ohm,
        b_per_mm,
        c_ohm: holds_c.then_some(c_ohm),
    };
    Ok(PiezoFit { calibration, label: table::label(text), rows, regression })
}

/// Whether an interval determines its number; an interval that is not a number does not.
fn is_narrow(fitted: &Fitted) -> bool {
    fitted.high_95 / fitted.low_95 <= ENDS_RATIO_MAX
}

fn read(file: &str, text: &str) -> Result<Vec<Compression>, CalibrateError> {
    let rows = table::read(file, text, &PIEZO_COLUMNS).map_err(CalibrateError::Measurements)?;
    rows.iter()
        .map(|row| match row.values[..] {
            [Some(displacement_mm), Some(resistance_ohm)] => {
                Ok(Compression { displacement_mm, resistance_ohm })
            }
            _ => Err(CalibrateError::undetermined(
                file,
                "the header needs displacement_mm and resistance_ohm",
            )),
        })
        .collect()
}

fn undetermined(file: &str, parameter: usize) -> CalibrateError {
    let name = UNKNOWNS[parameter];
    let words = format!("the data do not determine {name}: cover a wider range of compression");
    CalibrateError::undetermined(file, words)
}

/// Fits ln a, ln b, ln c to ln(resistance).
fn fit(rows: &[Compression]) -> Result<Regression<3>, RegressionError<Infallible>> {
    regression::fit(&observed(rows), start(rows), |ln| Ok(prediction(rows, ln, |slope| slope)))
}

/// Fits ln a and ln b with c fixed; c has no variance.
fn fit_with_c(
    rows: &[Compression],
    ln_c: f64,
) -> Result<Regression<3>, RegressionError<Infallible>> {
    let [ln_a, ln_b, _] = start(rows);
    let two = regression::fit(&observed(rows), [ln_a, ln_b], |&[a, b]| {
        Ok(prediction(rows, &[a, b, ln_c], |[by_a, by_b, _]| [by_a, by_b]))
    })?;
    let ([a, b], [ca, cb]) = (two.parameters, two.covariance);
    Ok(Regression {
        parameters: [a, b, ln_c],
        covariance: [[ca[0], ca[1], 0.0], [cb[0], cb[1], 0.0], [0.0; 3]],
        slopes: two.slopes.iter().map(|s| [s[0], s[1], 0.0]).collect(),
        residuals: two.residuals,
        residual_sd: two.residual_sd,
        freedom: two.freedom,
    })
}

fn observed(rows: &[Compression]) -> Vec<f64> {
    rows.iter().map(|r| r.resistance_ohm.ln()).collect()
}

fn prediction<const P: usize>(
    rows: &[Compression],
    ln: &[f64; 3],
    keep: impl Fn([f64; 3]) -> [f64; P],
) -> Prediction<P> {
    let law = |r: &Compression| {
        let (value, slope) = ln_resistance(ln, r.displacement_mm);
        (value, keep(slope))
    };
    let (values, slopes) = rows.iter().map(law).unzip();
    Prediction { values, slopes }
}

/// ln f(x) of Eq. 1 and its derivatives by ln a, ln b, ln c.
fn ln_resistance(ln: &[f64; 3], displacement_mm: f64) -> (f64, [f64; 3]) {
    let [a, b, c] = ln.map(f64::exp);
    let bx = b * displacement_mm;
    let (foam, f) = (a / bx.exp_m1(), a / bx.exp_m1() + c);
    // d ln(foam) / d ln b = -bx exp(bx) / (exp(bx) - 1)
    let by_b = bx / (-bx).exp_m1();
    (f.ln(), [foam / f, foam * by_b / f, c / f])
}

/// Start values: the best of many b, with a and c by linear least squares on relative residuals.
fn start(rows: &[Compression]) -> [f64; 3] {
    let deepest = rows.iter().map(|r| r.displacement_mm).fold(f64::MIN_POSITIVE, f64::max);
    let least = rows.iter().map(|r| r.resistance_ohm).fold(f64::MAX, f64::min);
    let mut best = (f64::MAX, [0.0; 3]);
    // b x at the deepest row from 0.1 (nearly 1/x) to 50 (a step at the surface).
    for n in 0..=40 {
        let b = 0.1 * 500f64.powf(f64::from(n) / 40.0) / deepest;
        // Residuals a p + c q - 1 with p = 1 / (R (exp(bx) - 1)), q = 1 / R.
        let (mut pp, mut pq, mut qq, mut p1, mut q1) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for r in rows {
            let q = least / r.resistance_ohm;
            let p = q / (b * r.displacement_mm).exp_m1();
            (pp, pq, qq) = (pp + p * p, pq + p * q, qq + q * q);
            (p1, q1) = (p1 + p, q1 + q);
        }
        let det = pp * qq - pq * pq;
        let c = ((pp * q1 - pq * p1) / det).clamp(0.01, 1.0);
        let a = ((p1 - c * pq) / pp).max(f64::MIN_POSITIVE);
        let ln = [(a * least).ln(), b.ln(), (c * least).ln()];
        let misfit: f64 = rows
            .iter()
            .map(|r| (r.resistance_ohm.ln() - ln_resistance(&ln, r.displacement_mm).0).powi(2))
            .sum();
        if misfit < best.0 {
            best = (misfit, ln);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use sim_core::piezo::resistance_ohm;
    use sim_core::sensor::ResistancePer;

    use super::*;

    /// The paper's numbers (Fig. 5).
    const PAPER: Piezo =
        Piezo { a_ohm: 2.2e8, b_per_mm: 1.4, c_ohm: 6.5e5, resistance_per: ResistancePer::Node };

    /// A foam that levels off within its thickness, so that every test determines c.
    const LEVELS_OFF: Piezo = Piezo { b_per_mm: 2.0, c_ohm: 5e6, ..PAPER };

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        let (u, v): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    fn test_of(piezo: &Piezo, rows: usize, sd_ln: f64, seed: u64) -> String {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut text = String::from("displacement_mm,resistance_ohm\n");
        for n in 1..=rows {
            let x = 4.0 * n as f64 / rows as f64;
            let ohm = resistance_ohm(piezo, x) * (sd_ln * normal(&mut rng)).exp();
            text += &format!("{x},{ohm}\n");
        }
        text
    }

    fn truth_in(fit: &PiezoFit, piezo: &Piezo) -> [bool; 3] {
        let c = &fit.calibration;
        let c_ohm = c.c_ohm.expect("c is held");
        [(c.a_ohm, piezo.a_ohm), (c.b_per_mm, piezo.b_per_mm), (c_ohm, piezo.c_ohm)]
            .map(|(f, truth)| (f.low_95..=f.high_95).contains(&truth))
    }

    #[test]
    fn without_noise_the_papers_numbers_come_back() {
        for piezo in [
            PAPER,
            Piezo { a_ohm: 3e5, b_per_mm: 0.6, c_ohm: 20.0, ..PAPER },
            Piezo { a_ohm: 5e9, b_per_mm: 4.0, c_ohm: 1e6, ..PAPER },
        ] {
            let fit = calibrate("t.csv", &test_of(&piezo, 40, 0.0, 0), &PAPER).unwrap().calibration;
            assert!((fit.a_ohm.value / piezo.a_ohm - 1.0).abs() < 1e-9, "{fit:?}");
            assert!((fit.b_per_mm.value / piezo.b_per_mm - 1.0).abs() < 1e-9, "{fit:?}");
            let c_ohm = fit.c_ohm.expect("c is held");
            assert!((c_ohm.value / piezo.c_ohm - 1.0).abs() < 1e-7, "{fit:?}");
            assert!(fit.residual_sd_ln < 1e-9);
        }
    }

    #[test]
    fn the_intervals_hold_the_truth_95_times_in_100() {
        let (mut held, runs) = ([0usize; 3], 1000);
        for seed in 0..runs {
            let fit = calibrate("t.csv", &test_of(&LEVELS_OFF, 20, 0.1, seed), &PAPER).unwrap();
            for (held, inside) in held.iter_mut().zip(truth_in(&fit, &LEVELS_OFF)) {
                *held += usize::from(inside);
            }
        }
        // A binomial of 1000 at 0.95 has sd 6.9: four of them either side.
        assert!(held.iter().all(|h| (922..=978).contains(h)), "{held:?} of {runs}");
    }

    #[test]
    fn the_band_holds_further_measurements_95_times_in_100() {
        let fit = calibrate("t.csv", &test_of(&PAPER, 300, 0.1, 1), &PAPER).unwrap();
        let more = read("t.csv", &test_of(&PAPER, 2000, 0.1, 2)).unwrap();
        let inside = more.iter().filter(|r| {
            let [low, high] = fit.band(r.displacement_mm).measurement_ohm;
            (low..=high).contains(&r.resistance_ohm)
        });
        let share = inside.count() as f64 / 2000.0;
        assert!((0.92..=0.98).contains(&share), "{share}");
        let band = fit.band(1.0);
        assert!(band.measurement_ohm[0] < band.curve_ohm[0]);
        assert!(band.curve_ohm[0] < band.middle_ohm && band.middle_ohm < band.curve_ohm[1]);
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let ln = [2.2e8f64.ln(), 1.4f64.ln(), 6.5e5f64.ln()];
        for x in [0.01, 0.5, 2.0, 5.0] {
            let (_, slope) = ln_resistance(&ln, x);
            for k in 0..3 {
                let moved = |d: f64| {
                    let mut ln = ln;
                    ln[k] += d;
                    ln_resistance(&ln, x).0
                };
                let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((slope[k] - difference).abs() < 1e-8, "{x} {k}");
            }
        }
    }

    #[test]
    fn a_c_that_the_test_does_not_reach_is_kept_and_the_others_are_found() {
        // Up to 1.5 mm c is a hundredth of the resistance, and the scatter a tenth.
        let text: Vec<String> =
            test_of(&PAPER, 80, 0.1, 7).lines().take(31).map(str::to_owned).collect();
        let fit = calibrate("t.csv", &text.join("\n"), &PAPER).unwrap();
        assert_eq!(fit.calibration.c_ohm, None);
        assert!((fit.regression.parameters[2].exp() / PAPER.c_ohm - 1.0).abs() < 1e-12);
        let held = |f: &Fitted, truth: f64| (f.low_95..=f.high_95).contains(&truth);
        assert!(held(&fit.calibration.a_ohm, PAPER.a_ohm), "{:?}", fit.calibration);
        assert!(held(&fit.calibration.b_per_mm, PAPER.b_per_mm), "{:?}", fit.calibration);
    }

    #[test]
    fn rows_at_one_compression_say_which_number_they_lack() {
        let rows: Vec<String> =
            (1..=9).map(|n| format!("1,{}e7", 7.0 + 0.1 * f64::from(n))).collect();
        let text = format!("displacement_mm,resistance_ohm\n{}\n", rows.join("\n"));
        let error = calibrate("one.csv", &text, &PAPER).unwrap_err().to_string();
        let words =
            "one.csv: the data do not determine b_per_mm: cover a wider range of compression";
        assert_eq!(error, words);
    }

    #[test]
    fn wrong_rows_and_too_few_are_named() {
        let error = |text: &str| calibrate("t.csv", text, &PAPER).unwrap_err().to_string();
        assert_eq!(
            error("displacement_mm,resistance_ohm\n0,1e12\n1,-5\n"),
            "t.csv: line 2, displacement_mm = 0: must be a number from 0.0001 to 100 (untouched foam \
             has no finite resistance)\n\
             t.csv: line 3, resistance_ohm = -5: must be a finite number above 0"
        );
        assert!(error("displacement_mm,resistance_ohm\n1,inf\n").contains("resistance_ohm = inf"));
        assert_eq!(
            error("displacement_mm\n1\n"),
            "t.csv: the header needs displacement_mm and resistance_ohm"
        );
        let few = error("displacement_mm,resistance_ohm\n1,9e7\n2,2e7\n3,5e6\n");
        assert!(few.starts_with("t.csv: 3 rows are too few for 3 unknowns"), "{few}");
    }
}
