//! What a person must do, the most urgent first: one definition for every page, `palpate status` and its screen.
//! PURE. Uses: `campaign::shown`, `suspenders`, the importance of events. Never: who asks, the store.

use std::cmp::Reverse;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::suspenders::Suspender;
use crate::campaign::bench::interlock::Trip;
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::shown::run_action::ActionOnRun;
use crate::campaign::shown::safe_end::Tips;
use crate::campaign::shown::status::{Phase, RigStatus, RunStatus, Status, Wanted};
use crate::event::Importance;
use crate::plain::bytes;
use crate::record::PlacedContact;
use crate::state::{PausedWhy, StoredState};

/// What a restart means for a run that waits while the database fails.
const NOT_STORED: &str = " The database does not take this: if the service is started again before it does, \
                          the run may resume automatically.";

/// What a need is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NeedKind {
    /// An axis has not stopped after an e-stop.
    NotStopped,
    /// The tips could not be raised.
    TipsNotRaised,
    /// A trip is latched: clear its cause, and reset.
    Reset,
    /// No position is known after a trip: home the axes.
    Home,
    /// Tips must be mounted or removed.
    Tips,
    /// Weights must be placed.
    Weights,
    /// The run waits for a person to resume it.
    Resume,
    /// A run that was started does not begin by itself.
    Start,
    /// The disk has too little room.
    Room,
    /// A monitor is beyond its threshold.
    Watch,
}

impl NeedKind {
    /// The command that does it, or that shows more.
    fn command(self) -> Option<&'static str> {
        match self {
            Self::NotStopped | Self::TipsNotRaised => None,
            Self::Reset => Some("palpate rig reset"),
            Self::Home => Some("palpate rig home"),
            Self::Tips | Self::Weights => Some("palpate confirm"),
            Self::Resume => Some("palpate resume"),
            Self::Start => Some("palpate queue"),
            Self::Room | Self::Watch => Some("palpate status"),
        }
    }

    /// The page where it is done, or seen.
    fn page(self) -> &'static str {
        match self {
            Self::NotStopped | Self::TipsNotRaised | Self::Reset | Self::Home => "rig",
            Self::Weights => "place",
            Self::Start => "queue",
            Self::Tips | Self::Resume | Self::Room | Self::Watch => "night",
        }
    }
}

/// What a person must do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Need {
    /// What it is of.
    pub kind: NeedKind,
    /// `act`: nothing continues, or nothing is safe, before it is done. `look`: a person should look.
    pub importance: Importance,
    /// The need as sentences, with its cause.
    pub words: String,
    /// The command of the terminal that does it, or that shows more; null if only a hand at the rig does it.
    pub command: Option<String>,
    /// The page where it is done, or seen.
    pub page: String,
    /// Time since which it is; null if it is not known.
    pub since: Option<Timestamp>,
}

impl Need {
    fn new(
        kind: NeedKind,
        importance: Importance,
        words: String,
        since: Option<Timestamp>,
    ) -> Self {
        let command = kind.command().map(str::to_owned);
        Self { kind, importance, words, command, page: kind.page().into(), since }
    }
}

/// What the status of rig and run does not hold.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Around<'a> {
    /// Which run does not begin by itself, and why.
    pub not_begun: Option<&'a str>,
    /// Free space of the disk and the space that run and queue need, bytes.
    pub space: Option<(u64, u64)>,
    /// What may suspend the active run.
    pub suspenders: &'a [Suspender],
    /// Whether the active run waits, and is stored as one that a restart resumes.
    pub is_unstored: bool,
}

/// What a person must do, the most urgent first; empty if nothing.
pub(super) fn needs(status: &Status, around: Around<'_>) -> Vec<Need> {
    let mut needs = of_rig(status);
    let is_of_rig =
        status.rig.motion.is_some() || needs.iter().any(|need| need.kind != NeedKind::NotStopped);
    let is_unstored = around.is_unstored;
    needs.extend(status.run.as_ref().and_then(|run| of_run(run, status, is_of_rig, is_unstored)));
    let start = |words| Need::new(NeedKind::Start, Importance::Act, sentence(words), None);
    needs.extend(around.not_begun.map(start));
    needs.extend(ahead(around));
    // The order of those that are as urgent stays.
    needs.sort_by_key(|need| Reverse(need.importance));
    needs
}

/// Axes that the last stops have not stopped, each with its cause.
pub(super) fn not_stopped(rig: &RigStatus) -> Option<String> {
    let axes = rig.not_stopped();
    (!axes.is_empty()).then(|| axes.join(", "))
}

/// Why the tips are not raised, as a sentence.
pub(super) fn not_raised(status: &Status) -> Option<String> {
    if let Some(Tips::NotRaised(why)) = status.rig.safe_end.as_ref().map(|end| &end.tips) {
        return Some(format!("The tips are NOT raised: {why}. Check the rig."));
    }
    let is_panicked = status.run.as_ref().is_some_and(|run| run.state == StoredState::Panicked);
    is_panicked.then(|| "The tips could not be raised. Check the rig.".into())
}

/// Kind and cause of a trip, to be appended to a word.
fn cause_of(trip: &Trip) -> String {
    let kind = trip.kind.name();
    match trip.detail.as_str() {
        "" => format!(" ({kind})"),
        detail => format!(" ({kind}): {detail}"),
    }
}

/// A text with a capital letter and a full stop.
pub(super) fn sentence(words: &str) -> String {
    let mut chars = words.chars();
    let first = chars.next().map(|c| c.to_uppercase().to_string()).unwrap_or_default();
    let end = if words.ends_with('.') { "" } else { "." };
    format!("{first}{}{end}", chars.as_str())
}

/// What must be done at the rig.
fn of_rig(status: &Status) -> Vec<Need> {
    let Status { rig, run, .. } = status;
    let act = |kind, words| Need::new(kind, Importance::Act, words, rig.tripped_at);
    let mut needs = Vec::new();
    if let Some(axes) = not_stopped(rig) {
        let words = format!(
            "NOT STOPPED: {axes}. The stop is sent again until it is. Use the button on the rig."
        );
        needs.push(act(NeedKind::NotStopped, words));
    }
    needs.extend(not_raised(status).map(|words| act(NeedKind::TipsNotRaised, words)));
    if let Some(trip) = &rig.trip {
        let stops = &rig.estop_stops;
        let stopped = if stops.is_empty() || not_stopped(rig).is_some() {
            ""
        } else if stops.iter().all(|stop| stop.stood_ms.is_some()) {
            " Every axis acknowledged the stop and stands."
        } else {
            " Every axis acknowledged the stop."
        };
        let cause = cause_of(trip);
        let words = format!("Tripped{cause}.{stopped} Clear the cause, reset, then home.");
        needs.push(act(NeedKind::Reset, words));
    }
    // After a trip the position of the axes is not known, whether a run waits for it or not.
    let waits = run.as_ref().is_some_and(|run| run.paused_why == Some(PausedWhy::Trip));
    let is_manual = run.as_ref().is_some_and(|run| run.is_manual);
    let is_lost = rig.state == RigState::Disarmed && rig.trip.is_none() && rig.has_stage;
    let is_lost = is_lost && rig.motion.is_none();
    if is_lost && !is_manual && (waits || rig.tripped_at.is_some()) {
        let words = "Home the axes: keep hands and tools away.".into();
        needs.push(act(NeedKind::Home, words));
    }
    needs
}

/// What the active run waits for. `is_of_rig`: the rig moves or needs something first, which is why the run would not
/// continue. `is_unstored`: a restart would resume it.
fn of_run(run: &RunStatus, status: &Status, is_of_rig: bool, is_unstored: bool) -> Option<Need> {
    let why = run.paused_why?;
    let (kind, next) = match why {
        PausedWhy::TipChange => (NeedKind::Tips, ActionOnRun::Confirm),
        PausedWhy::ManualTrial => (NeedKind::Weights, ActionOnRun::Confirm),
        PausedWhy::Operator | PausedWhy::Suspender | PausedWhy::Trip | PausedWhy::Restart => {
            (NeedKind::Resume, ActionOnRun::Resume)
        }
    };
    let stands = run.state == StoredState::Paused && run.phase == Phase::Wait && !is_of_rig;
    let refused = stands.then(|| next.refused(status)).flatten();
    let may_stay = why == PausedWhy::Operator && refused.is_none() && !is_unstored;
    let importance = if may_stay { Importance::Look } else { Importance::Act };
    // The need to reset states the cause of a latched trip.
    let stated = status.rig.trip.as_ref().map(|trip| &trip.detail);
    let detail = run.waiting_for.as_ref().filter(|words| Some(*words) != stated);
    let detail = detail.map_or_else(String::new, |words| format!(": {words}"));
    let cause = format!("{}{detail}{}", why.about(), weights(run));
    let head = if kind == NeedKind::Resume { "the run waits: " } else { "" };
    let mut words = sentence(&format!("{head}{cause}"));
    if let Some(refused) = refused {
        words += &format!(" Not yet: {refused}.");
    }
    if is_unstored {
        words += NOT_STORED;
    }
    Some(Need::new(kind, importance, words, run.waits_since))
}

/// Weights that a person must place, as text.
fn weights(run: &RunStatus) -> String {
    let Some(Wanted::Placement { contacts, .. }) = &run.wanted else { return String::new() };
    let place = |at: &PlacedContact| {
        format!("; {:.3} N at x {:.1}, y {:.1} mm", at.force_n, at.x_mm, at.y_mm)
    };
    contacts.iter().map(place).collect()
}

/// What will stop a run unless a person acts.
fn ahead(around: Around<'_>) -> Vec<Need> {
    let look = |kind, words, since| Need::new(kind, Importance::Look, words, since);
    let disk = |suspender: &&Suspender| suspender.name == "disk";
    let mut needs = Vec::new();
    if let Some((free, needed)) = around.space.filter(|(free, needed)| free < needed) {
        let (free, needed) = (bytes(free as f64), bytes(needed as f64));
        let words = format!("{free} of disk are free, {needed} are needed: remove files.");
        let since = around.suspenders.iter().find(disk).and_then(|one| one.since);
        needs.push(look(NeedKind::Room, words, since));
    }
    let beyond = around.suspenders.iter().filter(|one| one.since.is_some() && !disk(one));
    needs.extend(beyond.map(|one| {
        let then = if one.suspends { "it suspends the run" } else { "it only warns" };
        let words = sentence(&format!("{} is beyond its limit: {then}", one.title));
        look(NeedKind::Watch, words, one.since)
    }));
    needs
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::campaign::bench::estop::AxisStop;
    use crate::campaign::bench::interlock::TripKind;
    use crate::campaign::shown::safe_end::SafeEnd;
    use crate::campaign::shown::show;
    use crate::campaign::shown::status::Motion;
    use crate::ids::RunUid;
    use crate::rig::setup::RigSetup;

    pub fn status(state: RigState) -> Status {
        let rig = include_str!("../../../experiments/rigs/virtual.toml");
        let mut status = show::closed(&RigSetup::from_toml("rig.toml", rig).unwrap());
        status.rig.state = state;
        status
    }

    pub fn waiting(why: PausedWhy) -> RunStatus {
        let wanted = (why == PausedWhy::ManualTrial).then(|| Wanted::Placement {
            trial: 3,
            contacts: vec![PlacedContact { x_mm: 1.0, y_mm: 2.0, force_n: 4.905 }],
        });
        RunStatus {
            uid: RunUid::new(),
            scan_id: 3,
            experiment: "e".into(),
            is_manual: false,
            state: StoredState::Paused,
            requested_state: None,
            paused_why: Some(why),
            waits_since: Some(Timestamp::UNIX_EPOCH),
            waiting_for: None,
            wanted,
            phase: Phase::Wait,
            current_step: None,
            trial: None,
            trials_planned: 1,
            trials_stored: 0,
            trials_skipped: 0,
            retries: 0,
            eta: None,
            needed_bytes: 0,
        }
    }

    fn of(status: &Status) -> Vec<(NeedKind, Importance, String)> {
        let needs = needs(status, Around::default());
        needs.into_iter().map(|need| (need.kind, need.importance, need.words)).collect()
    }

    fn trip(kind: TripKind, detail: &str) -> Option<Trip> {
        Some(Trip { kind, detail: detail.into() })
    }

    #[test]
    fn a_trip_is_reset_and_then_the_axes_are_homed_with_and_without_a_run() {
        let mut tripped = status(RigState::Tripped);
        tripped.change(Timestamp::UNIX_EPOCH, |status| {
            status.rig.trip = trip(TripKind::Force, "arm 2: 81.0 N over 80.0 N");
        });
        let words =
            "Tripped (force): arm 2: 81.0 N over 80.0 N. Clear the cause, reset, then home.";
        assert_eq!(of(&tripped), [(NeedKind::Reset, Importance::Act, words.to_owned())]);
        let need = &needs(&tripped, Around::default())[0];
        assert_eq!(need.command.as_deref(), Some("palpate rig reset"));
        assert_eq!((need.page.as_str(), need.since), ("rig", Some(Timestamp::UNIX_EPOCH)));
        let later = "2026-03-01T18:01:22Z".parse().unwrap();
        tripped.change(later, |status| {
            (status.rig.trip, status.rig.state) = (None, RigState::Disarmed);
        });
        let home = "Home the axes: keep hands and tools away.".to_owned();
        assert_eq!(of(&tripped), [(NeedKind::Home, Importance::Act, home)]);
        tripped.rig.motion = Some(Motion::Homing);
        assert_eq!(of(&tripped), [], "they are homed now");
        tripped.rig.motion = None;
        tripped.change(later, |status| status.rig.state = RigState::Homed);
        assert_eq!(of(&tripped), []);
        // A run that waits for it after a restart of the service, which knows of no trip.
        let mut waits = status(RigState::Disarmed);
        assert_eq!(of(&waits), []);
        waits.run = Some(waiting(PausedWhy::Trip));
        let kinds: Vec<NeedKind> = of(&waits).into_iter().map(|(kind, ..)| kind).collect();
        assert_eq!(kinds, [NeedKind::Home, NeedKind::Resume]);
        waits.rig.motion = Some(Motion::Homing);
        assert_eq!(of(&waits)[0].2, "The run waits: the rig tripped.");
        // The cause is stated once.
        let detail = "arm 2: 81.0 N over 80.0 N";
        waits.run.as_mut().unwrap().waiting_for = Some(detail.into());
        assert_eq!(of(&waits)[0].2, format!("The run waits: the rig tripped: {detail}."));
        (waits.rig.trip, waits.rig.motion) = (trip(TripKind::Force, detail), None);
        let words: Vec<String> = of(&waits).into_iter().map(|(.., words)| words).collect();
        let reset = format!("Tripped (force): {detail}. Clear the cause, reset, then home.");
        assert_eq!(words, [reset, "The run waits: the rig tripped.".into()]);
    }

    #[test]
    fn an_axis_that_is_not_stopped_comes_first() {
        let mut status = status(RigState::Tripped);
        status.rig.trip = trip(TripKind::Estop, "pressed by Ada");
        let silent = AxisStop { error: Some("no reply".into()), ..AxisStop::of("y") };
        status.rig.estop_stops = vec![silent];
        let found = of(&status);
        let words = "NOT STOPPED: y (no reply). The stop is sent again until it is. Use the button on the rig.";
        assert_eq!(found[0], (NeedKind::NotStopped, Importance::Act, words.to_owned()));
        let stop = &mut status.rig.estop_stops[0];
        (stop.acknowledged_ms, stop.error) = (Some(3.0), None);
        assert!(of(&status)[0].2.contains("Every axis acknowledged the stop. Clear"));
        status.rig.estop_stops[0].stood_ms = Some(160.0);
        assert!(of(&status)[0].2.contains("Every axis acknowledged the stop and stands. Clear"));
        // Without a trip: an axis that moved after the last safe end.
        let moves = AxisStop {
            acknowledged_ms: Some(1.0),
            error: Some("moves".into()),
            ..AxisStop::of("x")
        };
        status.rig.estop_stops.clear();
        (status.rig.trip, status.rig.state) = (None, RigState::Homed);
        status.rig.safe_end = Some(SafeEnd {
            stops: vec![moves],
            tips: Tips::Raised,
            sample_to_stop_ms: None,
            travelled_mm: None,
            took_ms: 2060.0,
        });
        assert!(of(&status)[0].2.starts_with("NOT STOPPED: x (moves)."));
    }

    #[test]
    fn a_run_that_waits_states_for_what_and_what_refuses_it() {
        let mut waits = status(RigState::Homed);
        waits.run = Some(waiting(PausedWhy::ManualTrial));
        let words = "Weights must be placed; 4.905 N at x 1.0, y 2.0 mm.".to_owned();
        assert_eq!(of(&waits), [(NeedKind::Weights, Importance::Act, words)]);
        waits.run = Some(waiting(PausedWhy::Operator));
        let paused = "The run waits: a person paused it.";
        assert_eq!(of(&waits), [(NeedKind::Resume, Importance::Look, paused.to_owned())]);
        waits.rig.state = RigState::Disarmed;
        let (_, importance, words) = of(&waits).remove(0);
        assert_eq!(importance, Importance::Act);
        let refused = "Not yet: resume is not possible while the rig is disarmed: reset, home.";
        assert_eq!(words, format!("{paused} {refused}"));
        waits.run = Some(RunStatus {
            waiting_for: Some("mount 3 tips".into()),
            ..waiting(PausedWhy::TipChange)
        });
        assert!(
            of(&waits)[0].2.starts_with("Tips must be changed: mount 3 tips. Not yet: confirm")
        );
    }

    #[test]
    fn a_pause_that_the_database_does_not_take_needs_a_person() {
        let mut waits = status(RigState::Homed);
        waits.run = Some(waiting(PausedWhy::Operator));
        let around = Around { is_unstored: true, ..Around::default() };
        let need = needs(&waits, around).remove(0);
        assert_eq!((need.kind, need.importance), (NeedKind::Resume, Importance::Act));
        assert_eq!(need.words, format!("The run waits: a person paused it.{NOT_STORED}"));
        waits.run = None;
        assert!(needs(&waits, around).is_empty());
    }

    #[test]
    fn what_a_person_must_do_comes_before_what_one_should_look_at() {
        let one = |name: &str, suspends| Suspender {
            name: name.into(),
            title: format!("the {name}"),
            value: None,
            threshold: 1.0,
            unit: "1".into(),
            since: Some(Timestamp::UNIX_EPOCH),
            suspends,
        };
        let suspenders = [one("disk", true), one("fit", true), one("age", false)];
        let around = Around {
            not_begun: Some("run 13 (short) does not begin by itself: start it again"),
            space: Some((1_000_000_000, 14_000_000_000)),
            suspenders: &suspenders,
            is_unstored: false,
        };
        let needs = needs(&status(RigState::Homed), around);
        let words: Vec<&str> = needs.iter().map(|need| need.words.as_str()).collect();
        assert_eq!(
            words,
            [
                "Run 13 (short) does not begin by itself: start it again.",
                "1.00 GB of disk are free, 14.00 GB are needed: remove files.",
                "The fit is beyond its limit: it suspends the run.",
                "The age is beyond its limit: it only warns.",
            ]
        );
        assert_eq!(needs[1].since, Some(Timestamp::UNIX_EPOCH), "that of the monitor of the disk");
    }
}
