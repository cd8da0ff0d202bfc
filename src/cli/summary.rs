//! Result of a run: for scripts the last line, for people the closing summary with the paper's
//! Table I for comparison.
//! Uses: `api::Summary`. Never: numbers that were not measured.

use std::fmt;

use serde::Serialize;

use super::next::Next;
use super::output::{counted, duration};
use super::{At, DEFAULT_DATA};
use crate::api::Summary;
use crate::evaluate::published::{REAL_HEX, REAL_RANDOM};
use crate::evaluate::simulation::SimulationReport;
use crate::ids::RunUid;
use crate::journal::ExitStatus;
use crate::store::{Label, RunKind};

/// Presses for it: six settings of 33,000 (paper IV-A). The rest had no contact over 5 N.
const REAL_HEX_PRESSED: u64 = 198_000;

/// The last line of `palpate run --json`. Scripts rely on these names: they must not change.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finished {
    /// Always `finished`.
    pub event: &'static str,
    /// Id of the run.
    pub run: RunUid,
    /// `success`, `stopped`, `abort` or `fail`; `stopped` also for a run that is open.
    pub exit_status: ExitStatus,
    /// Reason of the end.
    pub reason: String,
    /// Trials in its plan.
    pub trials_planned: u64,
    /// Number of trials of the run that are stored.
    pub trials_stored: u64,
    /// Trials of skipped configurations.
    pub trials_skipped: u64,
    /// Number of failed attempts.
    pub retries: u64,
    /// From its first start to its end, wall s; absent while it is open.
    pub duration_s: Option<f64>,
    /// Path of the database file.
    pub database: String,
    /// Number for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// `measured` or `virtual`.
    pub label: Label,
    /// Whether it can be resumed.
    pub resumable: bool,
    /// Process seconds per wall second.
    pub clock_rate: f64,
    /// Stored trials with 0 to 6 contacts.
    pub contact_counts: [u64; 7],
    /// Trials with a simulated twin, if known.
    pub twins: Option<u64>,
    /// Median fraction of variance that the twins leave unexplained, trials with contacts.
    pub median_fvu: Option<f64>,
}

/// How a followed run ended, for scripts and for people.
#[derive(Debug, Clone)]
pub struct Closing {
    /// Last line for scripts.
    pub finished: Finished,
    summary: Summary,
    data: String,
    follow_url: Option<String>,
}

impl Closing {
    /// Summary of a run. `why_left` is the reason if it was left open.
    pub fn of(summary: Summary, database: String, clock_rate: f64, why_left: Option<&str>) -> Self {
        let run = &summary.run;
        let exit_status = run.exit_status.unwrap_or(ExitStatus::Stopped);
        let reason = run.reason.clone().or(why_left.map(Into::into)).unwrap_or_default();
        let finished = Finished {
            event: "finished",
            run: run.uid,
            exit_status,
            reason,
            trials_planned: run.trials_planned,
            trials_stored: summary.trials_stored,
            trials_skipped: summary.trials_skipped,
            retries: summary.retries,
            duration_s: summary.duration_s,
            database,
            scan_id: run.scan_id,
            experiment: run.experiment.clone(),
            label: run.label,
            resumable: run.exit_status.is_none() || run.is_resumable,
            clock_rate,
            contact_counts: summary.contact_counts,
            twins: None,
            median_fvu: None,
        };
        Self { finished, summary, data: String::new(), follow_url: None }
    }

    /// Adds the fit of the simulated twins.
    pub fn with_fit(mut self, fit: Option<SimulationReport>) -> Self {
        self.finished.twins = fit.as_ref().map(|fit| fit.trials + fit.flagged);
        self.finished.median_fvu = fit.and_then(|fit| fit.median_fvu);
        self
    }

    /// Adds the next commands: with the data folder, or the service that has the run.
    pub fn with_next(mut self, data: &std::path::Path, server: Option<&str>) -> Self {
        self.data = data.display().to_string();
        self.follow_url = server.map(Into::into);
        self
    }

    /// Commands that show or resume the run, as suggestions.
    pub fn next_commands(&self) -> Next {
        let run = self.finished.scan_id;
        let (url, is_default) = (self.follow_url.clone(), self.data == DEFAULT_DATA);
        let data = (url.is_none() && !is_default).then(|| self.data.clone().into());
        let mut next = Next::of(&At { url, data, ..At::default() });
        if self.finished.resumable {
            next = next.same_command("again", "resumes where it stopped");
        }
        next = next
            .suggest(format_args!("palpate show {run}"), "draws it in the terminal")
            .suggest(format_args!("palpate report {run}"), "its findings, as HTML and PDF");
        match self.follow_url {
            None => next.suggest("palpate serve --open", "shows it in the browser"),
            Some(_) => next,
        }
    }

    /// Whether the run ended as a success.
    pub fn is_success(&self) -> bool {
        self.finished.exit_status == ExitStatus::Success
    }
}

impl fmt::Display for Closing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let done = &self.finished;
        let (status, label) = (done.exit_status.as_str(), self.label());
        let (scan_id, name) = (done.scan_id, &done.experiment);
        // The reason of a requested end begins with its status.
        let ended = match done.exit_status {
            ExitStatus::Success | ExitStatus::Fail => format!("{status}, {}", done.reason),
            ExitStatus::Stopped | ExitStatus::Abort => done.reason.clone(),
        };
        writeln!(f, "run {scan_id}, {name} ({label}): {ended}")?;
        let line = |f: &mut fmt::Formatter<'_>, name: &str, value: String| {
            writeln!(f, "  {name:<12} {value}")
        };
        let skipped = counted(done.trials_skipped, "skipped", "skipped");
        let retries = counted(done.retries, "retry", "retries");
        let stored = format!("{} of {} stored", done.trials_stored, done.trials_planned);
        line(f, "trials", format!("{stored}, {skipped}, {retries}"))?;
        if let Some(wall_s) = done.duration_s {
            let process = match done.clock_rate {
                1.0 => String::new(),
                rate => format!(", {} of process time at speed {rate}", duration(wall_s * rate)),
            };
            line(f, "start to end", format!("{}{process}", duration(wall_s)))?;
        }
        if let Some(twins) = done.twins {
            let fit = done.median_fvu.map_or_else(String::new, |fvu| {
                format!(", median FVU {fvu:.3} of trials with contact")
            });
            line(f, "twins", format!("{twins} of {} simulated{fit}", done.trials_stored))?;
        }
        line(f, "database", done.database.clone())?;
        line(f, "run", done.run.to_string())?;
        for skip in &self.summary.skips {
            line(f, "skipped", format!("configuration {}: {}", skip.configuration, skip.reason))?;
        }
        self.table(f)
    }
}

impl Closing {
    fn label(&self) -> &'static str {
        self.finished.label.as_str()
    }

    /// Table of trials by contacts, with the paper's scaled to the same number of trials.
    fn table(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stored: u64 = self.finished.contact_counts.iter().sum();
        if stored == 0 {
            return Ok(());
        }
        let kind = self.summary.run.kind;
        let Some((name, paper)) = table_one(kind, stored) else { return Ok(()) };
        let column = format!("run {} ({})", self.finished.scan_id, self.label());
        writeln!(f, "\n  contacts {column:>18} {:>26}", format!("{name}, Table I, scaled"))?;
        for (contacts, (here, paper)) in self.finished.contact_counts.iter().zip(paper).enumerate()
        {
            writeln!(f, "  {contacts:>8} {here:>18} {paper:>26.1}")?;
        }
        if kind == RunKind::RealHex {
            let tips: Vec<String> =
                self.summary.settings.iter().map(|s| s.tips.to_string()).collect();
            writeln!(
                f,
                "  Table I sums six settings of 33000 presses (1 to 6 tips), scaled here to \
                 {stored} trials;\n  this run has tips {}; contacts under {} N are not counted.",
                tips.join(", "),
                self.summary.run.deadband_n
            )?;
        }
        Ok(())
    }
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
mod tests {
    use super::*;

    #[test]
    fn table_i_is_the_papers() {
        assert_eq!(REAL_HEX.iter().sum::<u64>(), 93_674);
        assert_eq!(REAL_RANDOM.iter().sum::<u64>(), 150);
    }

    #[test]
    fn scaled_counts_sum_to_the_trials_stored() {
        let paper = scaled(&REAL_HEX, REAL_HEX_PRESSED, 264);
        assert!((paper.iter().sum::<f64>() - 264.0).abs() < 1e-9);
        assert!((paper[0] - 264.0 * 104_326.0 / 198_000.0).abs() < 1e-9);
    }
}
