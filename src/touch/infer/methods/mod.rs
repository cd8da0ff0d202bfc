//! The methods from a frame to contacts, one folder each, and what they have in common.
//! Uses: `infer::{answer, maps, registry, slot}`. Never: what serves (`pipeline`), HTTP.

pub mod paper;
pub mod fast;
pub mod exact;
pub mod one_step;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use self::exact::Tracked;
use super::answer::Reading;
use super::error::InferError;
use super::maps::MAP_1;
use super::registry::Model;
use super::slot::Slot;
use crate::dataset::force_map::ForceMapSpec;
use crate::ids::CalibrationId;
use crate::learn::task::Reads;

/// Method from frames to contacts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The paper's method: Transfer-Net, Recon-Net, peaks of the map (V-C).
    Paper,
    /// Candidates of Point-Net.
    Fast,
    /// Contacts fitted to the frame through the exact model.
    Exact,
}

/// A row of the list of methods.
struct Row {
    name: &'static str,
    slots: &'static [Slot],
    is_fit: bool,
}

impl Method {
    /// All methods, the best last.
    pub const ALL: [Self; 3] = [Self::Paper, Self::Fast, Self::Exact];

    /// The list of methods.
    fn row(self) -> Row {
        use Slot::{Map, Points, Skin, Transfer};
        match self {
            Self::Paper => Row { name: "paper", slots: &[Transfer, Map], is_fit: false },
            Self::Fast => Row { name: "fast", slots: &[Points], is_fit: false },
            Self::Exact => Row { name: "exact", slots: &[Points, Skin], is_fit: true },
        }
    }

    /// Name in commands and answers.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// The slots that it uses.
    pub fn slots(self) -> &'static [Slot] {
        self.row().slots
    }

    /// Whether contacts are fitted: an answer takes a tenth of a second instead of milliseconds.
    pub fn is_fit(self) -> bool {
        self.row().is_fit
    }
}

/// The exact model of a skin that a method uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UsedSkin<'a> {
    /// Id of the model in messages.
    pub id: &'a str,
    /// Id of its calibration, if any.
    pub calibration: Option<&'a CalibrationId>,
    /// Id of the run that it was calibrated to, if known.
    pub run: Option<&'a str>,
}

/// A method with its models, ready to read frames.
pub trait ReadyMethod: Send + Sync {
    /// Reads frames (V, one after the other), each the mean of `averaged` frames; keeps the
    /// method's own maps, if it has maps, only if `with_map`.
    ///
    /// # Errors
    /// `InferError` if a frame cannot be answered.
    fn read(
        &self,
        frames: &[f32],
        averaged: f64,
        with_map: bool,
    ) -> Result<Vec<Reading>, InferError>;

    /// Reads the next frame of a stream (V).
    ///
    /// # Errors
    /// `InferError` if the frame cannot be answered.
    fn follow(
        &self,
        frame: &[f32],
        with_map: bool,
        _tracked: &mut Tracked,
    ) -> Result<Reading, InferError> {
        Ok(self.read(frame, 1.0, with_map)?.into_iter().next().unwrap_or_default())
    }

    /// Its nets, in the order of use.
    fn nets(&self) -> Vec<&Model>;

    /// Id in answers: those of its nets, joined with `+`, if it does not state another.
    fn id(&self) -> String {
        let ids: Vec<&str> = self.nets().iter().map(|net| net.manifest.id.as_str()).collect();
        ids.join("+")
    }

    /// The exact model that it uses, if any.
    fn skin(&self) -> Option<UsedSkin<'_>> {
        None
    }

    /// Frames that it reads.
    fn reads(&self) -> Reads {
        Reads::Measured
    }

    /// Layout of its maps, or of the map in which its contacts are drawn.
    fn map(&self) -> ForceMapSpec {
        MAP_1
    }

    /// Width and height of the skin, mm.
    fn size_mm(&self) -> [f64; 2];
}
