//! Request and report of an evaluation.
//! PURE. Uses: `evaluate::{score, voltages}`, `infer::answer`. Never: models, rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::anova::Moments;
use super::score::Scores;
use super::voltages::VoltageScores;
use crate::ids::{CalibrationId, DatasetId, ModelId};
use crate::infer::answer::Reading;
use crate::problem::{Checks, Problem};
use crate::store::Contact;

/// Default of the least force of a peak: that of the paper (V-B2), N.
fn threshold_n() -> f64 {
    crate::dataset::force_map::peaks::THRESHOLD_N
}

/// Method or values that are scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Scored {
    /// Voltages of a Transfer-Net (or the measured ones) compared with simulated ones (paper, Table
    /// III).
    Voltages,
    /// Contacts of `transfer` (if needed) and `map`.
    Paper,
    /// Contacts of `points`.
    Fast,
    /// Contacts fitted through the exact model of `skin`.
    Exact,
    /// Peaks of the one-step reconstruction with Tikhonov's regularisation.
    Tikhonov,
    /// Peaks of the one-step reconstruction with NOSER's.
    Noser,
}

impl Scored {
    /// The methods from a frame to contacts, with their names in commands.
    pub const METHODS: [(&'static str, Self); 5] = [
        ("paper", Self::Paper),
        ("fast", Self::Fast),
        ("exact", Self::Exact),
        ("tikhonov", Self::Tikhonov),
        ("noser", Self::Noser),
    ];
}

/// Frame of a trial that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FramesRead {
    /// The mean of all its frames.
    #[default]
    Mean,
    /// Its first frame only.
    First,
}

/// A request for an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// Method or values that are scored.
    pub scored: Scored,
    /// Name or id of a dataset.
    pub dataset: String,
    /// Part of the dataset: `train`, `validation` or `test`; all rows if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Conditions that a row must meet, each `COLUMN__gt=VALUE`.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Id or name of a Transfer-Net.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<String>,
    /// Id or name of a net with force maps as answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Id or name of a Point-Net.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// Id of the calibration of the exact model; if absent, the serving one, or the sensor file's
    /// values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skin: Option<CalibrationId>,
    /// Frame of a trial that is read: the mean, or the first.
    #[serde(default)]
    pub frames: FramesRead,
    /// Least force of a peak, N.
    #[serde(default = "threshold_n")]
    pub threshold_n: f64,
    /// Skip contacts of `exact` whose position has a larger standard deviation than this, mm (the
    /// root mean square of those of x and y).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_sd_mm: Option<f64>,
    /// Largest number of rows, taken evenly; all if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<u64>,
    /// Number of first rows whose readings are returned in the report, maps included.
    #[serde(default)]
    pub examples: u64,
    /// Seed of the bootstrap.
    #[serde(default)]
    pub seed: u64,
}

/// Largest number of readings with maps in a report.
pub const EXAMPLES_MAX: u64 = 16;

impl EvaluationRequest {
    /// Checks the values of the request.
    ///
    /// # Errors
    /// All problems: a value outside its limits, or a key that is missing or unused.
    pub fn check(&self) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of("request");
        let part = self.part.as_deref().unwrap_or("test");
        let parts = crate::dataset::split::Part::ALL.map(|part| part.name());
        checks.require(parts.contains(&part), "part", part, "must be train, validation or test");
        checks.within("threshold_n", self.threshold_n, 0.0, 1000.0);
        let needs = |key, there: bool, wanted: bool, checks: &mut Checks<'_>| {
            let limit = format!("must be set for {:?}, and only where it is used", self.scored);
            checks.require(there == wanted, key, if there { "named" } else { "none" }, &limit);
        };
        needs("map", self.map.is_some(), self.scored == Scored::Paper, &mut checks);
        if self.scored == Scored::Fast {
            needs("points", self.points.is_some(), true, &mut checks);
        }
        if let Some(limit_mm) = self.place_sd_mm {
            checks.within("place_sd_mm", limit_mm, 1.0, 1000.0);
            needs("place_sd_mm", true, self.scored == Scored::Exact, &mut checks);
        }
        checks.require(self.limit != Some(0), "limit", 0, "must be at least 1, or absent");
        let few = self.examples <= EXAMPLES_MAX;
        checks.require(few, "examples", self.examples, &format!("must be 0..{EXAMPLES_MAX}"));
        checks.done()
    }
}

/// Result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EvaluationReport {
    /// Method or values that were scored.
    pub scored: Scored,
    /// Id of the dataset.
    pub dataset: DatasetId,
    /// Part of the dataset; all rows if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Whether none of these rows can have been used to train the nets.
    #[serde(default = "yes")]
    pub held_out: bool,
    /// Conditions that the rows meet.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Frame of a trial that was read: the mean, or the first.
    #[serde(default)]
    pub frames: FramesRead,
    /// `measured` or `virtual`, as the dataset's rows are labelled; `simulated` if no measured
    /// frame was read.
    pub label: String,
    /// Ids of the models of the method.
    pub models: Vec<ModelId>,
    /// Id of the calibration of the exact model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationId>,
    /// Number of rows that were scored.
    pub rows: u64,
    /// Least force of a peak, N.
    pub threshold_n: f64,
    /// Contacts whose position has a larger standard deviation than this were skipped, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_sd_mm: Option<f64>,
    /// Scores of contacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contacts: Option<Scores>,
    /// The score of a perfect map under the same rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub perfect: Option<Scores>,
    /// The map of the perfect score, pixel and diameter in mm: `4x20`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Scores of voltages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages: Option<VoltageScores>,
    /// Sums over contacts, each a sample, for an analysis of variance over several reports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<BTreeMap<String, Moments>>,
    /// Time to an answer, ms, frames one by one: median, 99th percentile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<[f64; 2]>,
    /// Restrictions on the validity of the scores, as text.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Readings of the first rows, if requested.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub examples: Vec<Example>,
}

/// Older reports lack the field: they were all of test parts.
fn yes() -> bool {
    true
}

/// A row and its reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Example {
    /// True contacts.
    pub truth: Vec<Contact>,
    /// Answer of the method.
    pub reading: Reading,
}
