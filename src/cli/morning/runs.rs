//! `palpate runs`: what ran, newest first.
//! Uses: `client`, `table`. Never: the files of a run (`show` and the API have them).

use futures::{StreamExt, TryStreamExt};
use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use super::answers::{duration_words, elapsed, state_words, stored_words};
use super::trials::encoded;
use super::{RunsArgs, check_names};
use crate::api::Page;
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::progress::shown_wait;
use crate::cli::table::{Table, or_dash};
use crate::cli::times::local;
use crate::journal::ExitStatus;
use crate::state::StoredState;
use crate::store::{RunRow, TwinCount};

/// Number of concurrent requests.
const REQUESTS: usize = 4;

/// A line of the list: a run with its number of stored trials, and its wall time.
struct RunLine {
    run: RunRow,
    trials_stored: u64,
    took: Option<SignedDuration>,
}

impl RunLine {
    async fn of(client: &Client, run: RunRow) -> CliResult<Self> {
        let count: TwinCount = client.get(&format!("/api/v1/runs/{}/twins", run.uid)).await?;
        Ok(Self { took: elapsed(&run, Timestamp::now()), run, trials_stored: count.trials })
    }

    fn value(&self) -> Value {
        let Self { run, trials_stored, took } = self;
        json!({
            "scan_id": run.scan_id, "run": run.uid, "experiment": run.experiment, "kind": run.kind,
            "label": run.label, "state": run.state, "exit_status": run.exit_status,
            "reason": run.reason, "trials_stored": trials_stored,
            "trials_planned": run.trials_planned, "created_at": run.created_at,
            "started_at": run.started_at, "ended_at": run.ended_at,
            "duration_s": took.map(|took| took.as_secs_f64()),
        })
    }

    fn cells(&self) -> [String; 8] {
        let Self { run, trials_stored, took } = self;
        [
            run.scan_id.to_string(),
            run.experiment.clone(),
            run.label.as_str().into(),
            state_words(run),
            stored_words(*trials_stored, run.trials_planned),
            or_dash(run.started_at.map(local)),
            or_dash(took.map(duration_words)),
            run.kind.as_str().into(),
        ]
    }
}

/// Runs `palpate runs`.
///
/// # Errors
/// As [`Client::send`].
pub async fn runs(client: &Client, args: &RunsArgs) -> CliResult<()> {
    let (rows, is_all) = select(client, args).await?;
    // One wait is shown for all of them.
    let quiet = &client.quiet();
    let lines = futures::stream::iter(rows.into_iter().map(|run| RunLine::of(quiet, run)));
    let counting = lines.buffered(REQUESTS).try_collect::<Vec<_>>();
    let lines = shown_wait("counting the trials", counting).await?;
    let filtered =
        !args.conditions.is_empty() || !args.state.is_empty() || args.experiment.is_some();
    let empty = match filtered {
        true => "no run fits: palpate runs without conditions lists the newest",
        false => "there are no runs: palpate run quickstart",
    };
    let mut table = Table::new(
        "run> | experiment | label | state | stored> | started | duration> | kind",
        empty,
    );
    lines.iter().for_each(|line| table.push(line.cells()));
    let mut words = table.to_string();
    if !is_all {
        words += &format!("\nthe newest {}; --limit N shows more", lines.len());
    }
    let items: Vec<Value> = lines.iter().map(RunLine::value).collect();
    args.at.output().say(&json!({ "items": items, "all": is_all }), words);
    Ok(())
}

/// The newest runs that fit, and whether they are all.
async fn select(client: &Client, args: &RunsArgs) -> CliResult<(Vec<RunRow>, bool)> {
    let mut found = Vec::new();
    let mut conditions = args.conditions.clone();
    if let Some(word) = args.conditions.iter().find(|text| !text.contains('=')) {
        let limit = format!(
            "must be a condition such as exit_status=fail; palpate show {word} shows one run"
        );
        return Err(CliError::argument("CONDITION", word, limit));
    }
    if !args.state.is_empty() {
        let states = StoredState::ALL.iter().map(|state| state.as_str());
        let ends = ExitStatus::ALL.iter().map(|status| status.as_str());
        check_names("--state", &args.state, states.chain(ends))?;
        let states = args.state.join(",");
        conditions.push(format!("state__in={states}|exit_status__in={states}"));
    }
    let pairs: Vec<_> = conditions.into_iter().map(|text| ("where".to_owned(), text)).collect();
    let list = format!("/api/v1/runs?{}", encoded(&pairs));
    let mut path = list.clone();
    loop {
        let page: Page<RunRow> = client.get(&path).await?;
        for run in page.items {
            if args.experiment.as_deref().is_some_and(|part| !run.experiment.contains(part)) {
                continue;
            }
            if found.len() == args.limit {
                return Ok((found, false));
            }
            found.push(run);
        }
        let Some(next) = page.next else { return Ok((found, true)) };
        path = format!("{list}&cursor={next}");
    }
}
