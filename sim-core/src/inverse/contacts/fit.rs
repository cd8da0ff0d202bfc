//! What a fit of contacts is asked and what it answers.
//! Uses: `forward`'s contacts. Never: a computation.

use crate::batch::BatchError;
use crate::forward::{Contact, ContactError};

/// Why there is no fitter.
#[derive(Debug, thiserror::Error)]
pub enum FitterError {
    /// The error model is of frames of another length.
    #[error("contact fitter: the error model has {found} channels, the skin {needed}")]
    Channels {
        /// Channels of the error model.
        found: usize,
        /// Channels of the skin.
        needed: usize,
    },
    /// An option is outside its limits.
    #[error("contact fitter: {field} = {value}: {limit}")]
    Option {
        /// Its name.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        limit: &'static str,
    },
    /// The model refused a load of the tables.
    #[error("contact fitter: {0}")]
    Batch(#[from] BatchError),
    /// The eigenvalues did not converge.
    #[error("contact fitter: eigenvalues of the error model did not converge")]
    Eigenvalues,
}

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The frame has another length than the skin's.
    #[error("fitting contacts: a frame of {found} voltages, the skin has {needed}")]
    Length {
        /// Voltages found.
        found: usize,
        /// Voltages needed.
        needed: usize,
    },
    /// A voltage is no number.
    #[error("fitting contacts: voltage {channel} is not a finite number")]
    NotFinite {
        /// Its channel.
        channel: usize,
    },
    /// The number of frames is none.
    #[error("fitting contacts: frames = {frames} is not a finite number >= 1")]
    Frames {
        /// The number.
        frames: f64,
    },
    /// A proposal is not a contact on this skin.
    #[error("fitting contacts: proposal: {0}")]
    Contact(#[from] ContactError),
}

/// What is believed before a frame is seen, and how much is tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// Contacts at most.
    pub most_contacts: usize,
    /// Median of a contact's force before the frame is seen, N.
    pub force_median_n: f64,
    /// Standard deviation of its logarithm.
    pub force_ln_sd: f64,
    /// ln of the odds of a contact more.
    pub ln_odds: f64,
    /// Contacts are not closer than this, mm: a tip's diameter.
    pub least_distance_mm: f64,
    /// Hypotheses that are brought to the exact model's frames.
    pub finalists: usize,
    /// Steps of a descent on the exact model at most.
    pub iterations: usize,
    /// Decrease of chi-square that no longer matters.
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
    /// Frames that it is the mean of, >= 1.
    pub frames: f64,
}

/// A contact that somebody proposes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// The contact.
    pub contact: Contact,
    /// How sure it is, 0 to 1.
    pub weight: f64,
}

impl Proposal {
    /// Of a contact that was there.
    pub(super) fn sure(before: &FittedContact) -> Self {
        Self { contact: before.contact, weight: 1.0 }
    }
}

/// A contact that a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedContact {
    /// The contact.
    pub contact: Contact,
    /// Standard deviation of x, mm.
    pub x_sd_mm: f64,
    /// Standard deviation of y, mm.
    pub y_sd_mm: f64,
    /// Standard deviation of the force, N.
    pub force_sd_n: f64,
}

/// How a fit came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// By a search of all counts.
    Search,
    /// From the contacts before.
    Tracked,
}

/// What a search saw: what comes later is held against it, not against the frame before, since a mean
/// of more and more frames shows a wrong load little by little.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Frames that it read the mean of.
    pub frames: f64,
    /// [`Fit::inside_chi2`] of what it found.
    pub inside_chi2: f64,
    /// Standard deviation of the force of the contact known worst, as a share of that force.
    pub worst_share: f64,
}

/// The contacts of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// They, strongest first.
    pub contacts: Vec<FittedContact>,
    /// Misfit over the error model, all channels.
    pub chi2: f64,
    /// What chi-square is expected to be.
    pub degrees_of_freedom: f64,
    /// The part of it in the directions in which frames differ.
    pub inside_chi2: f64,
    /// -2 ln evidence up to a constant of the frame: a difference of 10 is odds of 150 to 1.
    pub score: f64,
    /// Score of the best hypothesis with another number of contacts, where one was fitted.
    pub rival_score: Option<f64>,
    /// Where it started.
    pub origin: Origin,
    /// What the search saw that found these contacts.
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
