//! What a study needs: nets trained by recipe, scores, readings, rows of datasets.
//! Uses: `evaluate`, `learn`, `infer`. Never: how they are made (the lab's owner decides).

use crate::dataset::force_map::ForceMapSpec;
use crate::evaluate::anova::AnovaError;
use crate::evaluate::figures::FigureError;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest};
use crate::ids::{DatasetId, ModelId};
use crate::infer::answer::Reading;
use crate::learn::residuals::Residuals;
use crate::learn::targets::Quantity;
use crate::store::{Contact, Label};

/// Where nets are trained and methods are scored. A lab reports the progress of its work; a study
/// does not.
pub trait Lab: Sync {
    /// Error of the lab; it also carries the errors of a study.
    type Error: From<StudyError> + Send;

    /// Returns the id of the dataset of a word: its name or its id.
    ///
    /// # Errors
    /// If the dataset does not exist or cannot be made.
    fn dataset_id(
        &self,
        dataset: &str,
    ) -> impl Future<Output = Result<DatasetId, Self::Error>> + Send;

    /// Returns the unit of a dataset's split, which is never divided: `configuration`, `trial`, or
    /// `nothing`. `dataset`: name or id.
    ///
    /// # Errors
    /// If the dataset does not exist or cannot be made.
    fn split_by(&self, dataset: &str) -> impl Future<Output = Result<String, Self::Error>> + Send;

    /// Returns the numbers of contacts from 1 to 6 that trials of a dataset's part train have, ascending; of all its
    /// trials if it has no such part. `dataset`: name or id.
    ///
    /// # Errors
    /// If the dataset does not exist or cannot be made.
    fn contact_numbers(
        &self,
        dataset: &str,
    ) -> impl Future<Output = Result<Vec<u32>, Self::Error>> + Send;

    /// Returns what a study must know of a dataset that a person names. `dataset`: name or id.
    ///
    /// # Errors
    /// If the dataset does not exist or cannot be made.
    fn facts(
        &self,
        dataset: &str,
    ) -> impl Future<Output = Result<DatasetFacts, Self::Error>> + Send;

    /// Returns the id of a net: of an earlier training with equal recipe and data, or of a new one.
    ///
    /// # Errors
    /// If the recipe is invalid or the training fails.
    fn train(
        &self,
        training: &Training,
    ) -> impl Future<Output = Result<ModelId, Self::Error>> + Send;

    /// Scores a method on a dataset.
    ///
    /// # Errors
    /// If the evaluation fails.
    fn score(
        &self,
        request: &EvaluationRequest,
    ) -> impl Future<Output = Result<EvaluationReport, Self::Error>> + Send;

    /// Returns the residuals of a Transfer-Net, stored with its model.
    ///
    /// # Errors
    /// If the model does not exist or has no residuals.
    fn residuals(
        &self,
        transfer: &ModelId,
    ) -> impl Future<Output = Result<Residuals, Self::Error>> + Send;

    /// Returns the first row of a dataset that meets all conditions, each `COLUMN__gt=VALUE`;
    /// `None` if there is none with a frame. `dataset`: name or id.
    ///
    /// # Errors
    /// If the dataset does not exist or a condition is invalid.
    fn first_trial(
        &self,
        dataset: &str,
        conditions: &[String],
    ) -> impl Future<Output = Result<Option<Trial>, Self::Error>> + Send;

    /// Reads one frame by a Transfer-Net and a net for maps; the reading contains the map.
    ///
    /// `frame_v`: voltages, V, 784, injection-major. `transfer`, `map`: ids of the nets.
    ///
    /// # Errors
    /// If a net does not exist or the frame has another number of channels.
    fn reading(
        &self,
        frame_v: &[f32],
        transfer: &ModelId,
        map: &ModelId,
    ) -> impl Future<Output = Result<Reading, Self::Error>> + Send;
}

/// Facts of a dataset on which methods are scored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DatasetFacts {
    /// Whether it has the parts train and test.
    pub has_parts: bool,
    /// Whether its rows have simulated frames.
    pub has_simulated: bool,
    /// Whether its frames are of the rig's sensor, which the exact model describes.
    pub of_rig: bool,
    /// Whether the first frames of its trials are stored.
    pub has_first_frames: bool,
    /// Larger side of its skin, mm.
    pub skin_mm: f64,
}

/// A training: a recipe with changes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Training {
    /// A carried recipe, or the path of a recipe file.
    pub recipe: String,
    /// First part of the model's name.
    pub stem: String,
    /// Name of a dataset; that of the recipe if absent.
    pub dataset: Option<String>,
    /// Conditions on its rows, each `COLUMN__lte=VALUE`.
    pub conditions: Vec<String>,
    /// Quantity that the net answers, if it answers one.
    pub answers: Option<Quantity>,
    /// The force maps that the net draws.
    pub map: Option<ForceMapSpec>,
    /// Number of passes over the data; that of the recipe if absent.
    pub epochs: Option<i64>,
    /// Largest number of rows; all if absent.
    pub rows: Option<i64>,
    /// Number of samples in a batch; that of the recipe if absent.
    pub batch: Option<i64>,
    /// Noise that is added to the frames.
    pub noise: Option<Noise>,
    /// Seed of the first weights, the order of samples and the noise.
    pub seed: i64,
}

/// A net of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct TableNet {
    /// Training that makes the net.
    pub training: Training,
    /// The requests for its scores, on parts of its dataset; they do not name the net.
    pub scores: Vec<EvaluationRequest>,
}

/// Noise in training: the residuals of a Transfer-Net, times a factor (paper, V-C1).
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// Factor on the residuals' standard deviation, above 0.
    pub level: f64,
    /// Id of the Transfer-Net.
    pub of: ModelId,
}

impl Noise {
    /// Noise of a level, or none at level 0.
    pub fn at(level: f64, of: &ModelId) -> Option<Self> {
        (level > 0.0).then(|| Self { level, of: of.clone() })
    }
}

/// A row of a dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Voltages, V, 784, injection-major.
    pub frame_v: Vec<f32>,
    /// True contacts: skin coordinates, mm; forces, N.
    pub contacts: Vec<Contact>,
    /// Origin of the row.
    pub label: Label,
}

/// Limit of a dataset on which no method can be scored.
pub const NO_METHOD: &str = "must be of the rig's sensor, or have a split, on whose part train the paper's nets \
                             learn (without --ours)";

/// Result of a study or of a part of it.
pub type StudyResult<T> = Result<T, StudyError>;

/// Why a study has no result.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum StudyError {
    /// A figure could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The scores do not fit the design of the analysis of variance.
    #[error(transparent)]
    Design(#[from] AnovaError),
    /// No method can be scored on the dataset.
    #[error("{dataset}: {limit}", limit = NO_METHOD)]
    NoMethod { dataset: String },
    /// The dataset has no trial for a figure.
    #[error("{dataset}: must have {trial}")]
    NoTrial { dataset: String, trial: String },
    /// A net answers another quantity than the one that is compared: their errors have other units.
    #[error("{net} answers the {answers}: must answer the {wanted}")]
    OtherQuantity { net: String, answers: String, wanted: &'static str },
    /// Two words name one dataset, which would count twice in a mean.
    #[error("{again}: must be another dataset than {first}; both are {id}")]
    SameDataset { first: String, again: String, id: DatasetId },
}

/// A lab for tests: it records what is requested; its reports have no scores, unless it is requested to
/// score.
#[cfg(test)]
pub mod fake {
    use std::pin::pin;
    use std::sync::Mutex;
    use std::task::{Context, Poll, Waker};

    use serde_json::json;

    use super::*;
    use crate::evaluate::quantities::QuantityScores;
    use crate::evaluate::request::{Example, Scored};
    use crate::evaluate::score::{Mean, Scores};
    use crate::evaluate::touch::Touch;
    use crate::evaluate::voltages::VoltageScores;
    use crate::infer::answer::FoundContact;

    /// A lab that records requests.
    #[derive(Default)]
    pub struct FakeLab {
        /// Requested trainings, in order.
        pub trained: Mutex<Vec<Training>>,
        /// Requested scores, in order.
        pub scored: Mutex<Vec<EvaluationRequest>>,
        /// Whether reports have scores and examples, and datasets a trial.
        pub scores: bool,
        /// Facts of every dataset, instead of those of Real-Unseen.
        pub facts: Option<DatasetFacts>,
        /// Numbers of contacts of every dataset, instead of 1 to 6.
        pub contacts: Option<Vec<u32>>,
    }

    /// Facts of Real-Unseen.
    pub const REAL_UNSEEN_FACTS: DatasetFacts = DatasetFacts {
        has_parts: false,
        has_simulated: false,
        of_rig: true,
        has_first_frames: true,
        skin_mm: 560.0,
    };

    fn contact(x_mm: f64, force_n: f64) -> Contact {
        let diameter_mm = Some(20.0);
        Contact { x_mm: Some(x_mm), y_mm: Some(280.0), force_n: Some(force_n), diameter_mm }
    }

    fn found(x_mm: f64) -> FoundContact {
        FoundContact { x_mm, y_mm: 290.0, force_n: Some(11.0), ..FoundContact::default() }
    }

    /// Scores of frames with 1, 2 and 4 contacts (none has 3), and their readings.
    fn with_scores(request: &EvaluationRequest, mut report: EvaluationReport) -> EvaluationReport {
        let counts = [1_u32, 2, 4, 1, 2, 4];
        report.rows = counts.len() as u64;
        if request.scored == Scored::Voltages {
            let fits = counts.map(|count| (count, 0.01, Some(0.05 * f64::from(count))));
            report.voltages = VoltageScores::of(&fits);
            return report;
        }
        if request.scored == Scored::Quantity {
            report.quantity = Some(QuantityScores {
                quantity: "force".into(),
                rows: 2,
                left_out: 0,
                error: Mean::of_rows(&[1.0, 3.0], 1).unwrap(),
                median_error: 2.0,
                right: None,
                constant_error: 9.0,
            });
            return report;
        }
        let truth = |count: u32| -> Vec<Contact> {
            (0..count).map(|n| contact(100.0 + 90.0 * f64::from(n), 12.0)).collect()
        };
        let reading = |count: u32| Reading {
            contacts: (0..count).map(|n| found(104.0 + 90.0 * f64::from(n))).collect(),
            ..Reading::default()
        };
        let touches = counts.map(|count| {
            let estimates: Vec<Contact> =
                reading(count).contacts.iter().map(Contact::from).collect();
            Touch::of(&truth(count), &estimates, report.distances.ghost_mm).unwrap()
        });
        report.contacts = Some(Scores::of(&touches, &report.distances, 1));
        report.perfect = report.contacts.clone();
        report.map = Some("4x20".into());
        let sums = ["number_percent", "location_mm", "force_percent", "diameter_percent"];
        let moments = || [4.0, 10.0].into_iter().collect();
        report.cells = Some(sums.map(|key| (key.to_owned(), moments())).into());
        let shown = counts.into_iter().take(request.examples as usize);
        report.examples = shown.map(|n| Example { truth: truth(n), reading: reading(n) }).collect();
        report
    }

    impl Lab for FakeLab {
        type Error = StudyError;

        /// The id of `pad` is `ds-pad`.
        async fn dataset_id(&self, dataset: &str) -> StudyResult<DatasetId> {
            let name = dataset.strip_prefix("ds-").unwrap_or(dataset);
            Ok(DatasetId::unchecked(format!("ds-{name}")))
        }

        async fn split_by(&self, _: &str) -> StudyResult<String> {
            Ok("configuration".into())
        }

        async fn contact_numbers(&self, _: &str) -> StudyResult<Vec<u32>> {
            Ok(self.contacts.clone().unwrap_or_else(|| (1..=6).collect()))
        }

        async fn facts(&self, _: &str) -> StudyResult<DatasetFacts> {
            Ok(self.facts.unwrap_or(REAL_UNSEEN_FACTS))
        }

        async fn train(&self, training: &Training) -> StudyResult<ModelId> {
            let mut trained = self.trained.lock().unwrap();
            trained.push(training.clone());
            Ok(ModelId::unchecked(format!("mdl-{}", trained.len())))
        }

        async fn score(&self, request: &EvaluationRequest) -> StudyResult<EvaluationReport> {
            self.scored.lock().unwrap().push(request.clone());
            let report = json!({ "scored": request.scored, "dataset": "ds-1", "label": "virtual",
                "models": [], "rows": 0, "threshold_n": 5.0 });
            let report = serde_json::from_value(report).unwrap();
            Ok(if self.scores { with_scores(request, report) } else { report })
        }

        async fn residuals(&self, _: &ModelId) -> StudyResult<Residuals> {
            Ok(Residuals { mean_v: vec![0.0; 784], sd_v: vec![0.1; 784], trials: 1 })
        }

        async fn first_trial(&self, _: &str, _: &[String]) -> StudyResult<Option<Trial>> {
            let contacts = vec![contact(200.0, 16.0)];
            let trial = Trial { frame_v: vec![0.0; 784], contacts, label: Label::Virtual };
            Ok(self.scores.then_some(trial))
        }

        async fn reading(&self, _: &[f32], _: &ModelId, _: &ModelId) -> StudyResult<Reading> {
            Ok(Reading::default())
        }
    }

    /// Result of a study with the fake lab, which never waits.
    pub fn result<T>(study: impl Future<Output = T>) -> T {
        match pin!(study).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(result) => result,
            Poll::Pending => panic!("the fake lab waits"),
        }
    }
}
