//! The rows that an evaluation scores, and the first frames of their trials.
//! Uses: `learn::examples`, `dataset`, `store`. Never: a method, a score.

use std::path::Path;

use super::error::JobResult;
use crate::dataset::import::sensor::ImportedSensor;
use crate::dataset::read::sensor_text;
use crate::dataset::split::Part;
use crate::evaluate::request::EvaluationRequest;
use crate::ids::TrialId;
use crate::learn::error::LearnError;
use crate::learn::examples::Examples;
use crate::store::Store;

/// Rows to score, with their sensor.
pub struct Gathered {
    /// All rows of the dataset that meet the conditions.
    pub examples: Examples,
    /// Indices of the rows that are scored.
    pub rows: Vec<u32>,
    /// Sensor of the rows.
    pub skin: ImportedSensor,
}

impl Gathered {
    /// Reads the rows of a request from the dataset's file.
    ///
    /// # Errors
    /// `JobError` if the file cannot be read, or no row meets the conditions.
    pub fn new(
        file: &Path,
        request: &EvaluationRequest,
        columns: &'static [&'static str],
        scratch: &Path,
    ) -> JobResult<Self> {
        let skin = ImportedSensor::from_toml("sensor", &sensor_text(file)?)?;
        let examples = Examples::gather(file, &request.conditions, columns, scratch)?;
        let mut rows = match &request.part {
            Some(name) => Part::named(name).map_or_else(Vec::new, |part| examples.part(part)),
            None => (0..examples.len() as u32).collect(),
        };
        if rows.is_empty() {
            let part = request.part.as_deref().unwrap_or("any part");
            let limit = format!("has no rows in {part}: nothing to score");
            return Err(LearnError::value("evaluation", "dataset", &request.dataset, &limit).into());
        }
        if let Some(limit) = request.limit
            && (limit as usize) < rows.len()
        {
            let all = rows.len();
            rows = (0..limit as usize).map(|i| rows[i * all / limit as usize]).collect();
        }
        Ok(Self { examples, rows, skin })
    }

    /// Ids of the trials of the rows; a row that is no trial has none.
    pub fn trials(&self) -> Vec<TrialId> {
        self.rows.iter().filter_map(|&row| self.examples.trial_id(row)).collect()
    }
}

/// Reads the first raw frame of each row's trial, V; a mean of one frame is that frame.
///
/// # Errors
/// `JobError::Learn` if a row has no raw frames in the store and is the mean of several; `Store` if the store
/// fails.
pub async fn first_frames(store: &Store, gathered: &Gathered) -> JobResult<Vec<Vec<f32>>> {
    let mut firsts = Vec::with_capacity(gathered.rows.len());
    for &row in &gathered.rows {
        let examples = &gathered.examples;
        let frames = match examples.trial_id(row) {
            Some(id) => store.frames(id).await?,
            None => Vec::new(),
        };
        firsts.push(match frames.first() {
            Some(first) => {
                let volts = first.volts_per_count;
                first.counts.iter().map(|&count| f32::from(count) * volts).collect()
            }
            None if examples.frame_count(row) == 1 => {
                let mut frame = vec![0.0; examples.channels];
                examples.frame(row, 0, &mut frame)?;
                frame
            }
            None => {
                let limit = "first: row has no raw frames in the store; use mean";
                return Err(LearnError::value("evaluation", "frames", row, limit).into());
            }
        });
    }
    Ok(firsts)
}
