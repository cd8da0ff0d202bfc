//! The night at a glance: is it safe, is it on time, are the data good? Each with a rating and its reason.
//! PURE. Uses: `needs`, `suspenders`, `campaign::shown`, `twins::drift`. Never: the store, a clock.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::needs::{Around, not_raised, not_stopped, sentence};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::status::Status;
use crate::plain::{bytes, counted};
use crate::state::StoredState;
use crate::twins::drift::{Level, RollingFit};

/// Age of the newest frame from which on the readout is called silent, ms.
const SILENT_MS: u64 = 3000;
/// Lateness below which a run is as predicted, s.
const AS_PREDICTED_S: f64 = 60.0;
/// Lateness beyond which a run is rated, s, if this is more than a tenth of what was predicted.
const LATE_S: f64 = 300.0;

/// What a glance answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// Is it safe?
    Safe,
    /// Is it on time?
    OnTime,
    /// Are the data good?
    Data,
}

/// The answer to a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rating {
    /// Nothing is to be judged.
    Unknown,
    /// Yes.
    Good,
    /// A person should look.
    Warn,
    /// No.
    Bad,
}

/// A question with its answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Glance {
    /// The question.
    pub question: Question,
    /// The answer.
    pub rating: Rating,
    /// The reason, as sentences. The end of a run is its `eta`.
    pub words: String,
}

/// What is known in addition to the status and to what the needs are made from.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Facts<'a> {
    /// Name and number of trials of the first run of the queue.
    pub next: Option<(&'a str, u64)>,
    /// How much later than predicted the active run ends, and what was predicted at its start, s.
    pub late: Option<(f64, f64)>,
    /// Fit of the last trials.
    pub fit: Option<&'a RollingFit>,
    /// Number of channels that are stuck or saturated.
    pub broken_channels: usize,
}

/// The three questions with their answers.
pub(super) fn glances(status: &Status, around: Around<'_>, facts: Facts<'_>) -> Vec<Glance> {
    let glance = |question, (rating, words)| Glance { question, rating, words };
    vec![
        glance(Question::Safe, safe(status)),
        glance(Question::OnTime, on_time(status, around, facts)),
        glance(Question::Data, data(status, around, facts)),
    ]
}

/// Is it safe?
fn safe(status: &Status) -> (Rating, String) {
    let rig = &status.rig;
    if let Some(axes) = not_stopped(rig) {
        return (Rating::Bad, format!("NOT STOPPED: {axes}. Use the button on the rig."));
    }
    if let Some(words) = not_raised(status) {
        return (Rating::Bad, words);
    }
    if let Some(trip) = &rig.trip {
        // The need to reset states its cause.
        return (Rating::Bad, format!("Stopped by a fault ({}).", trip.kind.name()));
    }
    if rig.state == RigState::Disconnected {
        return (Rating::Unknown, "Nothing moves: the wires are closed.".into());
    }
    if let Some(age_ms) = rig.stream.age_ms.filter(|age_ms| *age_ms > SILENT_MS) {
        let words = format!("No frame for {} s: check the readout.", age_ms / 1000);
        return (Rating::Warn, words);
    }
    let Some(limit_n) = rig.force_limit_n else {
        let words = "No fault. This rig has no load cells and nothing that moves.";
        return (Rating::Good, words.into());
    };
    let Some(largest_n) = rig.forces_n.iter().copied().flatten().reduce(f64::max) else {
        return (Rating::Unknown, "No fault is known, and no load cell is read now.".into());
    };
    let shown_n = largest_n.max(0.0);
    (Rating::Good, format!("No fault. Largest force now {shown_n:.1} N of {limit_n:.0} N."))
}

/// Is it on time?
fn on_time(status: &Status, around: Around<'_>, facts: Facts<'_>) -> (Rating, String) {
    let Some(run) = &status.run else {
        return match (around.not_begun, facts.next) {
            (Some(words), _) => (Rating::Warn, format!("No run is active. {}", sentence(words))),
            (None, None) => (Rating::Unknown, "No run is active, and none is queued.".into()),
            (None, Some((name, trials))) => {
                let trials = counted(trials, "trial", "trials");
                (Rating::Unknown, format!("No run is active. Next: {name}, {trials}."))
            }
        };
    };
    if run.state == StoredState::Panicked {
        return (Rating::Bad, "It has stopped.".into());
    }
    if let Some(why) = run.paused_why.filter(|_| run.state == StoredState::Paused) {
        return (Rating::Warn, format!("It waits: {}.", why.about()));
    }
    if run.eta.is_none() {
        return (Rating::Unknown, "The end is not known yet.".into());
    }
    facts.late.map_or_else(|| (Rating::Good, "It continues.".into()), lateness)
}

/// How late an active run is: by how much, and what was predicted at its start, s.
fn lateness((late_s, predicted_s): (f64, f64)) -> (Rating, String) {
    if late_s.abs() < AS_PREDICTED_S {
        return (Rating::Good, "As predicted at its start.".into());
    }
    let minutes = (late_s.abs() / 60.0).round() as u64;
    let by = match minutes {
        0..120 => format!("{minutes} min"),
        _ => format!("{} h {} min", minutes / 60, minutes % 60),
    };
    let rating = if late_s > LATE_S.max(0.1 * predicted_s) { Rating::Warn } else { Rating::Good };
    let than = if late_s > 0.0 { "later" } else { "earlier" };
    (rating, format!("{by} {than} than predicted at its start."))
}

/// Are the data good?
fn data(status: &Status, around: Around<'_>, facts: Facts<'_>) -> (Rating, String) {
    let (mut rating, mut words) = (Rating::Unknown, Vec::new());
    let beyond: Vec<_> = around.suspenders.iter().filter(|one| one.since.is_some()).collect();
    if !beyond.is_empty() {
        let suspends = beyond.iter().any(|one| one.suspends);
        rating = rating.max(if suspends { Rating::Bad } else { Rating::Warn });
        let titles: Vec<&str> = beyond.iter().map(|one| one.title.as_str()).collect();
        words.push(format!("Beyond its limit: {}.", titles.join(", ")));
    }
    if let Some((free, needed)) = around.space.filter(|(free, needed)| free < needed) {
        rating = Rating::Bad;
        words.push(format!("The disk is short of {}.", bytes((needed - free) as f64)));
    }
    if let Some(fit) = facts.fit {
        rating = rating.max(match fit.level {
            Level::Ok => Rating::Good,
            Level::Warn => Rating::Warn,
            Level::Suspend => Rating::Bad,
        });
        let trials = counted(fit.trials as u64, "trial", "trials");
        words.push(format!("FVU {:.3} over {trials}.", fit.median_fvu));
        if fit.pairs_over_limit > 0 {
            let pairs = counted(fit.pairs_over_limit as u64, "electrode pair", "electrode pairs");
            words.push(format!("{pairs} over the limit."));
        }
    }
    if facts.broken_channels > 0 {
        rating = rating.max(Rating::Warn);
        let channels = counted(facts.broken_channels as u64, "channel", "channels");
        words.push(format!("{channels} stuck or saturated."));
    }
    if words.is_empty() {
        let words = match status.run {
            Some(_) => "No twin to compare with yet.",
            None => "Nothing to judge yet.",
        };
        return (Rating::Unknown, words.into());
    }
    // Without a fresh frame nothing says that the data are good now.
    if rating <= Rating::Good {
        let is_fresh = status.rig.stream.age_ms.is_some_and(|age_ms| age_ms <= SILENT_MS);
        rating = if is_fresh { Rating::Good } else { Rating::Unknown };
    }
    (rating, words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::needs;
    use crate::campaign::bench::interlock::{Trip, TripKind};

    fn status() -> Status {
        let mut status = needs::tests::status(RigState::Homed);
        status.rig.stream.age_ms = Some(12);
        status
    }

    #[test]
    fn it_is_safe_while_no_fault_is_known() {
        let mut rig = status();
        rig.rig.forces_n = vec![Some(12.34), None, Some(-1.0)];
        assert_eq!(safe(&rig).0, Rating::Good);
        assert!(safe(&rig).1.starts_with("No fault. Largest force now 12.3 N of "));
        rig.rig.forces_n = vec![None; 3];
        let unread = "No fault is known, and no load cell is read now.";
        assert_eq!(safe(&rig), (Rating::Unknown, unread.to_owned()));
        rig.rig.stream.age_ms = Some(4200);
        let silent = "No frame for 4 s: check the readout.";
        assert_eq!(safe(&rig), (Rating::Warn, silent.to_owned()));
        rig.rig.trip = Some(Trip { kind: TripKind::Force, detail: "arm 2: 81.0 N".into() });
        let trip = "Stopped by a fault (force).";
        assert_eq!(safe(&rig), (Rating::Bad, trip.to_owned()));
        rig.rig.trip = Some(Trip { kind: TripKind::Estop, detail: String::new() });
        assert_eq!(safe(&rig).1, "Stopped by a fault (estop).");
        (rig.rig.trip, rig.rig.state) = (None, RigState::Disconnected);
        assert_eq!(safe(&rig).0, Rating::Unknown);
    }

    #[test]
    fn without_a_run_what_comes_next_is_named() {
        let words = |not_begun, next| {
            let around = Around { not_begun, ..Around::default() };
            on_time(&status(), around, Facts { next, ..Facts::default() })
        };
        let none = "No run is active, and none is queued.";
        assert_eq!(words(None, None), (Rating::Unknown, none.to_owned()));
        let next = "No run is active. Next: short, 1 trial.";
        assert_eq!(words(None, Some(("short", 1))), (Rating::Unknown, next.to_owned()));
        let dropped = "No run is active. Run 3 does not begin by itself.";
        let found = words(Some("run 3 does not begin by itself"), None);
        assert_eq!(found, (Rating::Warn, dropped.to_owned()));
    }

    #[test]
    fn a_run_is_late_beyond_a_tenth_of_what_was_predicted() {
        let words = |late_s, predicted_s| lateness((late_s, predicted_s));
        let good = |words: &str| (Rating::Good, words.to_owned());
        assert_eq!(words(-59.0, 600.0), good("As predicted at its start."));
        assert_eq!(words(299.0, 600.0), good("5 min later than predicted at its start."));
        assert_eq!(words(-8000.0, 36e3), good("2 h 13 min earlier than predicted at its start."));
        assert_eq!(words(3500.0, 36e3), good("58 min later than predicted at its start."));
        assert_eq!(words(301.0, 600.0).0, Rating::Warn);
        assert_eq!(words(3700.0, 36e3).0, Rating::Warn);
    }

    #[test]
    fn the_data_are_as_good_as_their_worst_sign() {
        let around = Around { space: Some((1, 2_000_000)), ..Around::default() };
        let fit = RollingFit {
            level: Level::Warn,
            trials: 9,
            median_fvu: 0.4,
            pairs_over_limit: 1,
            worst_pairs: Vec::new(),
        };
        let facts = Facts { fit: Some(&fit), broken_channels: 2, ..Facts::default() };
        let words = "FVU 0.400 over 9 trials. 1 electrode pair over the limit. 2 channels stuck or saturated.";
        let found = data(&status(), Around::default(), facts);
        assert_eq!(found, (Rating::Warn, words.to_owned()));
        let (rating, words) = data(&status(), around, facts);
        assert!(rating == Rating::Bad && words.starts_with("The disk is short of"), "{words}");
        let nothing = data(&status(), Around::default(), Facts::default());
        assert_eq!(nothing, (Rating::Unknown, "Nothing to judge yet.".into()));
        let mut silent = status();
        let fit = RollingFit { level: Level::Ok, pairs_over_limit: 0, ..fit };
        let good = Facts { fit: Some(&fit), ..Facts::default() };
        assert_eq!(data(&silent, Around::default(), good).0, Rating::Good);
        silent.rig.stream.age_ms = None;
        assert_eq!(data(&silent, Around::default(), good).0, Rating::Unknown);
    }
}
