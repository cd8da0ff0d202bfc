//! A stored trial as callers get it, and its contacts.
//! Uses: `record`. Never: a statement.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::facts::{Label, RunKind};
use crate::ids::{RunUid, TrialId};
use crate::record::{ArmReading, Flag, FrameQuality, PlacedContact, Pose};

/// A place on the skin that was pressed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Contact {
    /// Centre on the skin, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<f64>,
    /// Centre on the skin, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<f64>,
    /// Force, N, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Diameter, mm, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter_mm: Option<f64>,
}

impl From<&PlacedContact> for Contact {
    fn from(p: &PlacedContact) -> Self {
        let (x_mm, y_mm, force_n) = (Some(p.x_mm), Some(p.y_mm), Some(p.force_n));
        Self { x_mm, y_mm, force_n, diameter_mm: None }
    }
}

impl Contact {
    /// Place and force (mm, mm, N), where all of them are known.
    pub fn pressed(&self) -> Option<[f64; 3]> {
        Some([self.x_mm?, self.y_mm?, self.force_n?])
    }
}

/// A stored trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialRow {
    /// Its id.
    pub trial_id: TrialId,
    /// Its run.
    pub run: RunUid,
    /// Its run's number for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Where it comes from.
    pub kind: RunKind,
    /// Whether a skin was touched.
    pub label: Label,
    /// Position of the configuration in the plan.
    pub configuration: u32,
    /// Position of the depth in the configuration.
    pub depth_index: u32,
    /// Which try it was, from 1.
    pub attempt: u32,
    /// Depth, mm; absent when weights were placed by hand.
    pub depth_mm: Option<f64>,
    /// Attached tips, or placed contacts.
    pub tips: u8,
    /// Number of `contacts`.
    pub contact_count: u8,
    /// Largest raw force, N, also when it lies under the deadband.
    pub max_force_n: Option<f64>,
    /// Real-Hex: the tips at or above the run's deadband. Real-Random: the placed weights.
    pub contacts: Vec<Contact>,
    /// Raw forces of arms 1 to 6, N; absent where no tip is attached.
    #[schema(value_type = Vec<Option<f64>>, min_items = 6, max_items = 6)]
    pub forces_n: [Option<f64>; 6],
    /// Every attached tip as it was read.
    pub arms: Vec<ArmReading>,
    /// Where the stage was sent.
    pub target: Option<Pose>,
    /// Where it measured itself to be.
    pub reached: Option<Pose>,
    /// Who placed the weights.
    pub placed_by: Option<String>,
    /// What may be wrong with it.
    pub flags: Vec<Flag>,
    /// How good its frames are.
    #[serde(flatten)]
    pub quality: FrameQuality,
    /// Time between the end of motion and the measurement, process ms.
    pub settle_ms: Option<f64>,
    /// Largest force while approaching and settling over the measured one, N.
    pub overshoot_n: Option<f64>,
    /// Raw frames kept.
    pub frame_count: u32,
    /// Start of its motion.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// Its last frame.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub measured_at: Option<Timestamp>,
    /// Mean of its frames, V, injection-major, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages_v: Option<Vec<f32>>,
    /// Its newest twin's frame, V, injection-major, where it was asked for and is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_voltages_v: Option<Vec<f32>>,
    /// Model of its newest twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_model: Option<String>,
    /// Root of the mean squared difference to its newest twin, V.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rmse_v: Option<f64>,
    /// Fraction of variance unexplained by its newest twin (paper, Eq. 2).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fvu: Option<f64>,
}

impl TrialRow {
    /// How far z was off its target, mm; absent for weights placed manually.
    pub fn depth_error_mm(&self) -> Option<f64> {
        Some(self.reached?.z_mm - self.target?.z_mm)
    }
}

/// The tips that press with at least the deadband: what Real-Hex calls contacts (paper IV-A).
pub fn tips_as_contacts(
    arms: &[ArmReading],
    deadband_n: f64,
    diameter_mm: Option<f64>,
) -> Vec<Contact> {
    let pressing = arms.iter().filter(|a| a.force_n >= deadband_n);
    let contact = |a: &ArmReading| Contact {
        x_mm: Some(a.x_mm),
        y_mm: Some(a.y_mm),
        force_n: Some(a.force_n),
        diameter_mm,
    };
    pressing.map(contact).collect()
}
