//! The answer of a method to a frame.
//! PURE. Never: a value that the method does not estimate (it is absent).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::store::Contact;

/// Square of the radius of a 95 % region of a position, in standard deviations: the quantile of chi-square
/// with two degrees of freedom.
const PLACE_95: f64 = 5.991;
/// Half the width of a 95 % interval of a force, in standard deviations.
const FORCE_95: f64 = 1.96;

/// An estimated contact.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct FoundContact {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// Force, N; absent if the model was trained without forces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Diameter in the map, mm; absent for methods without a map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter_mm: Option<f64>,
    /// Standard deviation of x, mm; only of `exact`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_sd_mm: Option<f64>,
    /// Standard deviation of y, mm; only of `exact`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_sd_mm: Option<f64>,
    /// Standard deviation of the force, N; only of `exact`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sd_n: Option<f64>,
    /// Probability of the contact according to the net, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub presence: Option<f64>,
}

impl FoundContact {
    /// Distance to a position, mm, as a part of the radius of the 95 % region in its direction: up to 1 inside;
    /// `None` without standard deviations.
    pub fn place_in_95(&self, x_mm: f64, y_mm: f64) -> Option<f64> {
        let (x_sd_mm, y_sd_mm) = self.x_sd_mm.zip(self.y_sd_mm)?;
        let square =
            ((self.x_mm - x_mm) / x_sd_mm).powi(2) + ((self.y_mm - y_mm) / y_sd_mm).powi(2);
        Some((square / PLACE_95).sqrt())
    }

    /// Difference from a force, N, as a part of half the 95 % interval: up to 1 inside; `None` without a standard
    /// deviation.
    pub fn force_in_95(&self, force_n: f64) -> Option<f64> {
        let (found_n, sd_n) = self.force_n.zip(self.force_sd_n)?;
        Some((found_n - force_n).abs() / (FORCE_95 * sd_n))
    }
}

impl From<&FoundContact> for Contact {
    fn from(found: &FoundContact) -> Self {
        Self {
            x_mm: Some(found.x_mm),
            y_mm: Some(found.y_mm),
            force_n: found.force_n,
            diameter_mm: found.diameter_mm,
        }
    }
}

/// Contacts that explain a frame, too.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Alternative {
    /// Probability of this explanation, 0.05 to 1.
    pub probability: f64,
    /// Its contacts, strongest first; empty if an untouched skin explains the frame.
    pub contacts: Vec<FoundContact>,
}

/// The answer of a method to one frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Reading {
    /// The contacts, strongest first.
    pub contacts: Vec<FoundContact>,
    /// Probability of these contacts among the explanations of the frame that the last search found, 0 to 1;
    /// only of `exact`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Other explanations with a probability of at least 0.05 at the last search, the most probable first, at
    /// most three; only of `exact`, whose contacts have the most probable number: one with another number may be more
    /// probable.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alternatives: Vec<Alternative>,
    /// Newtons per pixel, row by row; present if requested: the net's own map, or the contacts of
    /// `fast` and `exact`, drawn as the paper's Map 1 (160 x 160 pixels of 4 mm, discs of 20 mm).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_map_n: Option<Vec<f32>>,
    /// Side of the square that the map covers, mm, whose centre is that of the skin; present with the map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_map_mm: Option<f64>,
    /// Properties of the frame outside the trained range of the model, as text.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outside: Vec<String>,
    /// What limits the answer, as text.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Mean square of the fit's residual, in units of the assumed noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<f64>,
    /// Misfit beyond which a fit does not explain the frame; present with `misfit`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit_limit: Option<f64>,
    /// Number of averaged frames of a constant load; present for a followed stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averaged: Option<f64>,
    /// Whether contacts were searched again; present for a followed stream. If not, those of the
    /// previous frame were fitted to this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub searched: Option<bool>,
}
