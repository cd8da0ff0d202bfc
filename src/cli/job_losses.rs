//! `palpate job losses`: the losses of a training as lines of JSON, or as a learning curve.
//! Uses: `client`, `evaluate::losses`, `picture`. Never: a loss that the training did not report.

use std::path::Path;

use serde_json::Value;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::output::say;
use super::picture;
use super::view::rows;
use crate::api::JobOut;
use crate::evaluate::losses::{best, curve, read};
use crate::figure::Heading;
use crate::ids::DatasetId;
use crate::record::Label;

/// Name in the recipe of a training; `None` for an evaluation.
pub fn recipe_name(job: &JobOut) -> Option<String> {
    let recipe = job.task.request["recipe"].as_str()?;
    let recipe = toml::from_str::<toml::Table>(recipe).ok();
    let name = recipe.and_then(|recipe| recipe.get("name")?.as_str().map(str::to_owned));
    Some(name.unwrap_or_default())
}

/// Returns the losses of a training, a JSON object per line: of a running one, or of the model of an
/// ended one.
///
/// # Errors
/// `CliError::Problems` if the job is no training; others as [`Client::send`].
pub async fn losses(client: &Client, job: &str) -> CliResult<String> {
    let running = client.text(&format!("/api/v1/jobs/{job}/losses")).await?;
    if !running.is_empty() {
        return Ok(running);
    }
    let known: JobOut = client.get(&format!("/api/v1/jobs/{job}")).await?;
    if recipe_name(&known).is_none() {
        return Err(no_training(job));
    }
    match known.task.result.as_ref().and_then(|result| result["model"].as_str()) {
        Some(model) => client.text(&format!("/api/v1/models/{model}/losses")).await,
        None => Ok(String::new()),
    }
}

fn no_training(job: &str) -> CliError {
    let limit = "is an evaluation, which has no losses: palpate job list shows the trainings";
    CliError::argument("JOB", job, limit)
}

/// The labels that rows of a dataset have: `virtual`, or `measured and virtual` (`s2s-recon` may have both).
async fn labels(client: &Client, dataset: &DatasetId) -> CliResult<String> {
    let mut found = Vec::new();
    for label in [Label::Measured, Label::Virtual, Label::Simulated].map(Label::as_str) {
        let path = format!("/api/v1/datasets/{dataset}/rows?label={label}&columns=label&limit=1");
        let page: Value = client.get(&path).await?;
        if !rows(&page, "items").is_empty() {
            found.push(label);
        }
    }
    Ok(found.join(" and "))
}

/// Draws the learning curve of a training to a file.
///
/// # Errors
/// `CliError` if the job is no training or has no losses yet, a request fails, or the file cannot be
/// written.
pub async fn draw(client: &Client, name: &str, file: &Path) -> CliResult<()> {
    let job: JobOut = client.get(&format!("/api/v1/jobs/{name}")).await?;
    let Some(net) = recipe_name(&job) else {
        return Err(no_training(name));
    };
    let losses = read(&losses(client, name).await?);
    if losses.is_empty() {
        let limit = "has no losses yet: the first ones come at the end of its first epoch";
        return Err(CliError::argument("JOB", name, limit));
    }
    let label = match &job.task.dataset {
        Some(dataset) => labels(client, dataset).await?,
        None => String::new(),
    };
    let title = format!("Learning curve of {net}");
    let mut heading = Heading::new(title, losses.len() as u64, "epochs", &label);
    if let Some(dataset) = &job.task.dataset {
        heading =
            heading.with_note(format!("{}, {}, dataset {dataset}", job.task.id, job.task.state));
    }
    picture::write(file, &curve(&heading, "mean loss (unit of the net's loss)", &losses)?).await?;
    let best = best(&losses).map_or_else(String::new, |(epoch, loss)| {
        format!("best epoch {epoch} of {}, validation loss {loss:.3e}; ", losses.len())
    });
    say(format_args!("{best}{}", file.display()));
    Ok(())
}
