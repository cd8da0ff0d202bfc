//! Request and report of an evaluation.
//! PURE. Uses: `evaluate::{score, reliability, voltages}`, `infer::{answer, methods, slot}`. Never: models, rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::Schema;
use utoipa::{PartialSchema, ToSchema};

use super::anova::Moments;
use super::distances::Distances;
use super::quantities::QuantityScores;
use super::reliability::Reliability;
use super::score::Scores;
use super::voltages::VoltageScores;
use crate::dataset::split::Part;
use crate::ids::{CalibrationId, DatasetId, ModelId};
use crate::infer::answer::Reading;
use crate::infer::methods::{Method, names};
use crate::infer::slot::Slot;
use crate::problem::{Checks, Problem};
use crate::store::{Contact, Label};

/// Method or values that are scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "&'static str")]
pub enum Scored {
    /// Voltages of a Transfer-Net (or the measured ones) compared with simulated ones (paper, Table
    /// III).
    Voltages,
    /// A quantity that a net answers: a position, pattern, count or force.
    Quantity,
    /// Contacts of a method.
    Method(Method),
}

impl Scored {
    /// All that can be scored.
    pub fn all() -> impl Iterator<Item = Self> {
        [Self::Voltages, Self::Quantity]
            .into_iter()
            .chain(Method::ALL.into_iter().map(Self::Method))
    }

    /// Name in requests and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Voltages => "voltages",
            Self::Quantity => "quantity",
            Self::Method(method) => method.name(),
        }
    }

    /// The slots of the models that it uses.
    pub fn slots(self) -> &'static [Slot] {
        match self {
            Self::Voltages => &[Slot::Transfer],
            Self::Quantity => &[],
            Self::Method(method) => method.slots(),
        }
    }

    /// Description in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Voltages => {
                "voltages of a Transfer-Net, or the measured ones, against the twins (Table III)"
            }
            Self::Quantity => "a position, pattern, count or force that a net answers for a frame",
            Self::Method(method) => method.about(),
        }
    }

    /// Name of the dataset on which the paper scores it; `None` if it does not.
    pub fn usual_dataset(self) -> Option<&'static str> {
        match self {
            Self::Voltages => Some("r2s-transfer"),
            Self::Quantity => None,
            Self::Method(_) => Some("real-unseen"),
        }
    }

    /// Whether its scores describe the net in a slot. A fit only starts from a net's proposals.
    pub fn rates(self, slot: Slot) -> bool {
        self.slots().contains(&slot) && !self.is_fit()
    }

    /// The slots whose model a request must name.
    pub fn named_slots(self) -> &'static [Slot] {
        match self {
            Self::Voltages | Self::Quantity => &[],
            Self::Method(method) => method.named_slots(),
        }
    }

    /// Whether it fits contacts and states the standard deviation of each.
    pub fn is_fit(self) -> bool {
        matches!(self, Self::Method(method) if method.is_fit())
    }
}

impl From<Method> for Scored {
    fn from(method: Method) -> Self {
        Self::Method(method)
    }
}

/// The name is not of a method, of voltages or of a quantity.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "scored = {name}: must be one of {}",
    Scored::all().map(Scored::name).collect::<Vec<_>>().join(", "),
    name = .0,
)]
pub struct UnknownScored(String);

impl TryFrom<String> for Scored {
    type Error = UnknownScored;

    fn try_from(name: String) -> Result<Self, UnknownScored> {
        Self::all().find(|scored| scored.name() == name).ok_or(UnknownScored(name))
    }
}

impl From<Scored> for &'static str {
    fn from(scored: Scored) -> Self {
        scored.name()
    }
}

impl PartialSchema for Scored {
    fn schema() -> RefOr<Schema> {
        names("Method or values that are scored.", Self::all().map(Self::name).collect())
    }
}

impl ToSchema for Scored {}

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

/// Offsets of the readout that are taken off a frame before contacts are fitted to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OffsetsRead {
    /// Those of the untouched skin before the trial, where it was measured; elsewhere those of the
    /// calibration.
    #[default]
    Untouched,
    /// Those of the calibration.
    Calibration,
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
    /// Id, start of the id, or name of a Transfer-Net.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer: Option<String>,
    /// Id, start of the id, or name of a net with force maps as answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Id, start of the id, or name of a Point-Net.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<String>,
    /// Id, start of the id, or name of a net that answers a quantity; only for `quantity`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub net: Option<String>,
    /// Id of the calibration of the exact model; if absent, the serving one, or the sensor file's
    /// values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skin: Option<CalibrationId>,
    /// Frame of a trial that is read: the mean, or the first.
    #[serde(default)]
    pub frames: FramesRead,
    /// Offsets that `exact` takes off a frame: those of the untouched skin before the trial, or of the
    /// calibration.
    #[serde(default)]
    pub offsets: OffsetsRead,
    /// Least force of a peak, N; if absent, the paper's 5 N, or for a map of another square than the paper's an
    /// eighth of the largest force in the training of its net, if that is less.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold_n: Option<f64>,
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
    /// The same request for a net, in place of the Transfer-Net, the net of a quantity or the net with force maps.
    pub fn of_net(&self, net: &ModelId) -> Self {
        let (id, request) = (Some(net.to_string()), self.clone());
        match self.scored {
            Scored::Voltages => Self { transfer: id, ..request },
            Scored::Quantity => Self { net: id, ..request },
            Scored::Method(_) => Self { map: id, ..request },
        }
    }

    /// Checks the values of the request.
    ///
    /// # Errors
    /// All problems: a value outside its limits, or a key that is missing or unused.
    pub fn check(&self) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of("request");
        let part = self.part.as_deref().unwrap_or("test");
        let is_part = Part::named(part).is_some();
        checks.require(is_part, "part", part, "must be train, validation or test");
        if let Some(threshold_n) = self.threshold_n {
            checks.within("threshold_n", threshold_n, 0.0..=1000.0);
        }
        let scored = self.scored.name();
        for (slot, is_set) in [
            (Slot::Transfer, self.transfer.is_some()),
            (Slot::Map, self.map.is_some()),
            (Slot::Points, self.points.is_some()),
            (Slot::Skin, self.skin.is_some()),
        ] {
            let used = self.scored.slots().contains(&slot);
            let unused = format!("must be absent for {scored}, which does not use it");
            checks.require(used || !is_set, slot.name(), "named", &unused);
            let missing = self.scored.named_slots().contains(&slot) && !is_set;
            checks.require(!missing, slot.name(), "none", &format!("must be set for {scored}"));
        }
        let is_quantity = self.scored == Scored::Quantity;
        let limit = "must be set for quantity, and only for it";
        let net = self.net.as_deref().unwrap_or("none");
        checks.require(is_quantity == self.net.is_some(), "net", net, limit);
        if let Some(limit_mm) = self.place_sd_mm {
            checks.within("place_sd_mm", limit_mm, 1.0..=1000.0);
            let unused =
                format!("must be absent for {scored}, which states no standard deviations");
            checks.require(self.scored.is_fit(), "place_sd_mm", limit_mm, &unused);
        }
        checks.require(self.limit != Some(0), "limit", 0, "must be at least 1, or absent");
        let few = self.examples <= EXAMPLES_MAX;
        checks.require(few, "examples", self.examples, &format!("must be 0..{EXAMPLES_MAX}"));
        let unused = format!("must be 0 for {scored}, which has no readings");
        let has_readings = matches!(self.scored, Scored::Method(_));
        checks.require(has_readings || self.examples == 0, "examples", self.examples, &unused);
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
    pub label: Label,
    /// Ids of the models of the method.
    pub models: Vec<ModelId>,
    /// Id of the calibration of the exact model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationId>,
    /// Number of rows that were scored.
    pub rows: u64,
    /// Least force of a peak, N.
    pub threshold_n: f64,
    /// Distances by which contacts were judged, mm, in proportion to the skin of the dataset. Reports without them
    /// were judged by those of the paper's skin.
    #[serde(default)]
    pub distances: Distances,
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
    /// How often answers are right, by their stated probability; only of a method that states one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reliability: Option<Reliability>,
    /// Scores of voltages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltages: Option<VoltageScores>,
    /// Scores of a quantity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quantity: Option<QuantityScores>,
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
    /// Contacts of the row as its label states them, mm and N.
    pub truth: Vec<Contact>,
    /// Answer of the method.
    pub reading: Reading,
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Keys of the problems of a request.
    fn problems(scored: Scored, more: serde_json::Value) -> Vec<String> {
        let mut request = json!({ "scored": scored, "dataset": "real" });
        request.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let request: EvaluationRequest = serde_json::from_value(request).unwrap();
        request.check().err().into_iter().flatten().map(|problem| problem.key).collect()
    }

    #[test]
    fn a_model_without_use_is_named_and_so_is_a_missing_one() {
        let is_quantity = |scored: &Scored| *scored == Scored::Quantity;
        let every = json!({ "transfer": "t", "map": "m", "points": "p", "skin": "cal-1" });
        for scored in Scored::all().filter(|scored| !is_quantity(scored)) {
            let unused: Vec<&str> = Slot::ALL
                .iter()
                .copied()
                .filter(|slot| !slot.is_quantity() && !scored.slots().contains(slot))
                .map(Slot::name)
                .collect();
            assert_eq!(problems(scored, every.clone()), unused, "{scored:?}");
            let missing: Vec<&str> = scored.named_slots().iter().map(|slot| slot.name()).collect();
            assert_eq!(problems(scored, json!({})), missing, "{scored:?}");
        }
    }

    #[test]
    fn values_without_use_are_named() {
        let place = json!({ "place_sd_mm": 30.0, "points": "p" });
        assert_eq!(problems(Method::Fast.into(), place.clone()), ["place_sd_mm"]);
        assert_eq!(problems(Method::Exact.into(), place), Vec::<String>::new());
        assert_eq!(problems(Scored::Voltages, json!({ "examples": 2 })), ["examples"]);
        assert_eq!(problems(Scored::Voltages, json!({ "net": "n" })), ["net"]);
        assert_eq!(problems(Scored::Quantity, json!({})), ["net"]);
        let net = json!({ "net": "n", "points": "p", "examples": 1 });
        assert_eq!(problems(Scored::Quantity, net), ["points", "examples"]);
    }

    #[test]
    fn a_report_without_distances_was_judged_by_those_of_the_papers_skin() {
        let report = json!({ "scored": "exact", "dataset": "ds-1", "label": "virtual", "models": [],
            "rows": 1, "threshold_n": 5.0 });
        let mut report: EvaluationReport = serde_json::from_value(report).unwrap();
        assert_eq!(report.distances, Distances::PAPER);
        report.distances = Distances::on_skin([60.0, 100.0]);
        let stated = &serde_json::to_value(&report).unwrap()["distances"];
        assert_eq!(*stated, json!({ "ghost_mm": 7.143, "guess_mm": 51.25 }));
    }

    #[test]
    fn only_methods_that_serve_are_read_as_a_method() {
        for method in Method::ALL {
            let name = json!(method.name());
            assert_eq!(serde_json::from_value::<Scored>(name.clone()).unwrap(), method.into());
            let served = serde_json::from_value::<Method>(name).ok();
            assert_eq!(served, Method::served().find(|m| *m == method));
        }
    }
}
