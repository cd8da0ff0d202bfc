//! An evaluation of `exact` as a work order, and the scores of its readings.
//! Uses: `client` (a service states the frames and scores the readings), `jobs::readings`. Never: a fit, a score.

use std::path::Path;

use clap::Args;
use reqwest::multipart::Part;
use serde_json::json;

use super::OrderPlace;
use super::kind::order_of;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::{ChunkRow, WorkOrder};
use crate::cli::At;
use crate::cli::download::DATASET_WAIT;
use crate::cli::embed::{self, Purpose::Computes};
use crate::cli::error::{CliError, CliResult};
use crate::cli::evaluate::MethodRequest;
use crate::cli::evaluate::lab::ExtentArgs;
use crate::cli::progress::Counted;
use crate::evaluate::request::EvaluationReport;
use crate::jobs::chunks::{NetScore, SCORES_FILE};
use crate::jobs::readings::ReadingInputs;
use crate::jobs::readings::chunks::{ReadingsOrder, gather, work_order};
use crate::new_file;

/// Name of the file with the readings of all frames, a line of JSON each.
const READINGS_FILE: &str = "readings.jsonl";

/// Options that determine the readings of an evaluation.
#[derive(Debug, Clone, Args)]
pub struct ReadingsRequest {
    #[command(flatten)]
    method: MethodRequest,
    #[command(flatten)]
    extent: ExtentArgs,
    /// Number of frames of a chunk; a fit takes about 0.05 s.
    #[arg(long, value_name = "N", default_value_t = 50)]
    chunk_rows: u32,
    #[command(flatten)]
    pub place: OrderPlace,
}

impl ReadingsRequest {
    /// The work order, and the number of its frames.
    ///
    /// # Errors
    /// `CliError` if an option is invalid, the service cannot be reached or started, or the evaluation cannot be
    /// prepared.
    pub async fn order(&self, json: bool) -> CliResult<(WorkOrder, u64)> {
        let at = self.place.at(json);
        let request = self.method.clone().request(&self.extent.budget());
        let path = format!("/api/v1/evaluations/inputs?chunk_rows={}", self.chunk_rows);
        embed::with_purpose(&at, Computes, async |client| {
            let client = client.patient(DATASET_WAIT);
            let client = client.showing("preparing the skin and the frames");
            let inputs: ReadingInputs = client.post(&path, &request).await?;
            let rows = inputs.rows;
            Ok((work_order(request, inputs), rows))
        })
        .await
    }
}

/// Writes the readings of a folder's work order, which has these rows, to `out`, and their scores by the service, as
/// `palpate evaluate method --trained` takes them. Returns the number of readings.
///
/// # Errors
/// `ChunkError::Incomplete` if a chunk is damaged; another `CliError` if a file cannot be read or written, or the
/// service refuses the readings.
pub async fn score(
    folder: &OrderFolder,
    rows: &[ChunkRow],
    out: &Path,
    at: &At,
    mut verified: Counted,
) -> CliResult<u64> {
    let order = order_of(folder, ReadingsOrder::read)?;
    let lines = gather(folder, rows, &mut || verified.add(1));
    drop(verified);
    let file = out.join(READINGS_FILE);
    new_file::write(out, READINGS_FILE, lines?).map_err(CliError::file(&file))?;
    let request = order.definition.request.clone();
    let texts = vec![
        ("request", Part::text(json!(request).to_string())),
        ("model", Part::text(order.definition.model.clone())),
        ("frames_sha256", Part::text(order.frames_sha256())),
    ];
    let report: EvaluationReport = embed::with_purpose(at, Computes, async |client| {
        let client = client.patient(DATASET_WAIT);
        let client = client.showing("scoring the readings");
        client.upload("/api/v1/evaluations/readings", &file, texts).await
    })
    .await?;
    let scores = json!(vec![NetScore { request, report }]).to_string();
    new_file::write(out, SCORES_FILE, scores).map_err(CliError::file(&out.join(SCORES_FILE)))?;
    Ok(rows.iter().map(|row| row.rows).sum())
}
