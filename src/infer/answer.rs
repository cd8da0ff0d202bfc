//! What a method says of a frame.
//! PURE. Never: a value for what a method does not know (it is absent).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::store::Contact;

/// How frames become contacts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The paper's: Transfer-Net, Recon-Net, peaks of the map (V-C).
    Paper,
    /// Point-Net's candidates.
    Fast,
    /// Contacts fitted to the frame through the exact model.
    Exact,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Fast, Self::Exact];

    /// Its name in commands and answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Fast => "fast",
            Self::Exact => "exact",
        }
    }
}

/// A contact that was found.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct FoundContact {
    /// Place on the skin, mm.
    pub x_mm: f64,
    /// Place on the skin, mm.
    pub y_mm: f64,
    /// Force, N; absent where a model was trained on something else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Diameter, mm, as the map shows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter_mm: Option<f64>,
    /// Standard deviation of x, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_sd_mm: Option<f64>,
    /// Standard deviation of y, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_sd_mm: Option<f64>,
    /// Standard deviation of the force, N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_sd_n: Option<f64>,
    /// How sure the net is that it is there, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub presence: Option<f64>,
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

/// What a method says of one frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Reading {
    /// The contacts, strongest first.
    pub contacts: Vec<FoundContact>,
    /// Newtons per pixel, row by row, where a map is wished for: the net's own, or what `fast` and
    /// `exact` found, drawn as the paper's Map 1 (160 x 160 pixels of 4 mm, discs of 20 mm).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_map_n: Option<Vec<f32>>,
    /// What of the frame lies outside of what the model was trained on, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outside: Vec<String>,
    /// Mean square of what the fit leaves over, in units of the noise that it reckons with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<f64>,
    /// Frames of a load that is still whose mean was read, where a stream is followed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averaged: Option<f64>,
    /// Whether contacts were looked for anew, where a stream is followed; if not, those of the frame
    /// before were fitted to this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub searched: Option<bool>,
}
