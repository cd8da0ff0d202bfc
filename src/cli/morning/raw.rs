//! `palpate show RUN|TRIAL --raw PART`: what the service stores of a run or a trial, as JSON for scripts.
//! Uses: `client`. Never: a change, or words for people (`show` has them).

use clap::ValueEnum;
use serde_json::Value;

use super::show_trial::{Frames, named, stored};
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::output::{say, say_json};

/// Records per request; a longer list has several pages.
const PAGE_RECORDS: usize = 1000;

/// Part of a run or of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// The plan of a run: every position, depth and wait.
    Plan,
    /// The preflight of a run on this rig.
    Preflight,
    /// The failed attempts of a run, one per line.
    Attempts,
    /// The tares of a run, one per line.
    Tares,
    /// The touch-offs of a run, one per line.
    TouchOffs,
    /// The reference presses of a run, one per line.
    References,
    /// The raw frames of a trial, one per line.
    Frames,
}

/// Prints a part: one line of JSON, or one per record.
///
/// # Errors
/// `CliError::Problems` if the part is not one of what was named; others as [`Client::send`].
pub async fn show(client: &Client, what: &str, part: Part) -> CliResult<()> {
    let client = client.showing("reading");
    let (kind, is_list) = match part {
        Part::Plan => ("plan", false),
        Part::Preflight => ("preflight", false),
        Part::Attempts => ("records/attempts", true),
        Part::Tares => ("records/tares", true),
        Part::TouchOffs => ("records/touch-offs", true),
        Part::References => ("records/references", true),
        Part::Frames => return frames(&client, what).await,
    };
    if named(what).is_some() {
        let limit = "must be a run for this part; --raw frames is the part of a trial";
        return Err(CliError::argument("RUN|TRIAL", what, limit));
    }
    let run = find_run(&client, what).await?.uid;
    let path = format!("/api/v1/runs/{run}/{kind}");
    if is_list {
        let records: Vec<Value> = client.all(&format!("{path}?limit={PAGE_RECORDS}")).await?;
        for record in &records {
            say_json(record);
        }
    } else {
        say(client.text(&path).await?.trim_end());
    }
    Ok(())
}

async fn frames(client: &Client, what: &str) -> CliResult<()> {
    let Some(name) = named(what) else {
        let limit = "must be a trial for --raw frames, such as t812 or 3/81/4";
        return Err(CliError::argument("RUN|TRIAL", what, limit));
    };
    let trial = stored(client, &name, Frames::Without).await?.trial_id.0;
    let frames: Vec<Value> = client.all(&format!("/api/v1/trials/{trial}/frames?")).await?;
    for frame in &frames {
        say_json(frame);
    }
    Ok(())
}
