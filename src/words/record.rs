//! Records of a run as plain values: trials, attempts, tares, the untouched skin, reference presses,
//! touch-offs.
//! PURE. Uses: `ids`. Never: the rig, the store, the clock.
//!
//! Contacts are in skin coordinates (from the corner of the skin), poses in machine coordinates. A
//! value that was not measured is absent, never zero: zero is a measurement.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::ids::{RunUid, TrialKey};

/// Number of arms of the indenter, attached or not (paper II-B).
pub const ARMS: usize = 6;
/// Largest number of contacts of a trial: one per arm.
pub const CONTACTS_MAX: usize = ARMS;

/// Disk space reserved for the log of the database in addition to the trials, bytes: the store
/// truncates it to this size.
pub const LOG_BYTES: u64 = 64 << 20;
/// Size of a stored trial in addition to its frames: its row, six readings, flags, keys, the fit of
/// its twin, bytes. Measured with the two constants below on 33,000 trials of four tips: 8.9 kB per
/// trial in total.
pub const TRIAL_BYTES: u64 = 800;
/// Size of the stored mean voltages, and of those of the simulated twin, in addition to their
/// values, bytes.
pub const VOLTAGES_BYTES: u64 = 145;
/// Size of a stored raw frame in addition to its counts, bytes.
pub const RAW_FRAME_BYTES: u64 = 250;

/// Position of stage and slot, machine coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Pose {
    /// Stage x, mm.
    pub x_mm: f64,
    /// Stage y, mm.
    pub y_mm: f64,
    /// Stage z, downward, mm.
    pub z_mm: f64,
    /// Radius of the tips, mm.
    pub radius_mm: f64,
}

/// Reading of one attached tip in one trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmReading {
    /// Number of the arm, 1 to 6.
    pub arm: u8,
    /// x of the tip's centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of the tip's centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Force after subtraction of the tare, N; not clipped at zero.
    pub force_n: f64,
    /// Raw output of the cell, V.
    pub cell_v: f64,
    /// Output at the tare before this configuration, V.
    pub tare_v: f64,
}

/// A contact placed manually, with its nominal force (Real-Random, paper II-C).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlacedContact {
    /// x of the centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of the centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Nominal force of the weight, N.
    pub force_n: f64,
}

/// One raw frame of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// Sequence number from the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Voltage of one count, V.
    pub volts_per_count: f32,
    /// Raw counts, injection-major.
    pub counts: Vec<i16>,
}

/// Quality counts of the frames of a trial; a count that was not determined is absent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FrameQuality {
    /// Number of channels saturated in any frame.
    pub saturated_channels: Option<u32>,
    /// Number of channels with the same count in this trial and those before it.
    pub stuck_channels: Option<u32>,
    /// Number of channels without a value.
    pub missing_channels: Option<u32>,
    /// Largest magnitude of an injection sum in any frame, V; zero up to noise.
    pub injection_sum_v: Option<f64>,
    /// Number of packets that were lost or garbled while the frames were taken.
    pub dropped_packets: Option<u32>,
}

/// Scalars measured in a trial, each a column of the table of trials; absent if not measured, as in
/// manual trials.
///
/// A new scalar is a field with its line in `SCALAR_COLUMNS`: the store writes, reads and checks it by name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TrialScalars {
    /// Largest force while approaching and settling minus the measured force, N.
    pub overshoot_n: Option<f64>,
}

/// Access to the field of a scalar.
type Field = fn(&mut TrialScalars) -> &mut Option<f64>;

impl TrialScalars {
    /// Name and field of each scalar, in the order in which they were added.
    const SCALAR_COLUMNS: &[(&'static str, Field)] = &[("overshoot_n", |s| &mut s.overshoot_n)];

    /// Returns the names of the columns with their values.
    pub fn columns(mut self) -> impl Iterator<Item = (&'static str, Option<f64>)> {
        Self::SCALAR_COLUMNS.iter().map(move |(name, field)| (*name, *field(&mut self)))
    }

    /// Returns the scalars for whose columns `value` returns the values.
    ///
    /// # Errors
    /// The first error of `value`.
    pub fn of_columns<E>(
        mut value: impl FnMut(&'static str) -> Result<Option<f64>, E>,
    ) -> Result<Self, E> {
        let mut scalars = Self::default();
        for (name, field) in Self::SCALAR_COLUMNS {
            *field(&mut scalars) = value(name)?;
        }
        Ok(scalars)
    }

    /// Returns scalars that are all present and have this value, for trials that nothing measured.
    pub fn all(value: f64) -> Self {
        let mut scalars = Self::default();
        for (_, field) in Self::SCALAR_COLUMNS {
            *field(&mut scalars) = Some(value);
        }
        scalars
    }
}

/// Origin of the data of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Label {
    /// Measured on a real rig.
    Measured,
    /// Measured on the virtual rig.
    Virtual,
    /// Computed by a model elsewhere, and imported.
    Simulated,
}

impl Label {
    /// Returns the label as it is stored and shown.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// Possible fault of a stored trial.
// The comments of the variants are shown to people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(EnumMessage, IntoStaticStr, VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Flag {
    /// The forces still changed when the longest settling time ended; in a manual trial the signal of the skin, then
    /// or while its frames were taken.
    Unsettled,
    /// A voltage channel was saturated.
    SaturatedChannels,
    /// An injection sum is not zero within noise.
    InjectionSum,
    /// Frames were lost between the raw frames of this trial.
    DroppedFrames,
    /// The measured depth differs from its target by more than the tolerance.
    DepthMissed,
    /// An attached cell measured no force where its tip must press.
    StillCell,
    /// The cells measure a load to which the skin does not respond.
    SilentSkin,
    /// It was stored although the skin felt a weight in another place.
    Doubted,
}

impl Flag {
    /// All flags.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// What the flag means, in one sentence.
    pub fn about(self) -> &'static str {
        self.get_documentation().unwrap_or_default()
    }

    /// Name of the flag, as stored and shown.
    pub fn as_str(self) -> &'static str {
        self.into()
    }
}

/// A trial: the accepted attempt, stored exactly once per key.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialRecord {
    /// Key of the trial in its run.
    pub key: TrialKey,
    /// Number of the attempt, from 1.
    pub attempt: u32,
    /// Number of attached tips or placed contacts.
    pub tips: u8,
    /// Depth of the step, mm; absent for manual trials.
    pub depth_mm: Option<f64>,
    /// Commanded pose; absent for manual trials.
    pub target: Option<Pose>,
    /// Measured pose; absent for manual trials.
    pub reached: Option<Pose>,
    /// Readings of the attached tips; empty for manual trials.
    pub arms: Vec<ArmReading>,
    /// Nominal contacts of a manual trial; empty in Real-Hex.
    pub placed: Vec<PlacedContact>,
    /// Name of the person who placed them; absent in Real-Hex.
    pub placed_by: Option<String>,
    /// Raw frames, at least one.
    pub frames: Vec<FrameRecord>,
    /// Quality counts of the frames.
    pub quality: FrameQuality,
    /// Possible faults of the trial.
    pub flags: Vec<Flag>,
    /// Time between the end of motion and the measurement, process ms.
    pub settle_ms: f64,
    /// Its other measured numbers.
    pub scalars: TrialScalars,
    /// Wall time at the start of the motion.
    pub started_at: Timestamp,
    /// Wall time of the last frame.
    pub measured_at: Timestamp,
}

impl TrialRecord {
    /// Mean of the raw frames, V.
    pub fn mean_voltages_v(&self) -> Vec<f32> {
        let n = self.frames.len() as f64;
        let channels = self.frames.first().map_or(0, |f| f.counts.len());
        let v = |f: &FrameRecord, i: usize| f64::from(f.counts[i]) * f64::from(f.volts_per_count);
        let sum_v = |i| self.frames.iter().map(|f| v(f, i)).sum::<f64>();
        (0..channels).map(|i| (sum_v(i) / n) as f32).collect()
    }
}

/// An attempt that did not become a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AttemptRecord {
    /// Key of the trial that was attempted.
    #[serde(flatten)]
    pub key: TrialKey,
    /// Number of the attempt, from 1.
    pub attempt: u32,
    /// Reason of the failure: device, value and limit.
    pub reason: String,
    /// Wall time of the failure.
    pub at: Timestamp,
}

/// The untouched skin: mean of frames that were taken while nothing touched it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Untouched {
    /// Mean voltages, V, injection-major.
    pub voltages_v: Vec<f32>,
    /// Wall time of the last frame.
    pub at: Timestamp,
    /// Number of frames.
    pub frames: usize,
    /// Run during which they were taken; null outside a run.
    pub run: Option<RunUid>,
    /// Wall time since which the stream was open and its device had not restarted; none if it is not known. For the
    /// store, not for clients.
    #[serde(skip)]
    pub stream_since: Option<Timestamp>,
}

/// Zeros of the cells, measured before a configuration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TareRecord {
    /// Index of the configuration.
    pub configuration: u32,
    /// Attached arms and their outputs without load, V.
    pub volts: Vec<(u8, f64)>,
    /// Number of samples averaged.
    pub samples: u32,
    /// Wall time of the tare.
    pub at: Timestamp,
}

/// Result of a press at a fixed position, repeated at fixed intervals to separate drift from
/// position.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceRecord {
    /// Index of the next configuration in the plan.
    pub before_configuration: u32,
    /// Pose that was measured after the motion.
    pub reached: Pose,
    /// Depth of the press, mm.
    pub depth_mm: f64,
    /// Readings of the attached tips.
    pub arms: Vec<ArmReading>,
    /// Frame taken under the held load.
    pub frame: FrameRecord,
    /// Wall time of the press.
    pub at: Timestamp,
}

/// A touch of one arm in a touch-off.
// Earlier versions stored the values alone, in this order, as an array: serde reads both forms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArmTouch {
    /// x of the tip's centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of the tip's centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Arm, from 1.
    pub arm: u8,
    /// Machine z at which the arm touched, mm.
    pub z_mm: f64,
}

/// Result of a touch-off after a tip change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TouchOffRecord {
    /// Number of attached tips.
    pub tips: u8,
    /// Machine z of the surface, mm: median over places and arms.
    pub surface_z_mm: f64,
    /// Height of each attached arm's first contact below that median, mm; positive for a shorter
    /// tip.
    pub tip_offset_mm: Vec<(u8, f64)>,
    /// All touches.
    pub touches: Vec<ArmTouch>,
    /// Wall time of the touch-off.
    pub at: Timestamp,
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_touch_of_an_earlier_version_is_an_array() {
        let touch = ArmTouch { x_mm: 270.0, y_mm: 297.3, arm: 2, z_mm: 41.4 };
        let read = |text: &str| serde_json::from_str::<ArmTouch>(text).unwrap();
        assert_eq!(read("[270.0,297.3,2,41.4]"), touch);
        assert_eq!(read(&serde_json::to_string(&touch).unwrap()), touch);
    }

    #[test]
    fn attempts_and_tares_are_shown_with_these_fields() {
        let (key, at) = (TrialKey { configuration: 3, depth_index: 1 }, Timestamp::UNIX_EPOCH);
        let attempt = AttemptRecord { key, attempt: 2, reason: "no answer".into(), at };
        let shown = json!({ "configuration": 3, "depth_index": 1, "attempt": 2,
            "reason": "no answer", "at": at });
        assert_eq!(json!(attempt), shown);
        let tare = TareRecord { configuration: 3, volts: vec![(2, 0.5)], samples: 40, at };
        let shown = json!({ "configuration": 3, "volts": [[2, 0.5]], "samples": 40, "at": at });
        assert_eq!(json!(tare), shown);
    }

    #[test]
    fn every_scalar_is_a_column_under_its_own_name() {
        let mut n = 0;
        let numbered = TrialScalars::of_columns(|_| {
            n += 1;
            Ok::<_, ()>(Some(f64::from(n)))
        });
        let fields = serde_json::to_value(numbered.unwrap()).unwrap();
        assert_eq!(
            fields.as_object().unwrap().len(),
            n as usize,
            "a line of SCALAR_COLUMNS is missing"
        );
        for (name, value) in numbered.unwrap().columns() {
            assert_eq!(fields[name].as_f64(), value, "{name}");
        }
    }
}
