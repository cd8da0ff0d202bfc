//! A stored trial as the store returns it, and its contacts.
//! PURE. Uses: `record`, `core::facts`. Never: a statement.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::core::facts::{Label, RunKind};
use crate::ids::{RunUid, TrialId};
use crate::record::{ARMS, ArmReading, Flag, FrameQuality, PlacedContact, Pose, TrialScalars};

/// A contact of a trial: position, force and diameter of one tip on the skin.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Contact {
    /// x of the centre, skin coordinates, mm; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<f64>,
    /// y of the centre, skin coordinates, mm; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<f64>,
    /// Force, N; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Diameter, mm; absent if unknown.
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
    /// Returns x, y (mm) and force (N); `None` if one of them is unknown.
    pub fn pressed(&self) -> Option<[f64; 3]> {
        Some([self.x_mm?, self.y_mm?, self.force_n?])
    }
}

/// A stored trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialRow {
    /// Id of the trial.
    pub trial_id: TrialId,
    /// Id of its run.
    pub run: RunUid,
    /// Number of its run.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Origin of the trial.
    pub kind: RunKind,
    /// Origin of the data: measured, virtual or simulated.
    pub label: Label,
    /// Position of the configuration in the plan.
    pub configuration: u32,
    /// Position of the depth in the configuration.
    pub depth_index: u32,
    /// Number of the accepted attempt, from 1.
    pub attempt: u32,
    /// Depth, mm; absent if weights were placed manually.
    pub depth_mm: Option<f64>,
    /// Number of attached tips or placed contacts.
    pub tips: u8,
    /// Number of `contacts`.
    pub contact_count: u8,
    /// Largest raw force, N, also if it is below the deadband.
    pub max_force_n: Option<f64>,
    /// Contacts. Real-Hex: tips at or above the deadband of the run; otherwise: all placed contacts.
    pub contacts: Vec<Contact>,
    /// Raw forces of arms 1 to 6, N; null for an arm without a tip.
    #[schema(value_type = Vec<Option<f64>>, min_items = 6, max_items = 6)]
    pub forces_n: [Option<f64>; ARMS],
    /// Reading of each attached tip.
    pub arms: Vec<ArmReading>,
    /// Target pose; absent if no stage moved (placed weights, imports).
    pub target: Option<Pose>,
    /// Measured pose; absent if no stage moved.
    pub reached: Option<Pose>,
    /// Person who placed the weights; absent for the multi-point indenter.
    pub placed_by: Option<String>,
    /// Marks of possible faults.
    pub flags: Vec<Flag>,
    /// Quality of its frames.
    #[serde(flatten)]
    pub quality: FrameQuality,
    /// Process time between the end of motion and the measurement, ms.
    pub settle_ms: Option<f64>,
    /// Its other measured numbers, in the description of the API as fields of the trial.
    #[serde(flatten)]
    #[schema(inline)]
    pub scalars: TrialScalars,
    /// Number of raw frames in the mean; of an import as its file states, 0 if it does not.
    pub frame_count: u32,
    /// Wall time at which its motion started.
    pub started_at: Option<Timestamp>,
    /// Wall time of its last frame.
    pub measured_at: Option<Timestamp>,
    /// Part that the imported file states: `train`, `validation` or `test`; absent if it states none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imported_split: Option<String>,
    /// Tag that the imported file states, such as a tip or a place; absent if it states none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imported_tag: Option<String>,
    /// Mean of its frames, V, injection-major; absent if not requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages_v: Option<Vec<f32>>,
    /// Frame of its newest twin, V, injection-major; absent if not requested or not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_voltages_v: Option<Vec<f32>>,
    /// Simulation id of the model of its newest twin; absent without a twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sim_model: Option<String>,
    /// RMSE of its frame against its newest twin, V; absent without a twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rmse_v: Option<f64>,
    /// FVU of its frame by its newest twin (paper, Eq. 2); absent without a twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fvu: Option<f64>,
}

impl TrialRow {
    /// Returns measured z minus target z, mm; `None` if no stage moved.
    pub fn depth_error_mm(&self) -> Option<f64> {
        Some(self.reached?.z_mm - self.target?.z_mm)
    }
}

/// Which tips of Real-Hex are contacts, and their size.
#[derive(Debug, Clone, Copy)]
pub struct TipsAsContacts {
    /// Least force of a contact, N (paper, IV-A).
    pub deadband_n: f64,
    /// Diameter of a tip, mm, if it is known.
    pub diameter_mm: Option<f64>,
}

impl TipsAsContacts {
    /// The contacts of a trial.
    pub fn of(self, arms: &[ArmReading]) -> Vec<Contact> {
        let pressing = arms.iter().filter(|a| a.force_n >= self.deadband_n);
        let contact = |a: &ArmReading| Contact {
            x_mm: Some(a.x_mm),
            y_mm: Some(a.y_mm),
            force_n: Some(a.force_n),
            diameter_mm: self.diameter_mm,
        };
        pressing.map(contact).collect()
    }
}
