//! Fits the model to measurements: Eq. 1 to a compression test, moduli to indentations, a skin to
//! trials; compares voltages of single contacts. The results are sim-core's
//! `calibration::Calibration`.
//! PURE. Uses: sim-core, `problem`. Never: files (text in, text out), simulation in bulk.
//!
//! `text -> table -> (piezo | foam, by regression) -> Calibration`, `frames -> accuracy`, `plot`;
//! `trials -> skin -> judgement, Calibration`, `skin_plot`.

use sim_core::calibration::Accuracy;
use sim_core::responses::ResponsesError;
use sim_core::sensor::SensorError;

use self::judgement::Judgement;
use crate::problem::Problem;

pub mod table;
pub mod regression;
pub mod piezo;
pub mod foam;
pub mod frames;
pub mod plot;
pub mod judgement;
pub mod skin;
pub mod skin_plot;
#[cfg(test)]
pub mod paper;

/// Why measurements do not yield a calibration.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum CalibrateError {
    /// A measured value is invalid, or the measurements do not determine the model.
    #[error("{}", .0.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n"))]
    Measurements(Vec<Problem>),
    #[error("solving the skin's surface: {0}")]
    Surface(#[from] ResponsesError),
    #[error("fitting moduli: {0}")]
    Sensor(#[from] SensorError),
    #[error("{}", .0.refusal())]
    NoBetter(Judgement),
    #[error("drawing the plot: {0}")]
    Plot(String),
}

impl CalibrateError {
    /// Error if the measurements as a whole do not determine the model.
    fn undetermined(file: &str, words: impl std::fmt::Display) -> Self {
        Self::Measurements(vec![Problem::whole(file, words.to_string())])
    }
}

/// Difference of a model from measurements (same length, same unit). `None` for fewer than two
/// measurements or without variance: there is no normalisation.
pub fn accuracy(measured: &[f64], modelled: &[f64]) -> Option<Accuracy> {
    let n = measured.len() as f64;
    let mean = measured.iter().sum::<f64>() / n;
    let sd = (measured.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    let squares = measured.iter().zip(modelled).map(|(m, s)| (m - s).powi(2));
    let rmse = (squares.sum::<f64>() / n).sqrt();
    let (low, high) = measured.iter().fold((f64::MAX, f64::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    (sd > 0.0).then(|| Accuracy {
        rmse,
        nrmse_by_sd: rmse / sd,
        nrmse_by_range: rmse / (high - low),
        values: measured.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_squared_ratio_to_the_spread_is_the_fraction_of_variance_unexplained() {
        let (measured, modelled) = ([0.0, 1.0, 2.0, 5.0], [0.5, 1.0, 1.0, 5.5]);
        let a = accuracy(&measured, &modelled).unwrap();
        // Eq. 2, calculated manually: (0.25 + 0 + 1 + 0.25) / (4 + 1 + 0 + 9).
        assert!((a.nrmse_by_sd.powi(2) - 1.5 / 14.0).abs() < 1e-12);
        assert!((a.rmse - (1.5f64 / 4.0).sqrt()).abs() < 1e-12);
        assert!((a.nrmse_by_range - a.rmse / 5.0).abs() < 1e-12);
        assert_eq!(accuracy(&[1.0, 1.0], &[1.0, 2.0]), None);
        assert_eq!(accuracy(&[], &[]), None);
    }
}
