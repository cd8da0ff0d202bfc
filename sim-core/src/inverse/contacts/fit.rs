//! Inputs and results of a fit of contacts.
//! Uses: `forward`'s contacts. Never: a computation.

use crate::batch::BatchError;
use crate::forward::{Contact, ContactError};

/// Why a fitter cannot be built.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum FitterError {
    /// The error model is of frames of another length.
    #[error("contact fitter: the error model has {found} channels, the skin {needed}")]
    Channels { found: usize, needed: usize },
    /// An option is outside its limits.
    #[error("contact fitter: {field} = {value}: {limit}")]
    Option { field: &'static str, value: f64, limit: &'static str },
    /// The model rejected a load of the tables.
    #[error("contact fitter: {0}")]
    Batch(#[from] BatchError),
    /// The eigenvalues did not converge.
    #[error("contact fitter: eigenvalues of the error model did not converge")]
    Eigenvalues,
}

/// Why a fit is impossible.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum FitError {
    /// The length of the frame is not that of the skin's frames.
    #[error("fitting contacts: a frame of {found} voltages, the skin has {needed}")]
    Length { found: usize, needed: usize },
    /// A voltage is not finite.
    #[error("fitting contacts: voltage {channel} is not a finite number")]
    NotFinite { channel: usize },
    /// The number of averaged frames is not a finite number >= 1.
    #[error("fitting contacts: frames = {frames} is not a finite number >= 1")]
    Frames { frames: f64 },
    /// The standard deviation of the offsets is not a finite number >= 0.
    #[error("fitting contacts: offset_sd_v = {offset_sd_v} is not a finite number >= 0")]
    Offset { offset_sd_v: f64 },
    /// The spectrum of the offsets is not one share >= 0 for each frequency.
    #[error(
        "fitting contacts: offset_spectrum has {found} values, {needed} finite numbers >= 0 needed"
    )]
    Spectrum {
        /// Number of values found.
        found: usize,
        /// Number of values needed, unless there are none.
        needed: usize,
    },
    /// A proposal or a contact to refine is not a contact on this skin.
    #[error("fitting contacts: proposal: {0}")]
    Contact(#[from] ContactError),
}

/// Prior of a fit and limits of its effort.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// Largest number of contacts, at most 12.
    pub most_contacts: usize,
    /// Median of a contact's force before the frame is seen, N.
    pub force_median_n: f64,
    /// Standard deviation of the logarithm of the force.
    pub force_ln_sd: f64,
    /// ln of the prior odds of one further contact.
    pub ln_odds: f64,
    /// Smallest distance between contacts, mm: a tip's diameter.
    pub least_distance_mm: f64,
    /// Number of hypotheses that are compared with frames of the exact model.
    pub finalists: usize,
    /// Largest number of steps of a descent on the exact model.
    pub iterations: usize,
    /// A descent ends when chi-square decreases by less than this.
    pub tolerance: f64,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            most_contacts: 6,
            force_median_n: 10.0,
            force_ln_sd: 0.8,
            ln_odds: -1.0,
            least_distance_mm: 20.0,
            finalists: 16,
            iterations: 12,
            tolerance: 0.01,
        }
    }
}

/// A measured frame.
#[derive(Debug, Clone, Copy)]
pub struct Observation<'a> {
    /// Voltages, V after gain, offsets taken off.
    pub frame_v: &'a [f64],
    /// Number of frames in the mean, >= 1.
    pub frames: f64,
    /// Standard deviation of the offset of a pair of electrodes that is left in the frame, V, >= 0:
    /// the same in every injection.
    pub offset_sd_v: f64,
    /// Variance of these offsets by their frequency around the electrodes, from 0 to half the number of pairs,
    /// relative to the mean over all waves ([`crate::stats::waves`]); empty if it is the same for all.
    pub offset_spectrum: &'a [f64],
}

/// A contact proposed by the caller, for example by a net.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// Proposed position and force.
    pub contact: Contact,
    /// Confidence, 0 to 1.
    pub weight: f64,
}

impl Proposal {
    /// Proposal of a contact of the previous fit.
    pub(super) fn sure(before: &FittedContact) -> Self {
        Self { contact: before.contact, weight: 1.0 }
    }
}

/// A contact found in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedContact {
    /// Fitted position and force.
    pub contact: Contact,
    /// Standard deviation of x, mm.
    pub x_sd_mm: f64,
    /// Standard deviation of y, mm.
    pub y_sd_mm: f64,
    /// Standard deviation of the force, N.
    pub force_sd_n: f64,
    /// Share of the variances of x, y and the force that the model's error has, 0 to 1: the rest is by noise and
    /// offsets.
    pub by_model: [f64; 3],
}

/// Other contacts that explain a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// Share of the evidence, 0 to 1.
    pub probability: f64,
    /// The contacts, strongest first.
    pub contacts: Vec<FittedContact>,
}

/// Origin of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// A search over all numbers of contacts.
    Search,
    /// The contacts of the previous frame.
    Tracked,
}

/// State at the search that found the contacts. Later fits are compared with it, not with the
/// previous frame, since a growing mean reveals a wrong load only gradually.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Number of frames in the mean that was searched.
    pub frames: f64,
    /// [`Fit::inside_chi2`] of the result.
    pub inside_chi2: f64,
    /// Standard deviation of the force of the most uncertain contact, as a share of that force.
    pub worst_share: f64,
}

/// The contacts of a frame, with their misfit and evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The contacts, strongest first.
    pub contacts: Vec<FittedContact>,
    /// Misfit over the error model, all channels.
    pub chi2: f64,
    /// Expected value of chi-square.
    pub degrees_of_freedom: f64,
    /// The part of it in the directions in which frames differ.
    pub inside_chi2: f64,
    /// -2 ln evidence up to a constant of the frame: a difference of 10 is odds of 150 to 1.
    pub score: f64,
    /// Share of the evidence of these contacts among all hypotheses of the last search, 0 to 1; absent
    /// without a search, and if the contacts of all its hypotheses collapsed.
    pub probability: Option<f64>,
    /// What else explains the frame by that search, the most probable first. One with another number of contacts may be
    /// more probable than these contacts, which have the most probable number.
    pub alternatives: Vec<Explanation>,
    /// Start of the fit: a search, or the previous contacts.
    pub origin: Origin,
    /// State at the search that found these contacts.
    pub found: Found,
    /// Runs of the exact model with its slopes, after the search.
    pub exact_runs: usize,
}

impl FitOptions {
    /// Whether a search can be done with them.
    pub(super) fn check(&self) -> Result<(), FitterError> {
        for (field, value, holds, limit) in [
            ("most_contacts", self.most_contacts as f64, self.most_contacts <= 12, "up to 12"),
            ("force_median_n", self.force_median_n, self.force_median_n > 0.0, "above 0"),
            ("force_ln_sd", self.force_ln_sd, self.force_ln_sd > 0.0, "above 0"),
            ("ln_odds", self.ln_odds, true, "a number"),
            ("least_distance_mm", self.least_distance_mm, true, "a number"),
            ("finalists", self.finalists as f64, self.finalists >= 1, "1 or more"),
            ("iterations", self.iterations as f64, self.iterations >= 1, "1 or more"),
            ("tolerance", self.tolerance, self.tolerance > 0.0, "above 0"),
        ] {
            if !(holds && value.is_finite()) {
                return Err(FitterError::Option { field, value, limit });
            }
        }
        Ok(())
    }
}
