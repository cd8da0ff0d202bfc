//! `palpate status`, `pause`, `resume`, `stop`, `abort`: questions and requests to the service that drives the rig.
//! Uses: `client`. Never: a service in this process (it would have no rig and no run).

use clap::Args;
use jiff::Timestamp;
use reqwest::Method;
use serde_json::{Value, json};

use super::client::Client;
use super::error::{CliError, CliResult};
use super::find::find_run;
use super::next::Next;
use super::output::{counted, duration, grouped, say, say_json};
use super::times::second;
use super::view::{NeedView, StatusView};
use super::{At, embed, workers};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stopping::StoppingDistance;
use crate::campaign::shown::safe_end::{SafeEnd, Tips};
use crate::campaign::shown::status::RunStatus;
use crate::ids::RunUid;
use crate::state::PausedWhy;
use crate::store::{ActionRow, RunRow};

/// Number of newest actions among which the request of a latched e-stop is searched.
const ESTOP_AMONG_ACTIONS: usize = 100;

/// Options of a request to the active run.
#[derive(Debug, Clone, Args)]
pub struct ActArgs {
    /// Reason, for the log of actions.
    #[arg(long, value_name = "TEXT")]
    pub why: Option<String>,
    #[command(flatten)]
    pub at: At,
}

/// Options of `pause`.
#[derive(Debug, Clone, Args)]
pub struct PauseArgs {
    /// Raise the tips now, instead of after the trial.
    #[arg(long)]
    pub now: bool,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Options of `stop`.
#[derive(Debug, Clone, Args)]
pub struct StopArgs {
    /// Run: number, start of the id, or `last`; without it the active one. Any other is refused.
    pub run: Option<String>,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Options of `abort`.
#[derive(Debug, Clone, Args)]
pub struct AbortArgs {
    /// Run: number, start of the id, or `last`; without it the active one, or else a homing or a jog.
    pub run: Option<String>,
    #[command(flatten)]
    pub act: ActArgs,
}

/// Runs `palpate status`.
///
/// # Errors
/// `CliError` if the service cannot be reached.
pub async fn status(at: &At) -> CliResult<()> {
    let is_named = at.url().is_some();
    let client = embed::server(at).await.map_err(|error| no_status(error, is_named))?;
    if at.json {
        let status: Value = client.get("/api/v1/status").await?;
        say_json(&status);
        return Ok(());
    }
    let twins: Value = client.get("/api/v1/twins").await?;
    let workers = workers::line(&client).await;
    let status = client.status().await?;
    let estop = estop_words(&client, &status).await;
    say(status_words(&status, &twins, estop, workers));
    Ok(())
}

/// The error of `status`. `is_named`: a service was named, which `palpate runs` would ask, too.
fn no_status(error: CliError, is_named: bool) -> CliError {
    match error {
        CliError::NoServer { .. } if !is_named => CliError::NoStatus(Box::new(error)),
        error => error,
    }
}

/// Runs `palpate status --ready`.
///
/// # Errors
/// `CliError::Refused` with the cause if the service cannot store trials; others if it cannot be reached.
pub async fn ready(at: &At) -> CliResult<()> {
    let client = embed::server(at).await?;
    client.send(Method::GET, "/health/ready", None::<&Value>).await?;
    let words = format!("ready: {} can store trials", client.url());
    at.output().say(&json!({ "ready": true }), words);
    Ok(())
}

/// Runs `palpate metrics`.
///
/// # Errors
/// `CliError` if the service cannot be reached.
pub async fn metrics(at: &At) -> CliResult<()> {
    let text = embed::server(at).await?.text("/metrics").await?;
    at.output().say_whole(&json!({ "metrics": text }), text.trim_end());
    Ok(())
}

/// Sends an action that halts or ends the named run, or else the active one or the one that is about to be driven again
/// after a restart: it is carried out however late it comes.
///
/// # Errors
/// `CliError::Idle` if none is named and there is no such run, otherwise as [`find_run`]; other variants if the service
/// cannot be reached or refuses.
pub async fn act(args: &ActArgs, named: Option<&str>, action: &str, more: Value) -> CliResult<()> {
    let client = embed::server(&args.at).await?;
    let of = match named {
        Some(run) => ActedRun::from(&find_run(&client, run).await?),
        None => match client.status().await?.run {
            Some(run) => ActedRun::from(&run),
            None => {
                ActedRun::from(&client.find_run(RunRow::is_driven).await?.ok_or(CliError::Idle)?)
            }
        },
    };
    request(&client, of, args, action, more).await
}

/// Sends an action after which the active run continues; `more` are its other fields, of the run as it is read. The
/// service refuses it if it comes late.
///
/// # Errors
/// As [`act`].
pub async fn act_in_time(
    args: &ActArgs,
    action: &str,
    more: impl FnOnce(&RunStatus) -> Value,
) -> CliResult<()> {
    let client = embed::server(&args.at).await?;
    let status = client.status().await?;
    let run = status.run.ok_or(CliError::Idle)?;
    let more = more(&run);
    request(&client.acting_on(status.at), ActedRun::from(&run), args, action, more).await
}

/// The run of an action, as it was before.
#[derive(Debug, Clone, Copy)]
pub struct ActedRun {
    /// Id that the API knows it by.
    pub uid: RunUid,
    /// Number that people use.
    pub scan_id: i64,
    /// Why it is paused, if it is.
    pub paused_why: Option<PausedWhy>,
}

impl From<&RunRow> for ActedRun {
    fn from(run: &RunRow) -> Self {
        Self { uid: run.uid, scan_id: run.scan_id, paused_why: run.paused_why }
    }
}

impl From<&RunStatus> for ActedRun {
    fn from(run: &RunStatus) -> Self {
        Self { uid: run.uid, scan_id: run.scan_id, paused_why: run.paused_why }
    }
}

impl ActedRun {
    /// That an action was accepted, with what it changes where this is not its name.
    pub fn accepted(&self, action: &str) -> String {
        let change = match (action, self.paused_why) {
            ("pause", Some(PausedWhy::Trip)) => {
                "; a trip had paused it already: it does not resume automatically any more"
            }
            _ => "",
        };
        format!("run {}: {action} accepted{change}", self.scan_id)
    }
}

/// Sends an action on a run, and prints that it was accepted.
///
/// # Errors
/// As [`act`].
pub async fn request(
    client: &Client,
    of: ActedRun,
    args: &ActArgs,
    action: &str,
    mut more: Value,
) -> CliResult<()> {
    if let Some(why) = &args.why {
        more["why"] = why.clone().into();
    }
    client.act(of.uid, action, more).await?;
    let taken_up = json!({ "run": of.uid, "action": action, "taken_up": true });
    args.at.output().say(&taken_up, of.accepted(action));
    let (next, run) = (Next::of(&args.at), of.scan_id);
    let next = match (action, of.paused_why) {
        ("pause", Some(PausedWhy::Trip)) => {
            next.suggest("palpate status", "what it needs before it can resume")
        }
        ("pause", _) => next.suggest("palpate resume", "continues it"),
        ("resume", _) => next.suggest(format_args!("palpate attach {run}"), "follows it"),
        ("stop" | "abort", _) => {
            next.suggest(format_args!("palpate resume {run}"), "resumes it where it ended")
        }
        _ => next,
    };
    next.say();
    Ok(())
}

/// Runs `palpate pause`.
///
/// # Errors
/// As [`act`].
pub async fn pause(args: &PauseArgs) -> CliResult<()> {
    let when = if args.now { "now" } else { "checkpoint" };
    act(&args.act, None, "pause", json!({ "when": when })).await
}

/// Runs `palpate stop`.
///
/// # Errors
/// As [`act`]; also if the run is not the active one.
pub async fn stop(args: &StopArgs) -> CliResult<()> {
    act(&args.act, args.run.as_deref(), "stop", json!({})).await
}

/// Runs `palpate abort`.
///
/// # Errors
/// As [`act`].
pub async fn abort(args: &AbortArgs) -> CliResult<()> {
    match act(&args.act, args.run.as_deref(), "abort", json!({})).await {
        Err(CliError::Idle) => abort_motion(&args.act).await,
        done => done,
    }
}

/// Aborts a homing or a jog.
async fn abort_motion(args: &ActArgs) -> CliResult<()> {
    let client = embed::server(&args.at).await?;
    client.abort_motion(args.why.as_deref()).await?;
    let taken_up = json!({ "action": "abort", "taken_up": true });
    args.at.output().say(&taken_up, "abort of the motion accepted");
    Ok(())
}

/// Who requested the last e-stop, and why, while one is latched: it latches before a name is read. `None` without one, or
/// if the log of actions is not available.
async fn estop_words(client: &Client, status: &StatusView) -> Option<String> {
    status.rig.trip.as_ref().filter(|trip| trip.kind == TripKind::Estop)?;
    let newest = client.first::<ActionRow>("/api/v1/actions?", ESTOP_AMONG_ACTIONS).await;
    let is_stop = |action: &&ActionRow| action.accepted && action.action == "estop";
    newest.ok()?.0.iter().find(is_stop).map(requested_words)
}

fn requested_words(action: &ActionRow) -> String {
    let why = action.why.as_ref().map_or_else(String::new, |why| format!(": {why}"));
    format!("e-stop   last requested by {} at {}{why}", action.who, second(action.at))
}

fn status_words(
    status: &StatusView,
    twins: &Value,
    estop: Option<String>,
    workers: Option<String>,
) -> String {
    let rig = &status.rig;
    let (label, state) = (rig.label.as_str(), rig.state_words());
    let mut lines = status.answers();
    lines.push(format!("rig      {} ({label}): {state}", rig.name));
    lines.extend(estop);
    lines.extend(rig.safe_end.as_ref().map(safe_end_words));
    if let Some(p) = rig.pose {
        let (x, y, z, r) = (p.x_mm, p.y_mm, p.z_mm, p.radius_mm);
        lines.push(format!("pose     x {x:.2}  y {y:.2}  z {z:.2}  radius {r:.2} mm"));
    }
    let forces: Vec<String> =
        rig.forces_n.iter().map(|f| f.map_or("-".into(), |f| format!("{f:.2}"))).collect();
    if let Some(limit_n) = rig.force_limit_n.filter(|_| !forces.is_empty()) {
        lines.push(format!("forces   {} N (limit {limit_n:.0})", forces.join("  ")));
    }
    lines.extend(rig.stopping.as_ref().map(stopping_words));
    if let Some(lock) = &status.lock {
        lines.push(format!("lock     {}: {}", lock.holder, lock.note));
    }
    let run = status.run.as_ref().map(|run| run_words(run, &status.needs));
    lines.extend(run.unwrap_or_else(|| vec!["run      none".into()]));
    lines.extend(status.asked_of_run().map(|actions| format!("may      {actions}")));
    let waits = status.waiting_for.as_ref().map_or(String::new(), |words| format!("; {words}"));
    lines.extend(status.care.lines(Timestamp::now()));
    lines.push(format!("queue    {}{waits}", counted(status.queue_length as u64, "run", "runs")));
    lines.extend(twin_words(twins));
    lines.extend(workers);
    lines.push(format!("service  {}, {}", status.service.version, status.service.database));
    lines.join("\n")
}

fn safe_end_words(end: &SafeEnd) -> String {
    let tips = match &end.tips {
        Tips::Raised => "tips raised".into(),
        Tips::HeldByEstop => "tips not moved: the stop is latched".into(),
        Tips::NotHomed => "z has lost its zero: home, z moves up first".into(),
        Tips::NotRaised(why) => format!("TIPS NOT RAISED: {why}"),
    };
    let missing: Vec<&str> =
        end.stops.iter().filter(|s| !s.is_done()).map(|s| s.axis.as_str()).collect();
    let axes = match missing.is_empty() {
        true => "every axis stopped".into(),
        false => format!("NOT STOPPED: {}", missing.join(", ")),
    };
    format!("safe end: {axes}, {tips}, {:.0} ms", end.took_ms)
}

fn stopping_words(d: &StoppingDistance) -> String {
    let measured = match (d.measured_ms, d.measured_mm) {
        (Some(ms), Some(mm)) => format!("measured {ms:.1} ms and {mm:.2} mm at most"),
        (Some(ms), None) => format!("measured {ms:.1} ms at most"),
        _ => "none measured yet".into(),
    };
    let stops = match d.stops {
        0 => String::new(),
        stops => format!(" in {}", counted(stops, "stop", "stops")),
    };
    format!(
        "stopping {:.1} ms, {:.2} mm at {:.2} mm/s; {measured}{stops}\n\
         margin   +{:.1} N of {:.1} N on a tip, +{:.1} N of {:.1} N on {}; +{:.0} N per tip on the stiffest skin",
        d.sample_to_stop_ms,
        d.travel_mm,
        d.speed_mm_s,
        d.added_n,
        d.margin_n,
        d.added_sum_n,
        d.margin_sum_n,
        counted(d.tips.into(), "tip", "tips"),
        d.added_steepest_n,
    )
}

/// Simulated twins of the newest run with trials, as text.
fn twin_words(twins: &Value) -> Option<String> {
    let newest = twins["runs"].get(0)?;
    let (trials, pending) = (newest["trials"].as_u64()?, newest["pending"].as_u64()?);
    let fit = twins["pool"]["rolling"]["median_fvu"].as_f64();
    let fit = fit.map_or_else(String::new, |fvu| format!(", recent median FVU {fvu:.2}"));
    let failed = twins["pool"]["last_error"].as_str();
    let failed = failed.map_or_else(String::new, |why| format!("; {why}"));
    let (made, trials) = (grouped(trials - pending), grouped(trials));
    Some(format!("twins    {made} of {trials} of the newest run{fit}{failed}"))
}

/// The active run, as text. What it waits for is a line only if no need states it.
fn run_words(run: &RunStatus, needs: &[NeedView]) -> Vec<String> {
    let requested =
        run.requested_state.as_ref().map_or_else(String::new, |r| format!(", requested {r}"));
    let (id, name, state) = (run.scan_id, &run.experiment, &run.state);
    let mut lines = vec![format!("run      {id}, {name}: {state}{requested}")];
    let is_needed = |words: &str| needs.iter().any(|need| need.words.contains(words));
    if let Some(words) = run.waiting_for.as_ref().filter(|words| !is_needed(words)) {
        lines.push(format!("waits    {words}"));
    }
    let retries = counted(run.retries, "retry", "retries");
    lines.push(format!(
        "trials   {} of {}, {} skipped, {retries}",
        grouped(run.trials_stored),
        grouped(run.trials_planned),
        grouped(run.trials_skipped)
    ));
    if let Some(eta) = run.eta {
        let (low, high) = (duration(eta.low_s), duration(eta.high_s));
        lines.push(match eta.remaining_s {
            ..1.0 => "done in  less than 1 s".into(),
            remaining_s => format!("done in  {} ({low} .. {high})", duration(remaining_s)),
        });
    }
    lines
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[test]
    fn a_pause_after_a_trip_states_what_it_changes() {
        let of = |paused_why| ActedRun { uid: RunUid::new(), scan_id: 3, paused_why };
        let words = "run 3: pause accepted; a trip had paused it already: it does not resume automatically any more";
        assert_eq!(of(Some(PausedWhy::Trip)).accepted("pause"), words);
        assert_eq!(of(Some(PausedWhy::Trip)).accepted("stop"), "run 3: stop accepted");
        assert_eq!(of(None).accepted("pause"), "run 3: pause accepted");
    }

    #[test]
    fn status_without_a_service_names_the_command_that_needs_none() {
        let words = |is_named| {
            let url = "http://127.0.0.1:8080".to_owned();
            no_status(CliError::NoServer { url }, is_named).to_string()
        };
        let none = "no palpate service at http://127.0.0.1:8080; start one with `palpate serve`, or name it with --url \
                    or PALPATE_URL";
        assert_eq!(words(true), none);
        let runs = "`palpate runs` reads a data folder without a service";
        assert_eq!(words(false), format!("{none}; {runs}"));
    }

    #[test]
    fn the_person_who_requested_an_e_stop_is_named_with_the_reason() {
        let mut action = json!({ "id": 7, "at": "2026-11-23T00:00:00Z", "run": null, "action": "estop",
            "who": "ada (local)", "key_id": null, "why": "to rehearse it", "accepted": true, "detail": null });
        let words = |action: &Value| requested_words(&ActionRow::deserialize(action).unwrap());
        let at = second("2026-11-23T00:00:00Z".parse().unwrap());
        let named = format!("e-stop   last requested by ada (local) at {at}");
        assert_eq!(words(&action), format!("{named}: to rehearse it"));
        action["why"] = Value::Null;
        assert_eq!(words(&action), named);
    }

    #[test]
    fn what_a_run_waits_for_is_stated_once() {
        let run = json!({
            "uid": "01a208ed-3612-760c-9dff-1d5fb515cdf8", "scan_id": 3, "experiment": "night",
            "is_manual": false, "state": "paused", "phase": "wait", "trials_planned": 33_000,
            "trials_stored": 16_403, "trials_skipped": 0, "retries": 1, "needed_bytes": 0,
            "waiting_for": "arm 2: 81.0 N over 80.0 N",
        });
        let run = RunStatus::deserialize(&run).unwrap();
        let need = json!({ "importance": "act", "command": null, "since": null,
            "words": "Tripped (force): arm 2: 81.0 N over 80.0 N. Clear the cause, reset, then home." });
        let need = NeedView::deserialize(&need).unwrap();
        let trials = "trials   16,403 of 33,000, 0 skipped, 1 retry";
        assert_eq!(run_words(&run, &[need]), ["run      3, night: paused", trials]);
        let waits = "waits    arm 2: 81.0 N over 80.0 N";
        assert_eq!(run_words(&run, &[]), ["run      3, night: paused", waits, trials]);
    }
}
