//! The plain state of the screen: what was read, when, and what follows for a person.
//! PURE. Uses: `answers`, `view`. Never: HTTP, the terminal.

use std::collections::VecDeque;

use jiff::{SignedDuration, Timestamp};
use serde_json::Value;

use super::answers::Tour;
use crate::api::{History, RigRates, RunProgress, SensorOut};
use crate::campaign::shown::status::RunStatus;
use crate::cli::view::{EventView, StatusView, need_words};
use crate::event::Importance;
use crate::ids::RunUid;
use crate::plain::escaped;

/// Time without an answer after which the connection counts as lost.
const LOST: SignedDuration = SignedDuration::from_millis(2000);
/// Time after which the progress along the tour counts as old.
const OLD_PROGRESS: SignedDuration = SignedDuration::from_secs(15);
/// Number of events that are kept.
const EVENTS_KEPT: usize = 60;

/// An answer of the service that changes the screen.
#[derive(Debug)]
pub enum News {
    /// The status, and when it was asked for.
    Status(Timestamp, Box<StatusView>),
    /// The service did not answer; the cause.
    NoStatus(String),
    /// The skin of a run; absent if the service does not state it.
    Skin(RunUid, Option<SensorOut>),
    /// The tour of a run; absent if the service does not state it.
    Tour(RunUid, Option<Tour>),
    /// The progress of a run along its tour.
    Progress(RunUid, RunProgress),
    /// A run over time.
    Course(RunUid, History),
    /// What stream and wires did in the last minute.
    Rates(RigRates),
    /// The simulated twins, as the service answers.
    Twins(Value),
    /// New events, in their order.
    Events(Vec<EventView>),
    /// Outcome of a request of the person at the screen.
    Outcome(String),
}

/// All that the screen shows.
#[derive(Debug, Default)]
pub struct Night {
    /// URL of the service.
    pub url: String,
    /// Newest status of the service; absent before the first one.
    pub status: Option<StatusView>,
    /// When the last status was asked for.
    pub heard_at: Option<Timestamp>,
    /// Why the last request for the status failed.
    pub trouble: Option<String>,
    /// The run that the map shows: the active one, or the last one.
    pub run: Option<RunUid>,
    /// Skin of the active run; absent before it was read.
    pub skin: Option<SensorOut>,
    /// Tour of the active run; absent before it was read.
    pub tour: Option<Tour>,
    /// Its progress along the tour.
    pub progress: Option<RunProgress>,
    /// When the progress was read.
    pub progress_at: Option<Timestamp>,
    /// The active run over time.
    pub course: Option<History>,
    /// What stream and wires did in the last minute.
    pub rates: Option<RigRates>,
    /// The simulated twins, as the service answers.
    pub twins: Option<Value>,
    /// The last events, the newest last.
    pub events: VecDeque<Told>,
    /// Outcome of the last request of the person at the screen.
    pub outcome: Option<String>,
}

/// An event as text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Told {
    /// Wall time of the event; absent if it cannot be read.
    pub at: Option<Timestamp>,
    /// Text for a person, on one line.
    pub words: String,
    /// How much it matters.
    pub level: Importance,
}

/// State of a configuration on the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mark {
    /// Its turn has not come.
    Later,
    /// All its trials are stored.
    Done,
    /// Attempts at it failed; it was repeated, or will be.
    Failed,
    /// It was given up.
    Skipped,
    /// It is the next one.
    Next,
    /// It is pressed now.
    Now,
}

impl Night {
    /// State before anything was read.
    pub fn new(url: &str) -> Self {
        Self { url: url.into(), ..Self::default() }
    }

    /// Takes what was read at `now`.
    pub fn take(&mut self, news: News, now: Timestamp) {
        match news {
            News::Status(asked, status) => {
                self.show_run(status.run.as_ref().map(|run| run.uid));
                (self.status, self.heard_at, self.trouble) = (Some(*status), Some(asked), None);
            }
            News::NoStatus(why) => self.trouble = Some(one_line(&why)),
            News::Skin(run, skin) if self.run == Some(run) => self.skin = skin,
            News::Tour(run, tour) if self.run == Some(run) => self.tour = tour,
            News::Progress(run, progress) if self.run == Some(run) => {
                (self.progress, self.progress_at) = (Some(progress), Some(now));
            }
            News::Course(run, course) if self.run == Some(run) => self.course = Some(course),
            News::Skin(..) | News::Tour(..) | News::Progress(..) | News::Course(..) => {}
            News::Rates(rates) => self.rates = Some(rates),
            News::Twins(twins) => self.twins = Some(twins),
            News::Events(events) => {
                self.events.extend(events.iter().filter_map(told));
                let surplus = self.events.len().saturating_sub(EVENTS_KEPT);
                self.events.drain(..surplus);
            }
            News::Outcome(words) => self.outcome = Some(one_line(&words)),
        }
    }

    /// Changes to another run; without one the last one stays on the map.
    fn show_run(&mut self, run: Option<RunUid>) {
        if run.is_some() && run != self.run {
            self.run = run;
            (self.skin, self.tour, self.progress, self.progress_at) = (None, None, None, None);
            self.course = None;
        }
    }

    /// The active run.
    pub fn active(&self) -> Option<&RunStatus> {
        self.status.as_ref()?.run.as_ref()
    }

    /// Time since the service last answered, if that is too long; the whole time if it never did.
    pub fn lost_for(&self, now: Timestamp) -> Option<SignedDuration> {
        let silent = now.duration_since(self.heard_at?);
        (silent >= LOST).then_some(silent)
    }

    /// Whether the map is older than it should be.
    pub fn is_map_old(&self, now: Timestamp) -> bool {
        self.active().is_some()
            && self.progress_at.is_some_and(|at| now.duration_since(at) >= OLD_PROGRESS)
    }

    /// Index of the current configuration in the tour.
    pub fn current(&self) -> Option<usize> {
        let of_status = self.active()?.current_step.map(|step| step.index);
        of_status.or_else(|| self.progress.as_ref()?.current)
    }

    /// Marks of all configurations of the tour, in its order.
    pub fn marks(&self) -> Vec<Mark> {
        let Some(tour) = &self.tour else { return Vec::new() };
        let trials = tour.depths_mm.len().max(1);
        let none = RunProgress::default();
        let progress = self.progress.as_ref().unwrap_or(&none);
        let count = |of: &[u16], i: usize| usize::from(of.get(i).copied().unwrap_or(0));
        let mut marks: Vec<Mark> = (0..tour.steps.contacts_mm.len())
            .map(|i| match count(&progress.stored, i) {
                _ if count(&progress.attempts_failed, i) > 0 => Mark::Failed,
                stored if stored >= trials => Mark::Done,
                _ => Mark::Later,
            })
            .collect();
        let mut mark = |i: Option<usize>, mark: Mark| {
            if let Some(place) = i.and_then(|i| marks.get_mut(i)) {
                *place = mark;
            }
        };
        for i in &progress.skipped {
            mark(Some(*i), Mark::Skipped);
        }
        let current = self.current();
        if current.is_some() {
            // The progress is read less often than the status: the next one may have become the current one.
            let next = progress.next.filter(|next| Some(*next) != current);
            mark(next.or(current.map(|current| current + 1)), Mark::Next);
        }
        mark(current, Mark::Now);
        marks
    }

    /// The one thing that a person must do first, with its cause and its command.
    pub fn first(&self) -> (Importance, String) {
        let Some(status) = &self.status else { return (Importance::Routine, "-".into()) };
        match status.needs.first() {
            Some(need) => (need.importance, one_line(&need_words(need))),
            None => (Importance::Routine, "nothing".into()),
        }
    }
}

/// An event that a person may want to know, as one line.
fn told(event: &EventView) -> Option<Told> {
    let words = one_line(&event.words()?);
    Some(Told { at: event.at.parse().ok(), words, level: event.importance() })
}

/// A text of others on one line, without control characters.
pub fn one_line(text: &str) -> String {
    let line: Vec<&str> = text.split_whitespace().collect();
    escaped(&line.join(" ")).into()
}
