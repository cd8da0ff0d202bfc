//! Result of a run: for scripts the last line, for people the closing summary with the paper's
//! Table I for comparison.
//! Uses: `api::{History, Summary}`. Never: numbers that were not measured.

use std::fmt;
use std::path::Path;

use serde_json::{Value, json};

use super::next::Next;
use super::output::{counted, duration, grouped};
use super::{At, DEFAULT_DATA};
use crate::api::{History, Summary};
use crate::evaluate::published::{REAL_HEX, REAL_RANDOM};
use crate::evaluate::simulation::SimulationReport;
use crate::journal::ExitStatus;
use crate::state::StoredState;
use crate::store::RunKind;

/// Presses for it: six settings of 33,000 (paper IV-A). The rest had no contact over 5 N.
const REAL_HEX_PRESSED: u64 = 198_000;

/// How a followed run ended, for scripts and for people.
#[derive(Debug, Clone)]
pub struct Closing {
    summary: Summary,
    /// Reason of the end.
    reason: String,
    /// Path of the database file.
    database: String,
    /// Process seconds per wall second.
    clock_rate: f64,
    /// Fit of the simulated twins, if known.
    fit: Option<SimulationReport>,
    /// Whether the run was stopped or interrupted, and resumed; `None` if unknown.
    was_resumed: Option<bool>,
}

impl Closing {
    /// Summary of a run. `why_left` is the reason if it was left open; fit of its twins and history, if known.
    pub fn of(
        summary: Summary,
        database: String,
        clock_rate: f64,
        why_left: Option<&str>,
        fit: Option<SimulationReport>,
        history: Option<&History>,
    ) -> Self {
        let reason = summary.run.reason.clone().or(why_left.map(Into::into)).unwrap_or_default();
        let was_resumed = history.map(was_resumed);
        Self { summary, reason, database, clock_rate, fit, was_resumed }
    }

    /// How the run ended; `Stopped` also if it is open.
    fn exit_status(&self) -> ExitStatus {
        self.summary.run.exit_status.unwrap_or(ExitStatus::Stopped)
    }

    fn is_resumable(&self) -> bool {
        let run = &self.summary.run;
        run.is_resumable || run.exit_status.is_none() && run.state != StoredState::Removed
    }

    /// Number of trials with a simulated twin, if known.
    fn twins(&self) -> Option<u64> {
        self.fit.as_ref().map(|fit| fit.trials + fit.flagged)
    }

    /// Median fraction of variance that the twins leave unexplained, trials with contacts.
    fn median_fvu(&self) -> Option<f64> {
        self.fit.as_ref()?.median_fvu
    }

    /// The last line of `palpate run --json`. Scripts rely on these names: they must not change.
    pub fn finished(&self) -> Value {
        let Summary { run, .. } = &self.summary;
        json!({
            "event": "finished",
            "run": run.uid,
            "scan_id": run.scan_id,
            "experiment": run.experiment,
            "label": run.label,
            "exit_status": self.exit_status(),
            "reason": self.reason,
            "resumable": self.is_resumable(),
            "trials_planned": run.trials_planned,
            "trials_stored": self.summary.trials_stored,
            "trials_skipped": self.summary.trials_skipped,
            "retries": self.summary.retries,
            "contact_counts": self.summary.contact_counts,
            "duration_s": self.summary.duration_s,
            "clock_rate": self.clock_rate,
            "database": self.database,
            "twins": self.twins(),
            "median_fvu": self.median_fvu(),
        })
    }

    /// Commands that show or resume the run: with the data folder, or the service that has the run. `new`: the command
    /// was typed with `--new`.
    pub fn next_commands(&self, data: &Path, server: Option<&str>, new: bool) -> Next {
        let run = self.summary.run.scan_id;
        let is_named = server.is_none() && data != Path::new(DEFAULT_DATA);
        let (url, data) = (server.map(Into::into), is_named.then(|| data.into()));
        let mut next = Next::of(&At { url, data, ..At::default() });
        if self.summary.run.state == StoredState::Queued {
            next = next
                .suggest(format_args!("palpate resume {run}"), "starts it again")
                .suggest(format_args!("palpate queue remove {run}"), "takes it out of the queue");
        } else if self.is_resumable() {
            let what = "resumes where it stopped";
            let again = if new { "without --new" } else { "again" };
            next = match (server, self.summary.run.exit_status) {
                // The command may have been `attach`.
                (Some(_), _) => next.suggest(format_args!("palpate resume {run}"), what),
                (None, None | Some(ExitStatus::Stopped)) => next.same_command(again, what),
                // A run that was aborted or has failed is resumed by its number only.
                (None, _) => next.suggest(
                    format_args!("palpate resume {run}"),
                    format_args!("{what}, while `palpate serve` runs"),
                ),
            };
        }
        next = next
            .suggest(format_args!("palpate show {run}"), "draws it in the terminal")
            .suggest(format_args!("palpate report {run}"), "its findings, as HTML and PDF");
        match server {
            None => next.suggest("palpate serve --open", "shows it in the browser"),
            Some(_) => next,
        }
    }

    /// Whether the run ended as a success.
    pub fn is_success(&self) -> bool {
        self.exit_status() == ExitStatus::Success
    }
}

impl fmt::Display for Closing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Summary { run, .. } = &self.summary;
        let (scan_id, name, label) = (run.scan_id, &run.experiment, run.label.as_str());
        // The reason of a requested end begins with its status.
        let ended = match self.exit_status() {
            status @ (ExitStatus::Success | ExitStatus::Fail) => {
                format!("{}, {}", status.as_str(), self.reason)
            }
            ExitStatus::Stopped | ExitStatus::Abort => self.reason.clone(),
        };
        writeln!(f, "run {scan_id}, {name} ({label}): {ended}")?;
        let line = |f: &mut fmt::Formatter<'_>, name: &str, value: String| {
            writeln!(f, "  {name:<12} {value}")
        };
        let skipped = counted(self.summary.trials_skipped, "skipped", "skipped");
        let retries = counted(self.summary.retries, "retry", "retries");
        let stored = grouped(self.summary.trials_stored);
        let planned = grouped(run.trials_planned);
        line(f, "trials", format!("{stored} of {planned} stored, {skipped}, {retries}"))?;
        if let Some(wall_s) = self.summary.duration_s {
            let process = match (self.was_resumed, self.clock_rate) {
                // Not all of it was driven, and perhaps at another speed before.
                (Some(true), _) => String::from(", interruptions included"),
                (None, _) | (_, 1.0) => String::new(),
                (Some(false), rate) => {
                    format!(", {} of process time at speed {rate}", duration(wall_s * rate))
                }
            };
            line(f, "start to end", format!("{}{process}", duration(wall_s)))?;
        }
        if let Some(twins) = self.twins() {
            let fit = self.median_fvu().map_or_else(String::new, |fvu| {
                format!(", median FVU {fvu:.3} of trials with contact")
            });
            line(f, "twins", format!("{} of {stored} simulated{fit}", grouped(twins)))?;
        }
        line(f, "database", self.database.clone())?;
        line(f, "run", run.uid.to_string())?;
        for skip in &self.summary.skips {
            line(f, "skipped", format!("configuration {}: {}", skip.configuration, skip.reason))?;
        }
        self.table(f)
    }
}

impl Closing {
    /// Table of trials by contacts, of a whole run with the paper's scaled to the same number of trials: the trials of a
    /// part have other settings.
    fn table(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Summary { run, contact_counts, .. } = &self.summary;
        let stored: u64 = contact_counts.iter().sum();
        if stored == 0 {
            return Ok(());
        }
        let Some((name, paper)) = table_one(run.kind, stored) else { return Ok(()) };
        let column = format!("run {} ({})", run.scan_id, run.label.as_str());
        if !self.is_success() {
            writeln!(f, "\n  contacts {column:>18}")?;
            for (contacts, here) in contact_counts.iter().enumerate() {
                writeln!(f, "  {contacts:>8} {:>18}", grouped(*here))?;
            }
            let planned = grouped(run.trials_planned);
            return writeln!(
                f,
                "  These are {} of {planned} trials; a whole run is compared with Table I.",
                grouped(stored)
            );
        }
        writeln!(f, "\n  contacts {column:>18} {:>26}", format!("{name}, Table I, scaled"))?;
        for (contacts, (here, paper)) in contact_counts.iter().zip(paper).enumerate() {
            let here = grouped(*here);
            writeln!(f, "  {contacts:>8} {here:>18} {paper:>26.1}")?;
        }
        if run.kind == RunKind::RealHex {
            let tips: Vec<String> =
                self.summary.settings.iter().map(|s| s.tips.to_string()).collect();
            writeln!(
                f,
                "  Table I sums six settings of 33,000 presses (1 to 6 tips), scaled here to \
                 {};\n  this run has tips {}; contacts under {} N are not counted.",
                counted(stored, "trial", "trials"),
                tips.join(", "),
                run.deadband_n
            )?;
        }
        Ok(())
    }
}

/// Whether a run was stopped or interrupted, and resumed.
fn was_resumed(history: &History) -> bool {
    let of = |kind: &str| history.events.iter().filter(|event| event.kind == kind).count();
    history.states.iter().any(|span| span.state == StoredState::Interrupted)
        || of("resumed") + of("not_resumed") > 0
        || of("ended") > 1
}

/// The name and the counts of Table I for runs of a kind, trials with 0, 1, .. 6 contacts, scaled to as
/// many trials; `None` if it has no trials of this kind.
pub fn table_one(kind: RunKind, stored: u64) -> Option<(&'static str, [f64; 7])> {
    match kind {
        RunKind::RealHex => Some(("Real-Hex", scaled(&REAL_HEX, REAL_HEX_PRESSED, stored))),
        RunKind::RealRandom => Some(("Real-Random", scaled(&REAL_RANDOM, 150, stored))),
        RunKind::Imported => None,
    }
}

/// Table I's counts, preceded by the trials without contact, scaled from `pressed` to `stored`.
fn scaled(counts: &[u64; 6], pressed: u64, stored: u64) -> [f64; 7] {
    let none = pressed.saturating_sub(counts.iter().sum());
    let share = stored as f64 / pressed as f64;
    std::array::from_fn(|n| if n == 0 { none } else { counts[n - 1] } as f64 * share)
}

#[cfg(test)]
pub(super) mod tests {
    use jiff::Timestamp;

    use super::*;

    /// A time of the run of [`summary`], minutes after its start.
    pub fn time(minutes: i64) -> Timestamp {
        Timestamp::from_second(1_790_000_000 + 60 * minutes).unwrap()
    }

    /// A run of 40 trials that ended as a success, changed.
    pub fn summary(change: impl FnOnce(&mut Value)) -> Summary {
        let mut run = json!({
            "uid": "01a208ed-3612-760c-9dff-1d5fb515cdf8", "scan_id": 3, "experiment": "night <1>",
            "kind": "real-hex", "definition": "name = \"night <1>\"\n", "definition_sha256": "ab",
            "seed": 1, "rig": "", "rig_sha256": "cd", "sensor": "", "sensor_sha256": "ef",
            "calibration_id": null, "label": "virtual", "version": "0.1.0", "git_commit": null,
            "deadband_n": 5.0, "tip_diameter_mm": 20.0, "trials_planned": 40, "auto_resume": true,
            "not_before": null, "plan_sha256": null, "state": "ended", "requested_state": null,
            "paused_why": null, "exit_status": "success", "reason": "every planned trial is stored",
            "queue_position": null, "waiting_since": null, "is_resumable": false, "created_at": time(0),
            "started_at": time(0), "ended_at": time(60), "submitted_by": "Ada",
        });
        let mut summary = json!({
            "trials_stored": 40, "trials_skipped": 0, "retries": 0,
            "contact_counts": [0, 20, 20, 0, 0, 0, 0], "settings": [{ "tips": 2, "stored": 40 }],
            "skips": [], "duration_s": 3600.0,
        });
        summary["run"] = run.take();
        change(&mut summary);
        serde_json::from_value(summary).unwrap()
    }

    /// A run that ended short of its plan.
    fn short(exit_status: &str, history: Option<&History>) -> Closing {
        let summary = summary(|of| {
            of["trials_stored"] = 12.into();
            of["run"]["exit_status"] = exit_status.into();
            of["run"]["reason"] = "12 of 40 trials".into();
            of["run"]["is_resumable"] = true.into();
        });
        Closing::of(summary, "d".into(), 1.0, None, None, history)
    }

    #[test]
    fn what_resumes_a_run_is_named_and_nothing_that_starts_another_one() {
        let next = |status: &str, server: Option<&str>, new: bool| {
            let data = Path::new(DEFAULT_DATA);
            format!("{:?}", short(status, None).next_commands(data, server, new))
        };
        assert!(next("stopped", None, false).contains("the same command again"));
        assert!(next("stopped", None, true).contains("the same command without --new"));
        let served = next("stopped", Some("http://rig:8080"), false);
        assert!(served.contains("palpate resume 3 --url http://rig:8080"), "{served}");
        for status in ["abort", "fail"] {
            let next = next(status, None, false);
            assert!(!next.contains("the same command"), "{next}");
            assert!(next.contains("\"palpate resume 3\""), "{next}");
        }
    }

    #[test]
    fn only_a_run_without_interruption_has_a_process_time() {
        let line = |states: &[&str], events: &[&str]| {
            let at = "2026-11-24T22:00:00Z";
            let span = |state: &&str| json!({ "state": state, "why": null, "from": at, "to": at });
            let event =
                |kind: &&str| json!({ "seq": 1, "at": at, "kind": kind, "importance": "notable" });
            let mut history = json!(History::default());
            history["states"] = states.iter().map(span).collect();
            history["events"] = events.iter().map(event).collect();
            let history: History = serde_json::from_value(history).unwrap();
            let mut closing = short("success", Some(&history));
            (closing.summary.duration_s, closing.clock_rate) = (Some(1020.0), 60.0);
            let shown = closing.to_string();
            shown.lines().find_map(|line| line.strip_prefix("  start to end ")).unwrap().to_owned()
        };
        let (wall, process) = (duration(1020.0), duration(61_200.0));
        let whole = format!("{wall}, {process} of process time at speed 60");
        assert_eq!(line(&["running", "paused", "running"], &["ended"]), whole);
        let parts = format!("{wall}, interruptions included");
        assert_eq!(line(&["running", "interrupted", "running"], &["ended"]), parts);
        assert_eq!(line(&["running"], &["ended", "ended"]), parts);
        assert_eq!(line(&["paused", "running"], &["resumed", "ended"]), parts);
    }

    #[test]
    fn only_a_whole_run_is_compared_with_table_i() {
        let whole = Closing::of(summary(|_| {}), "d".into(), 1.0, None, None, None).to_string();
        assert!(whole.contains("Real-Hex, Table I, scaled"), "{whole}");
        let part = summary(|of| {
            of["trials_stored"] = 12.into();
            of["contact_counts"] = json!([0, 12, 0, 0, 0, 0, 0]);
            of["run"]["exit_status"] = "stopped".into();
        });
        let part = Closing::of(part, "d".into(), 1.0, None, None, None).to_string();
        let end = "These are 12 of 40 trials; a whole run is compared with Table I.\n";
        assert!(part.ends_with(end) && !part.contains("scaled"), "{part}");
    }

    #[test]
    fn scaled_counts_sum_to_the_trials_stored() {
        let paper = scaled(&REAL_HEX, REAL_HEX_PRESSED, 264);
        assert!((paper.iter().sum::<f64>() - 264.0).abs() < 1e-9);
        assert!((paper[0] - 264.0 * 104_326.0 / 198_000.0).abs() < 1e-9);
        assert_eq!(REAL_RANDOM.iter().sum::<u64>(), 150, "all of its trials have a contact");
    }
}
