//! `palpate show RUN|TRIAL --raw PART`: what the service stores of a run or a trial, as JSON for scripts.
//! Uses: `client`. Never: a change, or words for people (`show` has them).

use std::fmt::Display;

use clap::ValueEnum;
use serde_json::Value;

use super::show_trial::{named, stored};
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::output::{note, say_json, say_whole};

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
    // Of a list, with the name of its records.
    let (kind, records) = match part {
        Part::Plan => ("plan", None),
        Part::Preflight => ("preflight", None),
        Part::Attempts => ("records/attempts", Some("failed attempts")),
        Part::Tares => ("records/tares", Some("tares")),
        Part::TouchOffs => ("records/touch-offs", Some("touch-offs")),
        Part::References => ("records/references", Some("reference presses")),
        Part::Frames => return frames(&client, what).await,
    };
    if named(what).is_some() {
        let limit = "must be a run for this part; --raw frames is the part of a trial";
        return Err(CliError::argument("RUN|TRIAL", what, limit));
    }
    let run = find_run(&client, what).await?;
    let path = format!("/api/v1/runs/{}/{kind}", run.uid);
    if let Some(name) = records {
        let list: Vec<Value> = client.all(&format!("{path}?limit={PAGE_RECORDS}")).await?;
        print(&list, format_args!("run {} has no {name}", run.scan_id));
    } else {
        say_whole(client.text(&path).await?.trim_end());
    }
    Ok(())
}

async fn frames(client: &Client, what: &str) -> CliResult<()> {
    let Some(name) = named(what) else {
        let limit = "must be a trial for --raw frames, such as t812 or 3/81/4";
        return Err(CliError::argument("RUN|TRIAL", what, limit));
    };
    let trial = stored(client, &name, false).await?.trial_id.0;
    let frames: Vec<Value> = client.all(&format!("/api/v1/trials/{trial}/frames?")).await?;
    print(&frames, format_args!("trial t{trial} has no raw frames"));
    Ok(())
}

/// Prints records, one per line. `none`: the note, on standard error, if there are none.
fn print(records: &[Value], none: impl Display) {
    if records.is_empty() {
        note(none);
    }
    records.iter().for_each(say_json);
}
