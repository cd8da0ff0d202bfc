//! `palpate show RUN --history`: a run over time, in intervals of equal length, and its states.
//! Uses: `client`, `table`. Never: a change.

use jiff::{SignedDuration, Timestamp};
use serde_json::Value;

use super::answers::{duration_words, why_words};
use crate::api::{History, StateSpan};
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::find::find_run;
use crate::cli::output::{Output, duration, grouped, say, say_json};
use crate::cli::table::{Table, or_dash};
use crate::cli::times::second;
use crate::state::{PausedWhy, StoredState};

/// Number of intervals of the table.
const INTERVALS: usize = 24;

/// Shows the history of a run.
///
/// # Errors
/// `CliError` if there is no such run, or a request fails.
pub async fn show(client: &Client, run: &str, output: Output) -> CliResult<()> {
    let run = find_run(client, run).await?;
    let path = format!("/api/v1/runs/{}/history", run.uid);
    if output == Output::Json {
        say_json(&client.get::<Value>(&path).await?);
        return Ok(());
    }
    let history: History = client.get(&format!("{path}?bins={INTERVALS}")).await?;
    let (Some(from), Some(to), Some(bin_s)) = (history.from, history.to, history.bin_s) else {
        say(format_args!("run {}, {}: it has not started", run.scan_id, run.experiment));
        return Ok(());
    };
    let predicted = history.predicted_s.map(|s| format!(", predicted {}", duration(s)));
    say(format_args!(
        "run {}, {}: {} to {}, {}{}\n",
        run.scan_id,
        run.experiment,
        second(from),
        second(to),
        duration_words(to.duration_since(from)),
        predicted.unwrap_or_default()
    ));
    say(intervals(&history, from, bin_s));
    say("");
    say(states(&history.states));
    Ok(())
}

fn intervals(history: &History, from: Timestamp, bin_s: f64) -> Table {
    let mut table = Table::new(
        "from | trials> | failed attempts> | largest force, N> | median FVU>",
        "no interval",
    );
    for (n, trials) in history.trials.iter().enumerate() {
        let after = SignedDuration::try_from_secs_f64(n as f64 * bin_s).ok();
        let begin = after.and_then(|after| from.checked_add(after).ok());
        let number = |values: &[Option<f64>], digits: usize| {
            or_dash(values.get(n).copied().flatten().map(|value| format!("{value:.digits$}")))
        };
        table.push([
            or_dash(begin.map(second)),
            grouped((*trials).into()),
            or_dash(history.attempts_failed.get(n).map(|failed| grouped((*failed).into()))),
            number(&history.largest_force_n, 1),
            number(&history.fvu, 3),
        ]);
    }
    table
}

/// The states; those of consecutive manual trials, which pause and run in turn, are one row.
fn states(spans: &[StateSpan]) -> Table {
    let mut rows: Vec<(String, Timestamp, Option<Timestamp>)> = Vec::new();
    let mut is_placing = false;
    for span in spans {
        let is_placement = span.why == Some(PausedWhy::ManualTrial);
        let continues = is_placing && (is_placement || span.state == StoredState::Running);
        if let Some(row) = rows.last_mut().filter(|_| continues) {
            row.2 = span.to;
            continue;
        }
        is_placing = is_placement;
        let state = match is_placement {
            true => "manual trials".to_owned(),
            false => format!("{}{}", span.state.as_str(), why_words(span.why)),
        };
        rows.push((state, span.from, span.to));
    }
    let mut table = Table::new("state | from | to", "no change of state is stored");
    for (state, from, to) in rows {
        table.push([state, second(from), or_dash(to.map(second))]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_without_a_measured_value_has_a_dash() {
        let history = History {
            trials: vec![4321, 0],
            attempts_failed: vec![0, 2],
            largest_force_n: vec![Some(9.54), None],
            fvu: vec![None, None],
            ..History::default()
        };
        let from = "2026-11-24T22:00:00Z".parse().unwrap();
        let table = intervals(&history, from, 60.0).to_string();
        let ends: Vec<Vec<&str>> =
            table.lines().skip(1).map(|line| line.split_whitespace().skip(2).collect()).collect();
        assert_eq!(ends, [["4,321", "0", "9.5", "-"], ["0", "2", "-", "-"]]);
        let lasts = StateSpan { state: StoredState::Running, why: None, from, to: None };
        assert!(states(&[lasts]).to_string().ends_with('-'));
    }

    #[test]
    fn manual_trials_are_one_row_until_another_pause() {
        let at = |minutes: i64| Timestamp::from_second(1_790_000_000 + 60 * minutes).unwrap();
        let span = |state, why, minutes| StateSpan {
            state,
            why,
            from: at(minutes),
            to: Some(at(minutes + 1)),
        };
        let (running, paused) = (StoredState::Running, StoredState::Paused);
        let placed = Some(PausedWhy::ManualTrial);
        let operator = Some(PausedWhy::Operator);
        let spans = [
            span(running, None, 0),
            span(paused, placed, 1),
            span(running, None, 2),
            span(paused, placed, 3),
            span(running, None, 4),
            span(paused, operator, 5),
            span(running, None, 6),
        ];
        let table = states(&spans).to_string();
        let names: Vec<&str> =
            table.lines().skip(1).filter_map(|line| line.split("  ").next()).collect();
        assert_eq!(names, ["running", "manual trials", "paused (operator)", "running"]);
        let manual = table.lines().nth(2).unwrap();
        assert!(manual.ends_with(&second(at(5))), "{table}");
    }
}
