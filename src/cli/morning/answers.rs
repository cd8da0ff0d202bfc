//! What these commands read of the service about a run, and how its end reads.
//! Uses: `client`, `progress`. Never: a decision about a run.

use std::collections::{BTreeMap, BTreeSet};

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::api::Summary;
use crate::cli::client::Client;
use crate::cli::error::{CliError, CliResult};
use crate::cli::output::{counted, duration, grouped};
use crate::cli::progress::Counted;
use crate::evaluate::simulation::SimulationReport;
use crate::ids::RunUid;
use crate::state::{PausedWhy, StoredState};
use crate::store::{MAX_PAGE, RunKind, RunRow, TwinCount};

/// Columns of a trial that these commands read.
const TRIAL_COLUMNS: &str = "trial_id,configuration,depth_index,depth_mm,tips,contact_count,max_force_n,\
                       forces_n,contacts,fvu,rmse_v,flags,overshoot_n,settle_ms,measured_at";

/// A trial without its frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TrialFacts {
    /// Number of the stored trial.
    pub trial_id: i64,
    /// Index of the configuration in the plan.
    pub configuration: u32,
    /// Index of the depth in the configuration.
    pub depth_index: u32,
    /// Depth, mm; absent if weights were placed.
    pub depth_mm: Option<f64>,
    /// Number of attached tips or placed contacts.
    pub tips: u8,
    /// Number of contacts, by the deadband.
    pub contact_count: u8,
    /// Largest raw force, N.
    pub max_force_n: Option<f64>,
    /// Raw forces of arms 1 to 6, N; null without a tip.
    pub forces_n: Vec<Option<f64>>,
    /// FVU of the twin.
    pub fvu: Option<f64>,
    /// RMSE against the twin, V.
    pub rmse_v: Option<f64>,
    /// Marks of possible faults.
    pub flags: Vec<String>,
    /// Time of the last frame.
    pub measured_at: Option<Timestamp>,
}

/// Numbers of a run's trials and twins.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct TwinsOf {
    /// Number of stored trials.
    pub trials: u64,
    /// Number of trials with a twin, of whichever model.
    pub twins: u64,
    /// Number of trials that the model cannot simulate.
    pub failures: u64,
    /// Number of trials without twin and without failure.
    pub pending: u64,
}

/// Returns the numbers of trials and twins of a run, and the fit of the newest twin of each trial.
///
/// # Errors
/// As [`Client::send`].
pub async fn fit_of(client: &Client, run: RunUid) -> CliResult<(TwinsOf, SimulationReport)> {
    let path = format!("/api/v1/runs/{run}");
    // Its twins are those of the serving model only.
    let TwinCount { trials, failures, .. } = client.get(&format!("{path}/twins")).await?;
    let shown = client.showing("scoring the twins");
    let fit: SimulationReport = shown.get(&format!("{path}/evaluation/simulation")).await?;
    let twins = fit.trials + fit.flagged;
    let pending = trials.saturating_sub(twins + failures);
    Ok((TwinsOf { trials, twins, failures, pending }, fit))
}

/// Returns all trials of a run, in the order of storing, of which there are about `expected`.
///
/// # Errors
/// As [`Client::send`]; `CliError::Refused` if a line cannot be read.
pub async fn all_trials(client: &Client, run: RunUid, expected: u64) -> CliResult<Vec<TrialFacts>> {
    let mut shown = Counted::of("trials read", expected);
    let select = format!("columns={TRIAL_COLUMNS}");
    trials(&client.quiet(), run, &select, |count| shown.show(count, expected)).await
}

/// Returns the trial with contacts of the largest FVU, with its number and FVU only; `None` without one. `fit`: the
/// report of the run. To sort all trials by their FVU needs the query engine, which may be missing.
///
/// # Errors
/// As [`all_trials`].
pub async fn worst_fit(
    client: &Client,
    run: RunUid,
    fit: &SimulationReport,
) -> CliResult<Option<TrialFacts>> {
    let Some(least) = worst_at_least(fit) else { return Ok(None) };
    let select = format!("columns=trial_id,fvu&contact_count__gt=0&fvu__gte={least}");
    let found = trials(client, run, &select, |_| ()).await?;
    let fvu = |trial: &TrialFacts| trial.fvu.unwrap_or(f64::NEG_INFINITY);
    Ok(found.into_iter().max_by(|a, b| fvu(a).total_cmp(&fvu(b))))
}

/// The largest FVU of a trial with contacts is at least the largest mean of a bin of forces: few trials reach it.
fn worst_at_least(fit: &SimulationReport) -> Option<f64> {
    let bins = fit.by_force.iter().filter(|bin| bin.contacts.is_some_and(|count| count > 0));
    let largest = bins.map(|bin| bin.mean_fvu).max_by(f64::total_cmp)?;
    // A mean may be rounded above the values of which it is.
    Some(largest * (1.0 - 1e-9))
}

/// Returns the trials of a run that these parameters select, in the order of storing. `seen` receives their number.
async fn trials(
    client: &Client,
    run: RunUid,
    select: &str,
    mut seen: impl FnMut(u64),
) -> CliResult<Vec<TrialFacts>> {
    let (mut all, mut last) = (Vec::new(), 0);
    loop {
        let path = format!(
            "/api/v1/runs/{run}/trials?format=ndjson&{select}&trial_id__gt={last}&limit={MAX_PAGE}"
        );
        let text = client.text(&path).await?;
        let before = all.len();
        for line in text.lines().filter(|line| !line.is_empty()) {
            let trial: TrialFacts = serde_json::from_str(line).map_err(|error| {
                let detail = format!("a trial cannot be read: {error}");
                CliError::Refused { status: 200, detail, again: false }
            })?;
            all.push(trial);
        }
        seen(all.len() as u64);
        match all.last() {
            Some(trial) if all.len() - before == MAX_PAGE as usize => last = trial.trial_id,
            _ => return Ok(all),
        }
    }
}

/// Returns the numbers of runs, by their uids as text: a record names its run by the uid, a person by the number.
///
/// # Errors
/// As [`Client::send`].
pub async fn numbers_of(
    client: &Client,
    runs: impl Iterator<Item = RunUid>,
) -> CliResult<BTreeMap<String, i64>> {
    let mut numbers = BTreeMap::new();
    for uid in runs.map(|run| run.to_string()).collect::<BTreeSet<_>>() {
        let row: Option<RunRow> = client.if_there(&format!("/api/v1/runs/{uid}")).await?;
        numbers.extend(row.map(|row| (uid, row.scan_id)));
    }
    Ok(numbers)
}

/// How a run ended, or its state with the reason of a wait.
pub fn state_words(run: &RunRow) -> String {
    match run.exit_status {
        Some(status) => status.as_str().to_owned(),
        None => format!("{}{}", run.state, why_words(run.paused_why)),
    }
}

/// The reason of a wait, in brackets after the state; empty without one.
pub fn why_words(why: Option<PausedWhy>) -> String {
    why.map_or_else(String::new, |why| format!(" ({})", why.as_str().replace('_', " ")))
}

/// A number of tips, or of the weights of a run of manual trials.
pub fn tips_words(kind: RunKind, tips: u8) -> String {
    match kind {
        RunKind::RealRandom => counted(tips.into(), "weight", "weights"),
        RunKind::RealHex | RunKind::Imported => counted(tips.into(), "tip", "tips"),
    }
}

/// Stored trials by the number of tips or weights; `None` without a setting.
pub fn settings_words(summary: &Summary) -> Option<String> {
    let kind = summary.run.kind;
    let words = summary.settings.iter();
    let words =
        words.map(|of| format!("{} with {}", grouped(of.stored), tips_words(kind, of.tips)));
    let words: Vec<String> = words.collect();
    (!words.is_empty()).then(|| words.join(", "))
}

/// Wall time from the first start to the end, or to now while it is open; `None` before the start.
pub fn elapsed(run: &RunRow, now: Timestamp) -> Option<SignedDuration> {
    let is_active = run.exit_status.is_none() && run.state != StoredState::Interrupted;
    let end = run.ended_at.or(is_active.then_some(now))?;
    Some(end.duration_since(run.started_at?))
}

/// A duration for people.
pub fn duration_words(of: SignedDuration) -> String {
    duration(of.as_secs_f64())
}

/// Stored trials of the planned ones, without the plan where there is none.
pub fn stored_words(stored: u64, planned: u64) -> String {
    if planned == 0 {
        grouped(stored)
    } else {
        format!("{} of {}", grouped(stored), grouped(planned))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::repeat::tests::answers;
    use crate::evaluate::simulation::report;
    use crate::ids::TrialId;
    use crate::store::Fit;

    fn of_force(trial: i64, contact_count: u8, force_n: f64, fvu: f64) -> Fit {
        Fit {
            trial: TrialId(trial),
            tips: 1,
            contact_count,
            max_force_n: Some(force_n),
            single_tip_mm: None,
            flagged: false,
            rmse_v: 0.001,
            fvu: Some(fvu),
        }
    }

    #[tokio::test]
    async fn the_worst_fit_is_found_among_few_trials_and_without_the_query_engine() {
        let fits = [(1, 0, 0.2, 7.0), (2, 1, 2.2, 0.5), (3, 1, 2.4, 1.5), (4, 2, 9.0, 0.1)];
        let fit = report(&fits.map(|(trial, contacts, n, fvu)| of_force(trial, contacts, n, fvu)));
        let least = worst_at_least(&fit).unwrap();
        assert!(least <= 1.0 && least > 0.999, "the mean of 0.5 and 1.5: {least}");
        let lines = "{\"trial_id\":3,\"fvu\":1.5}\n{\"trial_id\":9,\"fvu\":1.2}\n";
        let head = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-length";
        let (url, heard) = answers(vec![format!("{head}: {}\r\n\r\n{lines}", lines.len())]).await;
        let client = Client::new(&url, None, None).unwrap();
        let worst = worst_fit(&client, RunUid::new(), &fit).await.unwrap().unwrap();
        assert_eq!((worst.trial_id, worst.fvu), (3, Some(1.5)));
        let asked = heard.await.unwrap().remove(0);
        assert!(asked.contains("fvu__gte=0.999") && !asked.contains("sort="), "{asked}");
        assert_eq!(worst_at_least(&report(&[])), None);
    }

    #[test]
    fn an_import_has_no_plan() {
        assert_eq!(stored_words(899, 33_000), "899 of 33,000");
        assert_eq!(stored_words(12, 0), "12");
    }

    #[test]
    fn a_trial_is_read_with_what_it_lacks() {
        let line = r#"{"trial_id":3,"forces_n":[1.5,null],"flags":[],"fvu":null}"#;
        let read: TrialFacts = serde_json::from_str(line).unwrap();
        assert_eq!((read.trial_id, read.forces_n), (3, vec![Some(1.5), None]));
        assert_eq!((read.fvu, read.depth_mm, read.measured_at), (None, None, None));
    }
}
