//! The parts of the service's answers that the command line reads.
//! Uses: serde, the status of `campaign`, ratings of `api`. Never: fields that are not shown or used.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::care::CareView;
use super::times::local;
use crate::api::Rating;
use crate::campaign::shown::run_action::ActionOnRun;
use crate::campaign::shown::status::{RigStatus, RunStatus};
use crate::conductor::Started;
use crate::event::{self, Importance};
use crate::ids::RunUid;
use crate::store::LockRow;

/// `GET /api/v1/status`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct StatusView {
    /// Time of the service at which it was made; absent from an older service.
    #[serde(default)]
    pub at: Option<Timestamp>,
    /// Rig part of the status.
    pub rig: RigStatus,
    /// The active run.
    pub run: Option<RunStatus>,
    /// Service part of the status.
    pub service: ServiceView,
    /// The operator lock, while it is held.
    pub lock: Option<LockRow>,
    /// Number of runs that wait in the queue.
    pub queue_length: usize,
    /// What the next started run waits for, as text.
    pub waiting_for: Option<String>,
    /// What may be asked of runs now; empty from an older service.
    #[serde(default)]
    pub run_actions: Vec<ActionView>,
    /// What a person must do, the most urgent first; empty from an older service.
    #[serde(default)]
    pub needs: Vec<NeedView>,
    /// The night at a glance; empty from an older service.
    #[serde(default)]
    pub glance: Vec<GlanceView>,
    /// Disk, last trial, suspenders.
    #[serde(flatten)]
    pub care: CareView,
}

/// Whether an action is possible now.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ActionView {
    /// Name of the action, as in a request.
    pub action: String,
    /// Why it would be refused, as text.
    pub refused: Option<String>,
}

impl StatusView {
    /// What may be asked of the active run now, as text; absent without a run.
    pub fn asked_of_run(&self) -> Option<String> {
        self.run.as_ref()?;
        let start = ActionOnRun::Start.as_str();
        let possible = |one: &&ActionView| one.refused.is_none() && one.action != start;
        let names: Vec<&str> =
            self.run_actions.iter().filter(possible).map(|one| one.action.as_str()).collect();
        (!names.is_empty()).then(|| names.join(", "))
    }

    /// Lines of `palpate status`: what a person must do, each with its command, and the night at a glance.
    pub fn answers(&self) -> Vec<String> {
        let needs = self.needs.iter().map(|need| {
            let since = need.since.map(|at| format!("since {}: ", local(at)));
            format!("needs    {}{}", since.unwrap_or_default(), need_words(need))
        });
        let glances =
            self.glance.iter().map(|glance| format!("{:<8} {}", glance.title(), glance.words));
        needs.chain(glances).collect()
    }
}

/// What a person must do, of any kind: a newer service may have further ones.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct NeedView {
    /// `act` or `look`.
    pub importance: Importance,
    /// The need as sentences, with its cause.
    pub words: String,
    /// The command that does it, or that shows more.
    pub command: Option<String>,
    /// Time since which it is.
    pub since: Option<Timestamp>,
}

/// An answer of the glance. A newer service may have further questions and ratings.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct GlanceView {
    question: String,
    rating: Value,
    /// The reason, as sentences.
    pub words: String,
}

impl GlanceView {
    /// The question, as the name of a line.
    pub fn title(&self) -> String {
        self.question.replace('_', " ")
    }

    /// The answer; none if this version does not know it.
    pub fn rating(&self) -> Option<Rating> {
        Rating::deserialize(&self.rating).ok()
    }
}

/// A need with its command, as text.
pub fn need_words(need: &NeedView) -> String {
    let next = need.command.as_ref().map(|command| format!(" Next: {command}"));
    format!("{}{}", need.words, next.unwrap_or_default())
}

/// The entries of a list in an answer; none if it is absent.
pub fn rows<'a>(of: &'a Value, key: &str) -> &'a [Value] {
    of[key].as_array().map_or(&[], Vec::as_slice)
}

/// Service part of the status.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ServiceView {
    /// Version of the program.
    pub version: String,
    /// Path of the database file.
    pub database: String,
}

/// `POST /api/v1/runs/{run}/arm`.
#[derive(Debug, Clone, Deserialize)]
pub struct ArmedView {
    /// Code that starts the run.
    pub code: String,
    /// Preflight of the run.
    pub preflight: PreflightView,
}

/// Fields of a preflight that are shown before a start.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct PreflightView {
    /// Number of planned trials.
    pub trials: u64,
    /// Predicted duration, wall s.
    pub duration_s: f64,
    /// Lower end of the predicted duration, wall s.
    pub duration_low_s: f64,
    /// Upper end of the predicted duration, wall s.
    pub duration_high_s: f64,
    /// Predicted size of the stored data, bytes.
    pub disk_bytes: u64,
}

/// `POST /api/v1/runs/{run}/actions` with `start`.
#[derive(Debug, Clone, Deserialize)]
pub struct TakenUpView {
    /// Whether it is active or waits.
    pub started: Option<Started>,
}

/// An event of the service, as `GET /api/v1/events` returns it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventView {
    /// Kind of the event.
    #[serde(rename(serialize = "event"))]
    pub kind: String,
    /// Number of the event.
    pub seq: i64,
    /// Run of the event, if any.
    pub run: Option<RunUid>,
    /// Wall time, RFC 3339.
    pub at: String,
    /// Data of the event.
    pub data: Value,
}

impl EventView {
    /// How much the event matters to a person.
    pub fn importance(&self) -> Importance {
        event::importance(&self.kind, &self.data)
    }

    /// Whether it requests the placement of weights for a manual trial.
    pub fn is_placement(&self) -> bool {
        event::is_placement(&self.kind, &self.data)
    }

    /// The event as text without its kind, for a column next to that of the kinds.
    pub fn sentence(&self) -> String {
        let words = event::words(&self.kind, &self.data);
        let prefix = format!("{}: ", event::shown_kind(&self.kind));
        words.strip_prefix(&prefix).map_or(words.clone(), str::to_owned)
    }

    /// Text for a person who follows the run; `None` for events that the progress shows.
    pub fn words(&self) -> Option<String> {
        let matters = self.importance() >= Importance::Notable;
        matters.then(|| format!("{}{}", event::words(&self.kind, &self.data), self.weights()))
    }

    /// Positions of the weights to place.
    fn weights(&self) -> String {
        let line = |contact: &Value| {
            let [x, y, force] =
                ["x_mm", "y_mm", "force_n"].map(|key| contact[key].as_f64().unwrap_or(f64::NAN));
            format!("\n    {force:.3} N at x {x:.1}, y {y:.1} mm")
        };
        rows(&self.data["wanted"], "contacts").iter().map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn event(kind: &str, data: Value) -> EventView {
        EventView { kind: kind.into(), seq: 7, run: None, at: "now".into(), data }
    }

    #[test]
    fn needs_and_answers_of_a_newer_service_are_read() {
        let need = json!({ "kind": "later", "importance": "act", "words": "Fill it.",
            "command": "palpate fill", "page": "later", "since": null });
        let need: NeedView = serde_json::from_value(need).unwrap();
        assert_eq!(need_words(&need), "Fill it. Next: palpate fill");
        let glance = |question: &str, rating: &str| {
            let glance = json!({ "question": question, "rating": rating, "words": "Over it." });
            let glance: GlanceView = serde_json::from_value(glance).unwrap();
            (glance.title(), glance.rating())
        };
        assert_eq!(glance("on_time", "good"), ("on time".into(), Some(Rating::Good)));
        assert_eq!(glance("on_budget", "dire"), ("on budget".into(), None));
    }

    #[test]
    fn notable_events_have_words_and_others_none() {
        let words = |kind, data| event(kind, data).words();
        let trip = json!({ "kind": "force", "detail": "arm 2: 81.0 N over 80.0 N" });
        assert_eq!(words("trip", trip).unwrap(), "trip (force): arm 2: 81.0 N over 80.0 N");
        let paused = |why: &str| words("state", json!({ "state": "paused", "why": why }));
        assert_eq!(paused("operator").unwrap(), "run paused (operator)");
        assert_eq!(paused("tip_change"), None);
        let wanted = json!({ "words": "place 1 weights", "wanted": { "trial": 3, "contacts": [
            { "x_mm": 100.0, "y_mm": 80.04, "force_n": 4.905 },
        ]}});
        let shown = "wanted: place 1 weights\n    4.905 N at x 100.0, y 80.0 mm";
        assert_eq!(words("wanted", wanted).unwrap(), shown);
        assert_eq!(words("state", json!({ "state": "running" })), None);
        assert_eq!(words("touch_off", json!({})), None);
    }

    #[test]
    fn a_sentence_leaves_its_kind_to_another_column() {
        let said = |kind, data| event(kind, data).sentence();
        assert_eq!(said("wanted", json!({ "words": "mount 1 tip" })), "mount 1 tip");
        assert_eq!(said("not_resumed", json!({ "why": "no answer" })), "no answer");
        let trip = json!({ "kind": "force", "detail": "arm 2: 81.0 N over 80.0 N" });
        assert_eq!(said("trip", trip), "trip (force): arm 2: 81.0 N over 80.0 N");
        assert_eq!(said("state", json!({ "n": 1 })), "n 1", "an unknown form");
    }

    #[test]
    fn an_event_for_scripts_carries_its_kind_as_event() {
        let line = serde_json::to_value(event("wanted", json!({}))).unwrap();
        assert_eq!(line["event"], "wanted");
        assert_eq!(line["seq"], 7);
    }
}
