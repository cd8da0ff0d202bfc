//! Evaluations of `exact` of which other machines read the frames: what they need, and the scores of their answers.
//! Uses: `evaluation`, `scoring`, the skins of `exact`. Never: an answer to another frame than the one that is scored.

use std::sync::Arc;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use sim_core::batch::Kernel;
use utoipa::ToSchema;

pub mod chunks;
pub mod frames;

use self::frames::FrameInput;
use super::scoring::{Reader, Scoring};
use super::{JobError, JobResult, Jobs, evaluation};
use crate::dataset::background::background;
use crate::digest::sha256_hex;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest};
use crate::ids::DatasetId;
use crate::infer::answer::Reading;
use crate::infer::error::InferResult;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::exact::{ExactPipeline, ExactSkin};
use crate::infer::methods::{Frames, ReadyMethod, UsedSkin};
use crate::infer::registry::Model;
use crate::problem::Problem;

/// Largest number of frames of an evaluation whose frames other machines read: the order contains them.
pub const ORDERED_FRAMES_MAX: u64 = 5000;

/// What other machines need to read the frames of an evaluation.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct ReadingInputs {
    /// Id of the dataset.
    pub dataset: DatasetId,
    /// Simulation id of the skin's model.
    pub simulation: String,
    /// Vector instructions of the service's processor, on which the last digits of a fit depend.
    pub kernel: String,
    /// Text of the sensor file.
    pub sensor: String,
    /// Text of the calibration file; null for the nominal model.
    pub calibration: Option<String>,
    /// Errors of the skin's model, JSON.
    pub errors: String,
    /// Number of frames.
    pub rows: u64,
    /// The frames of each chunk, as text.
    pub frames: Vec<String>,
}

impl Jobs {
    /// Returns what other machines need to read the frames of an evaluation, `chunk_rows` frames in each chunk. The
    /// dataset is made if needed; to prepare a skin takes up to most of a minute.
    ///
    /// # Errors
    /// `JobError` if the request is not of `exact` without nets, has too many rows, or cannot be prepared.
    pub async fn reading_inputs(
        &self,
        request: &EvaluationRequest,
        chunk_rows: usize,
    ) -> JobResult<ReadingInputs> {
        let (skin, scoring) = self.prepared(request).await?;
        let (dataset, rows) = (scoring.dataset.clone(), scoring.gathered.rows.len() as u64);
        let calibration = skin.calibration().map(|id| self.inner.serving.skins().stored(id));
        let calibration = calibration.transpose()?;
        let reading = move || -> JobResult<_> {
            let stored = calibration.map(|stored| stored.text()).transpose()?;
            let inputs = scoring.inputs()?;
            let frames = inputs.chunks(chunk_rows.max(1)).map(FrameInput::lines);
            Ok((stored, frames.collect::<Vec<String>>()))
        };
        let (calibration, frames) = background(reading).await??;
        Ok(ReadingInputs {
            dataset,
            simulation: skin.simulation().to_owned(),
            kernel: Kernel::detect().name().to_owned(),
            sensor: self.inner.serving.sensor_text().to_owned(),
            calibration,
            errors: serde_json::to_string(skin.errors()).map_err(JobError::Json)?,
            rows,
            frames,
        })
    }

    /// Scores readings that other machines have made, as an evaluation would have; its latencies are absent.
    ///
    /// `model`: simulation id of the skin's model; `frames_sha256`: sha256 of the frames as text.
    ///
    /// # Errors
    /// `JobError::Problems` if they are of another model or of other frames; another one if the evaluation cannot be
    /// prepared or scored.
    pub async fn score_readings(
        &self,
        request: &EvaluationRequest,
        model: &str,
        frames_sha256: &str,
        readings: Vec<Reading>,
    ) -> JobResult<EvaluationReport> {
        let (skin, scoring) = self.prepared(request).await?;
        let refused = |key: &str, value: &str, limit: &str| {
            JobError::Problems(vec![Problem::new("readings", key, value, limit)])
        };
        if skin.simulation() != model {
            let limit = format!("the service uses {} for this request", skin.simulation());
            return Err(refused("model", model, &limit));
        }
        let rows = scoring.gathered.rows.len();
        if readings.len() != rows {
            let limit = format!("must be one for each of {rows} rows");
            return Err(refused("file", &format!("{} readings", readings.len()), &limit));
        }
        let stated = frames_sha256.to_owned();
        let scoring = background(move || -> JobResult<Option<EvaluationReport>> {
            let mut scoring = scoring;
            if sha256_hex(FrameInput::lines(&scoring.inputs()?)) != stated {
                let limit = "must be that of the frames of the dataset now; order again";
                let problem = Problem::new("readings", "frames_sha256", stated, limit);
                return Err(JobError::Problems(vec![problem]));
            }
            let exact = ExactPipeline { skin, points: None };
            let readings = Mutex::new(readings.into_iter());
            scoring.reader = Reader::Contacts(Box::new(Replayed { exact, readings }));
            scoring.run()
        });
        let report = scoring.await??.ok_or(JobError::Worker)?;
        Ok(EvaluationReport { latency_ms: None, ..report })
    }

    /// The skin and the rows of a request for `exact` without nets.
    async fn prepared(&self, request: &EvaluationRequest) -> JobResult<(Arc<ExactSkin>, Scoring)> {
        request.check()?;
        let refused = |key: &str, value: String, limit: &str| {
            JobError::Problems(vec![Problem::new("request", key, value, limit)])
        };
        if !request.scored.is_fit() {
            let limit = "must be exact: the frames of other methods are read in milliseconds";
            return Err(refused("scored", request.scored.name().into(), limit));
        }
        if let Some(points) = &request.points {
            let limit = "must be absent: a net is not in the order";
            return Err(refused("points", points.clone(), limit));
        }
        if request.examples > 0 {
            let limit = "must be 0: readings in chunks have no maps";
            return Err(refused("examples", request.examples.to_string(), limit));
        }
        let dataset = self.inner.datasets.resolve(&request.dataset).await?;
        let calibration = evaluation::skin(self, request).await?;
        let serving = &self.inner.serving;
        serving.once_restored(None).await;
        let skin = serving.skin(calibration.as_ref()).await?;
        let exact = ExactPipeline { skin: skin.clone(), points: None };
        let reader = Reader::Contacts(Box::new(exact));
        let watch = Arc::default();
        let scoring = evaluation::scoring(self, request.clone(), reader, dataset, &watch);
        let scoring = scoring.await.map_err(|error| match error {
            // No row meets the conditions, for example: a fault of the request, not of this program.
            JobError::Learn(error) => {
                JobError::Problems(vec![Problem::whole("request", error.to_string())])
            }
            other => other,
        })?;
        let rows = scoring.gathered.rows.len() as u64;
        if rows > ORDERED_FRAMES_MAX {
            let limit = format!("at most {ORDERED_FRAMES_MAX} rows: set a limit");
            return Err(refused("limit", format!("{rows} rows"), &limit));
        }
        Ok((skin, scoring))
    }
}

/// `exact` with answers that are known: those to the rows of an evaluation, in their order.
struct Replayed {
    exact: ExactPipeline,
    readings: Mutex<std::vec::IntoIter<Reading>>,
}

impl ReadyMethod for Replayed {
    fn read(&self, frames: &Frames<'_>, _: ForceMaps) -> InferResult<Vec<Reading>> {
        let count = frames.voltages_v.len() / self.exact.skin.channels();
        Ok(self.readings.lock().by_ref().take(count).collect())
    }

    fn id(&self) -> String {
        self.exact.id()
    }

    fn nets(&self) -> Vec<&Model> {
        self.exact.nets()
    }

    fn skin(&self) -> Option<UsedSkin<'_>> {
        self.exact.skin()
    }

    fn takes_untouched(&self) -> bool {
        self.exact.takes_untouched()
    }

    fn size_mm(&self) -> [f64; 2] {
        self.exact.size_mm()
    }
}
