//! What is scored on what, and what comes of it.
//! PURE. Uses: `evaluate::{score, voltages}`, `infer::answer`. Never: models, rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::anova::Moments;
use super::score::Scores;
use super::voltages::VoltageScores;
use crate::infer::answer::Reading;
use crate::problem::{Checks, Problem};
use crate::store::Contact;

/// Least force of a peak in the paper (V-B2), N.
fn threshold_n() -> f64 {
    crate::dataset::force_map::peaks::THRESHOLD_N
}

/// What is scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Scored {
    /// Voltages of a Transfer-Net (or the measured ones) against simulated ones (paper, Table III).
    Voltages,
    /// Contacts of `transfer` (where there is one) and `map`.
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

/// Which frame of a trial is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FramesRead {
    /// The mean of all of its frames.
    #[default]
    Mean,
    /// Its first frame alone.
    First,
}

/// A wish for an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// What is scored.
    pub scored: Scored,
    /// A dataset's name or id.
    pub dataset: String,
    /// `train`, `validation` or `test`; all rows without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Conditions on its rows that all hold, each `COLUMN__gt=VALUE`.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// A Transfer-Net's id or name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<String>,
    /// The id or name of a net that gives maps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// A Point-Net's id or name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// The calibration of the exact model; without, what serves, or else the sensor file's values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skin: Option<String>,
    /// Which frame of a trial is read.
    #[serde(default)]
    pub frames: FramesRead,
    /// Least force of a peak, N.
    #[serde(default = "threshold_n")]
    pub threshold_n: f64,
    /// Leave out contacts of `exact` whose place is known no better than this, mm (the root mean square
    /// of the standard deviations of x and y).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_sd_mm: Option<f64>,
    /// Only so many rows, evenly taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<u64>,
    /// Hand over what was read from so many of the first rows, maps included.
    #[serde(default)]
    pub examples: u64,
    /// Of the bootstrap.
    #[serde(default)]
    pub seed: u64,
}

/// Most readings with their maps that a report hands over.
pub const EXAMPLES_MAX: u64 = 16;

impl EvaluationRequest {
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of("request");
        let part = self.part.as_deref().unwrap_or("test");
        let parts = crate::dataset::split::Part::ALL.map(|part| part.name());
        checks.require(parts.contains(&part), "part", part, "must be train, validation or test");
        checks.within("threshold_n", self.threshold_n, 0.0, 1000.0);
        let needs = |key, there: bool, wanted: bool, checks: &mut Checks<'_>| {
            let limit =
                format!("must be named for {:?}, and only where it takes part", self.scored);
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

/// What came of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EvaluationReport {
    /// What was scored.
    pub scored: Scored,
    /// The dataset's id.
    pub dataset: String,
    /// Its part; none: all rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// Whether none of these rows can be one that its nets learned from.
    #[serde(default = "yes")]
    pub held_out: bool,
    /// Conditions on its rows.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Which frame of a trial was read.
    #[serde(default)]
    pub frames: FramesRead,
    /// `measured` or `virtual`, as the dataset's rows are labelled; `simulated` where no measured
    /// frame was read.
    pub label: String,
    /// Ids of the models that took part.
    pub models: Vec<String>,
    /// Id of the calibration behind the exact model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<String>,
    /// Rows that were scored.
    pub rows: u64,
    /// Least force of a peak, N.
    pub threshold_n: f64,
    /// Contacts whose place is known no better than this were left out, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_sd_mm: Option<f64>,
    /// Scores of contacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contacts: Option<Scores>,
    /// The score of a perfect map under the same rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub perfect: Option<Scores>,
    /// The map that the perfect score is of: `4x20`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Scores of voltages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages: Option<VoltageScores>,
    /// Sums over contacts, each a sample, for an analysis of variance of several reports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<BTreeMap<String, Moments>>,
    /// Time to an answer, ms, frames one by one: median, 99th percentile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<[f64; 2]>,
    /// What one should know before believing it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// What was read from the first rows, where it was asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub examples: Vec<Example>,
}

/// Reports from before this was looked at were of tests.
fn yes() -> bool {
    true
}

/// A row, and what was read from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Example {
    /// What pressed.
    pub truth: Vec<Contact>,
    /// What was read.
    pub reading: Reading,
}
