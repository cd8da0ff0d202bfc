//! What a run leaves behind, as plain values: trials, attempts, tares, reference presses, touch-offs.
//! PURE. Uses: `ids`. Never: the rig, the store, the clock.
//!
//! Skin coordinates (from the skin's corner) are used for contacts, machine coordinates for poses.
//! What was not measured is absent, never zero: a zero is a measurement.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ids::TrialKey;

/// Where the stage and the slot stand, machine coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Pose {
    /// Stage, mm.
    pub x_mm: f64,
    /// Stage, mm.
    pub y_mm: f64,
    /// Stage, downward, mm.
    pub z_mm: f64,
    /// Spread of the arms, mm.
    pub radius_mm: f64,
}

/// One attached tip in one trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmReading {
    /// 1 to 6.
    pub arm: u8,
    /// Centre of the tip on the skin, mm.
    pub x_mm: f64,
    /// Centre of the tip on the skin, mm.
    pub y_mm: f64,
    /// Force over the tare, N; what the cell said, not clipped at zero.
    pub force_n: f64,
    /// Raw output of the cell, V.
    pub cell_v: f64,
    /// Output at the tare before this configuration, V.
    pub tare_v: f64,
}

/// A contact that was placed by hand, at its nominal force (Real-Random, paper II-C).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlacedContact {
    /// Centre on the skin, mm.
    pub x_mm: f64,
    /// Centre on the skin, mm.
    pub y_mm: f64,
    /// Nominal force of the weight, N.
    pub force_n: f64,
}

/// One raw frame of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// Counter of the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Scale of the counts, V.
    pub volts_per_count: f32,
    /// Raw counts, injection-major.
    pub counts: Vec<i16>,
}

/// How good the frames of a trial are, in numbers; absent where it was not looked at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameQuality {
    /// Channels that sat at the converter's end in any frame.
    pub saturated_channels: Option<u32>,
    /// Channels with one and the same count in this trial and those before it.
    pub stuck_channels: Option<u32>,
    /// Channels without a value.
    pub missing_channels: Option<u32>,
    /// Largest magnitude of an injection's sum in any frame, V; zero up to noise.
    pub injection_sum_v: Option<f64>,
    /// Packets that the stream lost or garbled while the frames were taken.
    pub dropped_packets: Option<u32>,
}

/// What may be wrong with a trial that was kept.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Flag {
    /// Forces still changed when the longest settling time was over.
    Unsettled,
    /// A voltage channel sat at the converter's end.
    SaturatedChannels,
    /// An injection's values do not sum to zero within noise.
    InjectionSum,
    /// Frames were lost between the raw frames of this trial.
    DroppedFrames,
    /// The measured depth is off its target by more than the tolerance.
    DepthMissed,
    /// An attached cell weighed nothing where its tip must press.
    StillCell,
    /// The cells weigh a load that the skin does not feel.
    SilentSkin,
}

impl Flag {
    /// The flag as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unsettled => "unsettled",
            Self::SaturatedChannels => "saturated_channels",
            Self::InjectionSum => "injection_sum",
            Self::DroppedFrames => "dropped_frames",
            Self::DepthMissed => "depth_missed",
            Self::StillCell => "still_cell",
            Self::SilentSkin => "silent_skin",
        }
    }
}

/// An accepted attempt: stored exactly once per key.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialRecord {
    /// Its place in the run.
    pub key: TrialKey,
    /// Which try this was, from 1.
    pub attempt: u32,
    /// Attached tips, or placed contacts.
    pub tips: u8,
    /// Depth of the step, mm; absent when weights were placed by hand.
    pub depth_mm: Option<f64>,
    /// Where the stage was sent; absent when weights were placed by hand.
    pub target: Option<Pose>,
    /// Where it measured itself to be.
    pub reached: Option<Pose>,
    /// The attached tips; empty when weights were placed by hand.
    pub arms: Vec<ArmReading>,
    /// Nominal contacts placed by hand; empty in Real-Hex.
    pub placed: Vec<PlacedContact>,
    /// Who placed them.
    pub placed_by: Option<String>,
    /// Raw frames, at least one.
    pub frames: Vec<FrameRecord>,
    /// How good they are.
    pub quality: FrameQuality,
    /// What may be wrong with it.
    pub flags: Vec<Flag>,
    /// Time between the end of motion and the measurement, process ms.
    pub settle_ms: f64,
    /// Largest force seen on a cell while approaching and settling, minus the measured one, N.
    pub overshoot_n: Option<f64>,
    /// Wall time at the start of its motion.
    pub started_at: Timestamp,
    /// Wall time of its last frame.
    pub measured_at: Timestamp,
}

impl TrialRecord {
    /// Mean of the raw frames, V.
    pub fn mean_voltages_v(&self) -> Vec<f32> {
        let n = self.frames.len() as f64;
        let channels = self.frames.first().map_or(0, |f| f.counts.len());
        (0..channels)
            .map(|i| {
                let sum: f64 = self
                    .frames
                    .iter()
                    .map(|f| f64::from(f.counts[i]) * f64::from(f.volts_per_count))
                    .sum();
                (sum / n) as f32
            })
            .collect()
    }
}

/// A try that did not become a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct AttemptRecord {
    /// What was tried.
    pub key: TrialKey,
    /// Which try, from 1.
    pub attempt: u32,
    /// Why it failed, in words that name device, value and limit.
    pub reason: String,
    /// Wall time of the failure.
    pub at: Timestamp,
}

/// Zeros of the cells before a configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct TareRecord {
    /// The configuration it belongs to.
    pub configuration: u32,
    /// Attached arms and their outputs without load, V.
    pub volts: Vec<(u8, f64)>,
    /// Samples averaged.
    pub samples: u32,
    /// Wall time.
    pub at: Timestamp,
}

/// A press on the same place at stated intervals, to tell drift from position.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceRecord {
    /// Position in the plan of the configuration that follows.
    pub before_configuration: u32,
    /// Where and how deep.
    pub reached: Pose,
    /// Depth, mm.
    pub depth_mm: f64,
    /// The attached tips.
    pub arms: Vec<ArmReading>,
    /// Its frame.
    pub frame: FrameRecord,
    /// Wall time.
    pub at: Timestamp,
}

/// The surface as a touch-off found it after a tip change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TouchOffRecord {
    /// Attached tips.
    pub tips: u8,
    /// Machine z of the surface: median over places and arms, mm.
    pub surface_z_mm: f64,
    /// Each attached arm's first contact below that median, mm: positive = a shorter tip.
    pub tip_offset_mm: Vec<(u8, f64)>,
    /// Places touched and each arm's z there, mm (skin x, skin y, arm, z).
    pub touches: Vec<(f64, f64, u8, f64)>,
    /// Wall time.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
}
