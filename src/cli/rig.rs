//! `palpate rig`: manual check, connection, homing, jog, tare, reset, limits and wear.
//! Uses: `client`; for a check of a file `api::LockFile` and `campaign::check`. Never: motion in this
//! process.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::time::{Instant, sleep};

use super::care::wear_words;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::files::RigFiles;
use super::output::{Output, counted, note, say, say_json};
use super::progress::Working;
use super::signals::Signals;
use super::view::StatusView;
use super::{At, embed, rig_facts};
use crate::api::LockFile;
use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::travel::HOMING_WAIT;
use crate::campaign::check::{self, Scope};
use crate::campaign::shown::status::RigStatus;
use crate::record::{ARMS, Pose};
use crate::store::ActionRow;

/// Longest wait for the wires, for a tare, and for actions without motion.
const SOON: Duration = Duration::from_secs(60);
/// Longest wait for a jog.
const JOGGING: Duration = Duration::from_secs(120);
/// What is shown while a rig is checked.
const CHECKING: &str = "checking every device";
/// Interval of polling the rig.
const RIG_POLL: Duration = Duration::from_millis(100);
/// A jog has arrived when the axis is this close, mm.
const ARRIVED_MM: f64 = 0.2;
/// Time without the motion after which it counts as over: the rig shows its result a moment after its end.
const MOTION_OVER: Duration = Duration::from_secs(2);
/// Name of an abort of a motion in the log of actions.
const ABORT_ACTION: &str = "rig_abort";
/// Number of logged actions among which the last motion is searched.
const NEWEST_ACTIONS: usize = 50;
/// Attempts to abort a motion that is left, and the pause between them: its request may arrive after the first one.
const ABORT_TRIES: u32 = 5;
const ABORT_POLL: Duration = Duration::from_millis(200);
/// Reason of such an abort.
const LEFT: &str = "the command that moves the rig was ended";

/// Options of `rig`.
#[derive(Debug, Clone, Args)]
pub struct RigArgs {
    /// Manual action.
    #[command(subcommand)]
    pub command: RigCommand,
    #[command(flatten)]
    pub at: At,
}

/// Manual actions on a rig.
#[derive(Debug, Clone, Subcommand)]
pub enum RigCommand {
    /// Check every device and report what is found; nothing moves, nothing is switched on.
    ///
    /// With a rig file this command opens its wires, unless another process holds that rig; without
    /// one the service does the check.
    Check {
        /// Rig file [default: the rig of the service].
        #[arg(value_name = "RIG.toml")]
        file: Option<PathBuf>,
        /// Also take control of the drives and switch their servos on; they stay on.
        #[arg(long)]
        enable: bool,
    },
    /// Open the rig's wires.
    Connect,
    /// Close the rig's wires.
    Disconnect,
    /// Home every axis, z first.
    Home,
    /// Move one axis to a position.
    Jog {
        /// Axis to move.
        #[arg(value_enum)]
        axis: AxisName,
        /// Absolute target, mm.
        #[arg(allow_negative_numbers = true)]
        to_mm: f64,
    },
    /// Read the load cells' zeros; in a manual run, the offsets of the empty skin.
    ///
    /// The zeros of the cells are read only while z is homed, at rest and clear of the skin.
    Tare,
    /// State the number of mounted tips, on arms 1 to n; the cells must not contradict.
    Tips {
        /// Number of tips.
        #[arg(value_parser = clap::value_parser!(u8).range(0..=ARMS as i64))]
        tips: u8,
    },
    /// Acknowledge a trip.
    Reset,
    /// Show the limits that trip the rig, and the ranges of its axes.
    Limits,
    /// Show what the voltage stream and the wires did in the last minute.
    Rates,
    /// Show the ranges of forces and z of the last minutes; --json prints the samples.
    Samples {
        /// Length of the time before now, minutes, 1 to 30.
        #[arg(long, value_name = "N", default_value_t = 5)]
        #[arg(value_parser = clap::value_parser!(u8).range(1..=30))]
        minutes: u8,
    },
    /// Show when the untouched skin was last measured, and its voltages; --json prints the frame.
    Untouched,
    /// Show presses on the skin, travel of the axes, age of the cells' calibrations, the last check.
    Wear,
}

/// Axes of a jog.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum AxisName {
    /// Along the skin's width.
    X,
    /// Along the skin's height.
    Y,
    /// Downward, from the raised position 0.
    Z,
    /// Spread of the arms.
    Radius,
}

impl AxisName {
    fn of(self, pose: &Pose) -> f64 {
        match self {
            AxisName::X => pose.x_mm,
            AxisName::Y => pose.y_mm,
            AxisName::Z => pose.z_mm,
            AxisName::Radius => pose.radius_mm,
        }
    }
}

/// Runs `palpate rig`.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses, the rig trips, or a deadline passes.
pub async fn rig(args: RigArgs) -> CliResult<ExitCode> {
    let RigArgs { command, at } = args;
    if let RigCommand::Check { file, enable } = command {
        return match file {
            Some(file) => check_file(&file, enable, at.json).await,
            None => check_server(&at, enable).await,
        };
    }
    operate(&embed::server(&at).await?, command, at.output()).await?;
    Ok(ExitCode::SUCCESS)
}

async fn operate(client: &Client, command: RigCommand, output: Output) -> CliResult<()> {
    let status = match command {
        RigCommand::Wear => {
            let wear: Value = client.get("/api/v1/wear").await?;
            output.say(&wear, wear_words(&wear));
            return Ok(());
        }
        RigCommand::Limits => return rig_facts::limits(client, output).await,
        RigCommand::Rates => return rig_facts::rates(client, output).await,
        RigCommand::Samples { minutes } => {
            return rig_facts::samples(client, minutes, output).await;
        }
        RigCommand::Untouched => return rig_facts::untouched(client, output).await,
        RigCommand::Check { .. } => client.status().await?,
        RigCommand::Connect => {
            client.act_on_rig("connect", json!({})).await?;
            until_rig(client, "connecting", SOON, false, |s| s.rig.state != RigState::Disconnected)
                .await?
        }
        RigCommand::Disconnect => {
            client.act_on_rig("disconnect", json!({})).await?;
            until_rig(client, "closing the wires", SOON, false, |s| {
                s.rig.state == RigState::Disconnected
            })
            .await?
        }
        RigCommand::Home => {
            let homes = async {
                client.act_on_rig("home", json!({})).await?;
                until_rig(client, "homing", HOMING_WAIT, true, |s| s.rig.state == RigState::Homed)
                    .await
            };
            moved(client, homes).await?
        }
        RigCommand::Jog { axis, to_mm } => {
            let more = json!({ "axis": axis, "to_mm": to_mm });
            let there = |s: &StatusView| {
                s.rig.pose.is_some_and(|p| (axis.of(&p) - to_mm).abs() < ARRIVED_MM)
            };
            let jogs = async {
                client.act_on_rig("jog", more).await?;
                until_rig(client, "the jog's arrival", JOGGING, true, there).await
            };
            moved(client, jogs).await?
        }
        RigCommand::Tare => {
            client.act_on_rig("tare", json!({})).await?;
            client.status().await?
        }
        RigCommand::Tips { tips } => {
            client.act_on_rig("tips", json!({ "tips": tips })).await?;
            client.status().await?
        }
        RigCommand::Reset => {
            client.act_on_rig("reset", json!({})).await?;
            until_rig(client, "the reset", SOON, false, |s| s.rig.trip.is_none()).await?
        }
    };
    match output {
        Output::Json => say_json(&client.get::<Value>("/api/v1/status").await?["rig"]),
        Output::Text => say(rig_words(&status.rig)),
    }
    Ok(())
}

/// Carries out a motion of this command; a signal that ends the command ends it, too.
async fn moved(
    client: &Client,
    motion: impl Future<Output = CliResult<StatusView>>,
) -> CliResult<StatusView> {
    let done = Signals::catch()?.during(motion).await;
    end_motion(client, true, &done).await;
    done
}

/// Aborts a homing or a jog that a signal has left: the axes stop, then the tips rise. `moves`: whether the rig
/// moves for the command. `done`: how that ended.
pub async fn end_motion<T>(client: &Client, moves: bool, done: &CliResult<T>) {
    if !moves || !matches!(done, Err(CliError::Interrupted)) {
        return;
    }
    note("aborting the motion: raising the tips now");
    for left in (0..ABORT_TRIES).rev() {
        match client.abort_motion(Some(LEFT)).await {
            Ok(()) => return,
            Err(CliError::Refused { .. }) if left > 0 => sleep(ABORT_POLL).await,
            Err(error) => {
                let words = "palpate estop stops every axis";
                return note(format_args!("the motion is not aborted: {error}; {words}"));
            }
        }
    }
}

/// What polls have seen of a motion.
#[derive(Debug, Default)]
struct MotionSeen {
    moved: bool,
    /// First poll without it since.
    over_since: Option<Instant>,
}

impl MotionSeen {
    /// Returns who ended the motion, once it has been over for a while.
    async fn ended_by(&mut self, client: &Client, status: &StatusView) -> Option<String> {
        if status.rig.motion.is_some() {
            *self = Self { moved: true, over_since: None };
            return None;
        }
        if self.over_since.get_or_insert_with(Instant::now).elapsed() < MOTION_OVER {
            return None;
        }
        // Also a motion that ended before the first poll; an older service shows none.
        self.over_since = None;
        let by = aborted_by(client).await;
        by.or_else(|| self.moved.then(|| "no abort of it is logged".into()))
    }
}

/// Who aborted the last homing or jog, and why; none if it was not aborted.
async fn aborted_by(client: &Client) -> Option<String> {
    let (newest, _) = client.first::<ActionRow>("/api/v1/actions?", NEWEST_ACTIONS).await.ok()?;
    let is_of_motion = |act: &ActionRow| {
        act.accepted && ["home", "jog", ABORT_ACTION].contains(&act.action.as_str())
    };
    let last = newest.into_iter().find(is_of_motion).filter(|act| act.action == ABORT_ACTION)?;
    let why = last.why.map_or_else(String::new, |why| format!(" ({why})"));
    Some(format!("{} aborted it{why}", last.who))
}

/// Polls the rig until `wanted` accepts its status. `moves`: whether a homing or a jog was requested just before.
///
/// # Errors
/// `CliError::Tripped` after a trip; `Late` after the deadline; `MotionEnded` if a motion ended otherwise, such as by
/// an abort of another person; other variants if a request fails.
pub async fn until_rig(
    client: &Client,
    what: &str,
    deadline: Duration,
    moves: bool,
    wanted: impl Fn(&StatusView) -> bool,
) -> CliResult<StatusView> {
    let asked = Instant::now();
    let mut motion = moves.then(MotionSeen::default);
    let _shown = Working::on(&format!("rig: {what}"));
    loop {
        let status = client.status().await?;
        if status.rig.state == RigState::Tripped && status.rig.trip.is_some() {
            return Err(CliError::Tripped { detail: status.rig.trip_words() });
        }
        if wanted(&status) {
            return Ok(status);
        }
        if let Some(motion) = &mut motion
            && let Some(by) = motion.ended_by(client, &status).await
        {
            return Err(CliError::MotionEnded { what: what.into(), by });
        }
        if asked.elapsed() > deadline {
            return Err(CliError::Late { what: what.into(), after_s: deadline.as_secs() });
        }
        sleep(RIG_POLL).await;
    }
}

async fn check_file(file: &std::path::Path, enable: bool, json: bool) -> CliResult<ExitCode> {
    let rig = RigFiles::read(Some(file))?;
    let _held = LockFile::of_rig(&rig.config)?;
    let scope = if enable { Scope::Enable } else { Scope::Look };
    // No service holds this rig, so no request reaches this check: a signal is its emergency stop.
    let (estop, mut signals) = (StopSwitch::default(), Signals::catch()?);
    let pressed = estop.clone();
    let stop = tokio::spawn(async move {
        loop {
            signals.next().await;
            pressed.press("a signal");
        }
    });
    let shown = Working::on(CHECKING);
    let report = check::run_on(&rig.config, &estop, scope).await;
    drop(shown);
    stop.abort();
    let report = report?;
    if json {
        say_json(&report);
    } else {
        say(report.to_string().trim_end());
        say_how_to_enable(!report.unchecked.is_empty() && !enable);
    }
    verdict(report.problems.len(), json)
}

async fn check_server(at: &At, enable: bool) -> CliResult<ExitCode> {
    let client = embed::server(at).await?;
    let asked = json!({ "enable": enable, "who": client.who() });
    let shown = Working::on(CHECKING);
    let report: Value = client.acting_now().await?.post("/api/v1/rig/check", &asked).await?;
    drop(shown);
    if at.json {
        say_json(&report);
    } else {
        say(report_words(&report));
        let unchecked = report["unchecked"].as_array().is_some_and(|list| !list.is_empty());
        say_how_to_enable(unchecked && !enable);
    }
    verdict(report["problems"].as_array().map_or(0, Vec::len), at.json)
}

fn say_how_to_enable(wanted: bool) {
    if wanted {
        say("Use --enable to take control of the drives and switch their servos on.");
    }
}

fn verdict(problems: usize, json: bool) -> CliResult<ExitCode> {
    match problems {
        0 => Ok(ExitCode::SUCCESS),
        _ if json => Ok(ExitCode::FAILURE),
        n => Err(CliError::Unsound(n)),
    }
}

/// Summary of the service's report; `--json` prints all of it.
fn report_words(report: &Value) -> String {
    let text = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Null => "-".into(),
        other => other.to_string(),
    };
    let number = |value: &Value, decimals: usize| {
        value.as_f64().map_or_else(|| "-".into(), |number| format!("{number:.decimals$}"))
    };
    let mut lines = vec![format!("rig {} ({})", text(&report["rig"]), text(&report["label"]))];
    for axis in report["axes"].as_array().into_iter().flatten() {
        lines.push(format!(
            "  {:<7} {} {}, {}",
            text(&axis["name"]),
            number(&axis["position"], 2),
            text(&axis["unit"]),
            // With what it is, and whether it is homed.
            text(&axis["identity"]),
        ));
    }
    let (cells, stream) = (&report["cells"], &report["stream"]);
    if !cells.is_null() {
        let (live, identity) = (text(&cells["live"]), text(&cells["identity"]));
        lines.push(format!("  cells   {live} live, {identity}"));
    }
    let (rate, noise) = (number(&stream["frame_rate_hz"], 1), number(&stream["noise_sd_v"], 5));
    lines.push(format!("  ert     {rate} frames/s, noise sd {noise} V"));
    for (mark, list) in [("WRONG", "problems"), ("NOT CHECKED", "unchecked")] {
        for words in report[list].as_array().into_iter().flatten() {
            lines.push(format!("{mark}  {}", text(words)));
        }
    }
    lines.join("\n")
}

/// State, entered tips and position, as text.
fn rig_words(rig: &RigStatus) -> String {
    let tips = |count: u8| format!(", {} entered", counted(count.into(), "tip", "tips"));
    let tips = rig.tips.map_or_else(String::new, tips);
    let pose = rig.pose.map_or_else(String::new, |p| {
        let (x, y, z, r) = (p.x_mm, p.y_mm, p.z_mm, p.radius_mm);
        format!(", at x {x:.2}  y {y:.2}  z {z:.2}  radius {r:.2} mm")
    });
    format!("rig {} ({}): {}{tips}{pose}", rig.name, rig.label.as_str(), rig.state_words())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::shown::status::StreamStatus;

    #[test]
    fn a_check_is_shown_with_the_digits_that_matter() {
        let x = json!({
            "name": "x", "position": 12.340_000_001, "unit": "mm", "homed": false,
            "identity": "IAI, servo off, not homed",
        });
        let report = json!({
            "rig": "iai", "label": "virtual", "axes": [x], "cells": null,
            "stream": { "frame_rate_hz": 29.998, "noise_sd_v": 0.001_199_774_905 },
            "problems": [], "unchecked": ["x: servo is off: not switched on"],
        });
        let shown = "rig iai (virtual)\n  x       12.34 mm, IAI, servo off, not homed\n  \
                     ert     30.0 frames/s, noise sd 0.00120 V\n\
                     NOT CHECKED  x: servo is off: not switched on";
        assert_eq!(report_words(&report), shown);
        let silent = json!({ "rig": "iai", "label": "real", "axes": [], "stream": {} });
        assert!(report_words(&silent).ends_with("ert     - frames/s, noise sd - V"));
    }

    #[test]
    fn entered_tips_are_shown() {
        let rig = json!({ "name": "lab", "label": "virtual", "has_stage": true, "state": "homed",
            "clock_rate": 1.0, "forces_n": [], "tips": 4, "stream": StreamStatus::default(),
            "wires": [], "estop_stops": [] });
        let rig: RigStatus = serde_json::from_value(rig).unwrap();
        assert_eq!(rig_words(&rig), "rig lab (virtual): homed, 4 tips entered");
    }
}
