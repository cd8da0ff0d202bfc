//! The beginning of a run: the rig is brought up, the run is armed and started.
//! Uses: `client`. Never: the rig (the service has it).

use std::io::{BufRead, IsTerminal};
use std::time::Duration;

use clap::Args;
use jiff::Timestamp;
use serde_json::json;

use super::ask::{ActArgs, ActedRun, request};
use super::client::Client;
use super::embed;
use super::error::{CliError, CliResult};
use super::find::find_run;
use super::next::Next;
use super::output::{self, grouped};
use super::rig::{end_motion, until_rig};
use super::signals::Signals;
use super::view::{ArmedView, PreflightView, StatusView, TakenUpView};
use crate::api::STATUS_AGE_MAX;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::travel::HOMING_WAIT;
use crate::conductor::Started;
use crate::journal::ExitStatus;
use crate::record::Label;
use crate::state::StoredState;
use crate::store::RunRow;

/// Longest wait for the wires of a rig.
const CONNECTING: Duration = Duration::from_secs(60);

/// Option of the commands that move a rig.
#[derive(Debug, Clone, Copy, Args)]
pub struct MotionArgs {
    /// Move a real rig without asking at the terminal.
    #[arg(long, short)]
    pub yes: bool,
}

/// Options of `resume`.
#[derive(Debug, Clone, Args)]
pub struct ResumeArgs {
    /// A run that was stopped or interrupted: number, start of the id, or `last`; without it the paused run, or
    /// else the last one that can be resumed.
    pub run: Option<String>,
    #[command(flatten)]
    pub motion: MotionArgs,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Runs `palpate resume`.
///
/// # Errors
/// `CliError::NothingToResume` if there is no such run; others if the service cannot be reached or refuses, or
/// the motion of a real rig is not confirmed.
pub async fn resume(args: &ResumeArgs) -> CliResult<()> {
    let client = embed::server(&args.act.at).await?;
    let status = client.status().await?;
    let active = status.run.clone();
    let named = match &args.run {
        Some(run) => Some(find_run(&client, run).await?),
        None if active.is_some() => None,
        None => Some(client.find_run(goes_on).await?.ok_or(CliError::NothingToResume)?),
    };
    let paused = active.filter(|active| named.as_ref().is_none_or(|run| run.uid == active.uid));
    if let Some(run) = paused {
        // A person may have come to the rig since it was paused. A skin alone does not move.
        let status = match status.rig.has_stage {
            true => confirm_motion(&client, args.motion, status).await?,
            false => status,
        };
        let client = client.acting_on(status.at);
        return request(&client, ActedRun::from(&run), &args.act, "resume", json!({})).await;
    }
    let Some(run) = named else { return Err(CliError::NothingToResume) };
    let stored = client.summary(run.uid).await?.trials_stored;
    let (mut signals, mut homes) = (Signals::catch()?, false);
    let beginning = async {
        bring_up(&client, args.motion, &mut homes).await?;
        arm_and_start(&client, &run).await
    };
    let begun = signals.during(beginning).await;
    end_motion(&client, homes, &begun).await;
    let begun = begun?;
    let (scan_id, stored, planned) = (run.scan_id, grouped(stored), grouped(run.trials_planned));
    let when = if begun.waiting { "resumes when the active run has ended," } else { "resumes" };
    args.act.at.output().say(
        &json!({ "run": run.uid, "action": "resume", "taken_up": true }),
        format_args!("run {scan_id} {when} at {stored} of {planned} trials"),
    );
    Next::of(&args.act.at).suggest(format_args!("palpate attach {scan_id}"), "follows it").say();
    Ok(())
}

/// Whether a run resumes without being named: it was stopped or interrupted. One that was aborted or has failed
/// is resumed by its number only.
pub fn goes_on(run: &RunRow) -> bool {
    run.state == StoredState::Interrupted || run.exit_status == Some(ExitStatus::Stopped)
}

/// Connects and homes the rig, if it is not connected or homed, and returns the status. A skin alone has
/// nothing to home. `homes`: set while the rig homes for it.
///
/// # Errors
/// `CliError` if the rig cannot be brought up, is tripped, or its motion is not confirmed.
pub async fn bring_up(
    client: &Client,
    motion: MotionArgs,
    homes: &mut bool,
) -> CliResult<StatusView> {
    let mut status = client.status().await?;
    if status.run.is_some() {
        return Ok(status);
    }
    if status.rig.state == RigState::Disconnected {
        client.act_on_rig("connect", json!({})).await?;
        status = until_rig(client, "connecting the rig", CONNECTING, false, |s| {
            s.rig.state != RigState::Disconnected
        })
        .await?;
    }
    if status.rig.state == RigState::Tripped {
        return Err(CliError::Tripped { detail: status.rig.trip_words() });
    }
    if !status.rig.has_stage {
        return Ok(status);
    }
    status = confirm_motion(client, motion, status).await?;
    if status.rig.state == RigState::Disarmed {
        *homes = true;
        client.act_on_rig("home", json!({})).await?;
        status =
            until_rig(client, "homing", HOMING_WAIT, true, |s| s.rig.state != RigState::Disarmed)
                .await?;
        *homes = false;
    }
    Ok(status)
}

/// Asks for the confirmation that a real rig may move; returns the status after it.
async fn confirm_motion(
    client: &Client,
    motion: MotionArgs,
    status: StatusView,
) -> CliResult<StatusView> {
    if motion.yes || status.rig.label == Label::Virtual {
        return Ok(status);
    }
    let rig = status.rig.name.clone();
    if !std::io::stdin().is_terminal() {
        return Err(CliError::NotConfirmed { rig });
    }
    let label = status.rig.label.as_str();
    let within_s = STATUS_AGE_MAX.as_secs();
    output::ask(format_args!(
        "rig {rig} ({label}) will move. Is it clear? [y/N, within {within_s} s] "
    ));
    // A separate thread, so that Ctrl-C is handled meanwhile.
    let answer = tokio::task::spawn_blocking(entered_line);
    if !matches!(answer.await, Ok(Ok(answer)) if matches!(answer.trim(), "y" | "yes")) {
        return Err(CliError::NotConfirmed { rig });
    }
    let now = client.status().await?;
    answered_in_time(rig, status.at, now.at)?;
    Ok(now)
}

/// Checks that an answer came soon after its question: a terminal that was silent may deliver one long after it was
/// entered, when a person may be at the rig. `asked`, `now`: times of the service, which an older one does not state.
fn answered_in_time(
    rig: String,
    asked: Option<Timestamp>,
    now: Option<Timestamp>,
) -> CliResult<()> {
    let (Some(asked), Some(now)) = (asked, now) else { return Ok(()) };
    let (after_s, limit_s) = (now.duration_since(asked).as_secs_f64(), STATUS_AGE_MAX.as_secs());
    // Earlier: another process of the service.
    if (0.0..=limit_s as f64).contains(&after_s) {
        return Ok(());
    }
    Err(CliError::ConfirmedLate { rig, after_s, limit_s })
}

/// Reads a line from standard input; waits for it.
///
/// # Errors
/// The operating system's.
pub fn entered_line() -> std::io::Result<String> {
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).map(|_| line)
}

/// A run that was started.
pub struct Begun {
    /// Number of the last event before it.
    pub since: i64,
    /// Whether it waits for another run or for its time.
    pub waiting: bool,
    /// Its preflight: number of trials, duration, disk space.
    pub preflight: PreflightView,
}

/// Arms and starts a run.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses.
pub async fn arm_and_start(client: &Client, run: &RunRow) -> CliResult<Begun> {
    let since = last_event(client, run).await?;
    let (path, who) = (format!("/api/v1/runs/{}", run.uid), client.who());
    let armed: ArmedView = client.post(&format!("{path}/arm"), &json!({ "who": who })).await?;
    let start = json!({ "action": "start", "code": armed.code, "who": who });
    let client = client.acting_now().await?;
    let taken: TakenUpView = client.post(&format!("{path}/actions"), &start).await?;
    let waiting = taken.started == Some(Started::Waiting);
    Ok(Begun { since, waiting, preflight: armed.preflight })
}

/// Number of the last event of a run; 0 without one.
///
/// # Errors
/// `CliError` if the service cannot be reached.
pub async fn last_event(client: &Client, run: &RunRow) -> CliResult<i64> {
    // A negative number counts from the end.
    let newest = client.events(run.uid, -1).await?;
    Ok(newest.items.last().map_or(0, |last| last.seq))
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;

    #[test]
    fn an_answer_long_after_its_question_does_not_confirm_a_motion() {
        let asked = Timestamp::constant(1_795_000_000, 500_000_000);
        let refusal = |after_ms: i64| {
            let now = asked + SignedDuration::from_millis(after_ms);
            answered_in_time("lab".into(), Some(asked), Some(now)).err().map(|e| e.to_string())
        };
        assert_eq!([0, 9_999, 10_000].map(refusal), [None, None, None]);
        let words = refusal(190_000).unwrap();
        assert!(words.contains("rig lab") && words.contains("190 s"), "{words}");
        assert!(refusal(-1).is_some(), "of another process");
        assert!(answered_in_time("lab".into(), None, None).is_ok(), "an older service");
    }
}
