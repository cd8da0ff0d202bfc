//! The morning after: what ran, what was measured, what happened, and how two runs differ.
//! Uses: `client`, `table`. Never: a change of anything (these commands only read).

use std::path::PathBuf;

use clap::Args;

mod actions;
mod answers;
mod chart;
mod compare;
mod diff;
mod events;
mod frame;
mod history;
mod raw;
mod report;
mod runs;
mod show;
mod show_trial;
mod stream;
mod trials;

pub use actions::actions;
pub use answers::{TrialFacts, all_trials};
pub use diff::diff;
pub use events::events;
pub use report::report;
pub use runs::runs;
pub use show::show;
pub use trials::trials;

use super::At;
use super::error::{CliError, CliResult};
use super::times::Since;
use crate::near::did_you_mean;

/// Options of `runs`.
#[derive(Debug, Clone, Args)]
pub struct RunsArgs {
    /// Conditions that all must hold: a column with its comparison, such as `exit_status=fail`,
    /// `started_at__gte=2026-11-24T22:00:00Z`.
    #[arg(value_name = "COLUMN__gt=VALUE")]
    pub conditions: Vec<String>,
    /// Only runs in these states, or that ended like this, such as `ended`, `interrupted`,
    /// `success`, `fail`.
    #[arg(long, value_name = "STATE,..", value_delimiter = ',')]
    pub state: Vec<String>,
    /// Only runs whose experiment has this text in its name.
    #[arg(long, value_name = "TEXT")]
    pub experiment: Option<String>,
    /// Largest number of runs.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = at_least_one)]
    pub limit: usize,
    #[command(flatten)]
    pub at: At,
}

/// Options of `trials`.
#[derive(Debug, Clone, Args)]
pub struct TrialsArgs {
    /// A run (number, start of the id, or `last`), and conditions that all must hold: a column with
    /// its comparison, such as `contact_count__gte=3`, `tips=4`, `flagged=true`.
    #[arg(value_name = "RUN|COLUMN__gt=VALUE")]
    pub what: Vec<String>,
    /// Show the oldest trials first.
    #[arg(long)]
    pub oldest: bool,
    /// Largest number of trials.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = at_least_one)]
    pub limit: usize,
    #[command(flatten)]
    pub at: At,
}

/// Options of `events`.
#[derive(Debug, Clone, Args)]
pub struct EventsArgs {
    /// Run: number, start of the id, or `last`; without it all events.
    pub run: Option<String>,
    /// Stay and print new events as they happen, until Ctrl-C.
    #[arg(short, long)]
    pub follow: bool,
    /// Only events of these kinds, such as `trip,skipped,state`.
    #[arg(long, value_name = "KIND,..", value_delimiter = ',')]
    pub kind: Vec<String>,
    /// Only events that a person should not miss: trips, suspensions, skips, waits, the end.
    #[arg(long)]
    pub important: bool,
    /// Only events after this: a duration ago (8h, 90min), a time (22:00, 2026-11-24T22:00), or the
    /// number of an event.
    #[arg(long, value_name = "WHEN")]
    pub since: Option<Since>,
    /// Largest number of events, the newest [default: 50; with --since all].
    #[arg(long, value_name = "N")]
    pub limit: Option<usize>,
    #[command(flatten)]
    pub at: At,
}

/// Options of `actions`.
#[derive(Debug, Clone, Args)]
pub struct ActionsArgs {
    /// Run: number, start of the id, or `last`; without it all actions.
    pub run: Option<String>,
    /// Largest number of actions.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = at_least_one)]
    pub limit: usize,
    #[command(flatten)]
    pub at: At,
}

/// Options of `show`.
#[derive(Debug, Clone, Args)]
pub struct ShowArgs {
    /// A run (number, start of the id, or `last`), or a trial: `t812`, as `palpate trials` lists it,
    /// or RUN/CONFIGURATION/DEPTH with the index of the depth.
    #[arg(value_name = "RUN|TRIAL")]
    pub what: String,
    /// Show the run over time: trials, failed attempts, forces, FVU, states.
    #[arg(long)]
    pub history: bool,
    /// Print a stored part as JSON, for scripts, one line per record.
    #[arg(long, value_name = "PART", value_enum, conflicts_with = "history")]
    pub raw: Option<raw::Part>,
    #[command(flatten)]
    pub at: At,
}

/// Options of `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// Run: number, start of the id, or `last`.
    pub run: String,
    /// Folder of the report [default: here].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the HTML only.
    #[arg(long)]
    pub no_pdf: bool,
    #[command(flatten)]
    pub at: At,
}

/// Options of `diff`.
#[derive(Debug, Clone, Args)]
pub struct DiffArgs {
    /// The earlier run: number, start of the id, or `last`.
    #[arg(value_name = "RUN")]
    pub before: String,
    /// The run that is compared with it.
    #[arg(value_name = "RUN")]
    pub after: String,
    #[command(flatten)]
    pub at: At,
}

/// Parser of the largest number of rows: none is no list.
fn at_least_one(text: &str) -> Result<usize, String> {
    let count = text.parse::<usize>().ok().filter(|count| *count > 0);
    count.ok_or_else(|| "must be a whole number, 1 or more".into())
}

/// Refuses names that an option does not have: no row would fit them, as if nothing had happened.
fn check_names<'a>(
    option: &str,
    typed: &[String],
    names: impl IntoIterator<Item = &'a str>,
) -> CliResult<()> {
    let names: Vec<&str> = names.into_iter().collect();
    let Some(wrong) = typed.iter().find(|name| !names.contains(&name.as_str())) else {
        return Ok(());
    };
    let meant = did_you_mean(wrong, names.iter().copied());
    let limit = format!("must be one of {}{meant}", names.join(", "));
    Err(CliError::argument(option, wrong, limit))
}
