//! Difference of a skin's frames from those of its model, as fits use it.
//! PURE. Uses: `untouched`, `rehearsal`, sim-core's `inverse`. Never: an estimate (`errors` makes it).

use serde::{Deserialize, Serialize};
use sim_core::inverse::contacts::ErrorModel;

use super::rehearsal::Rehearsal;
use super::untouched::Drift;

/// Smallest number of known trials from which the model's error is estimated.
pub(super) const LEAST_KNOWN: usize = 60;

/// Difference of a skin's frames from those of its model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkinErrors {
    /// Standard deviation of a voltage's noise in one frame, V.
    pub(super) noise_sd_v: f64,
    /// What the offsets of the readout differ by from those that are subtracted.
    pub(super) drift: Drift,
    pub(super) model: ErrorModel,
    /// Factors on the part of the standard deviations that the model's error has: contacts imitate a part of
    /// it, which the fit cannot detect. Noise and offsets are measured; averaging lowers their part alone.
    pub(super) stretch: Stretch,
    /// What answers to known trials showed with all of these; absent with too few.
    pub(super) rehearsal: Option<Rehearsal>,
    /// Number of known trials from which the model's error was estimated; 0 if it was not.
    pub(super) learnt_from: usize,
}

impl SkinErrors {
    /// Number of voltages in a frame.
    pub fn channels(&self) -> usize {
        self.model.channels()
    }
}

/// Factors on the standard deviations by the model's error, from the errors of known contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Stretch {
    /// Factor of positions.
    pub place: f64,
    /// Factor of forces.
    pub force: f64,
}

/// Growth of a standard deviation if the part that the model's error has in its square is stretched by a factor.
pub(super) fn grown(by_model: f64, factor: f64) -> f64 {
    (1.0 + (factor * factor - 1.0) * by_model).sqrt()
}
