//! Events: their kinds, how much each one matters to a person, and its sentence. The history of a run, its report,
//! the page and the terminal use this one definition.
//! PURE. Uses: `plain`, `state`. Never: an event without a sentence, the place where an event is written.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::plain::{counted, duration};
use crate::state::{PausedWhy, StoredState};

/// Longest words of an event without a sentence, characters.
const DETAIL: usize = 160;

/// How much an event matters to a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Importance {
    /// Part of the normal course.
    Routine,
    /// A person who returns should read it.
    Notable,
    /// A person should look.
    Look,
    /// A person must act.
    Act,
}

/// A kind of events, with what its events mean to a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EventKind {
    /// Name of the kind, as stored.
    pub name: &'static str,
    /// Largest importance of its events; [`importance`] states that of one event.
    pub most: Importance,
    /// What an event of this kind reports.
    pub about: &'static str,
}

const fn kind(name: &'static str, most: Importance, about: &'static str) -> EventKind {
    EventKind { name, most, about }
}

/// All kinds of events that the program writes.
#[rustfmt::skip]
pub const KINDS: [EventKind; 23] = [
    kind("trip", Importance::Act, "A limit or a fault tripped the rig."),
    kind("safe_end", Importance::Act, "The axes were stopped and the tips raised, or not raised."),
    kind("not_resumed", Importance::Act, "A run was not resumed after the start of the service."),
    kind("not_begun", Importance::Act, "A run that waited for its turn does not begin."),
    kind("store", Importance::Act, "A record could not be stored: the run is suspended."),
    kind("diary_gap", Importance::Act, "Events are missing here: they could not be stored."),
    kind("state", Importance::Act, "The run has another state."),
    kind("suspended", Importance::Look, "A monitor suspended the run."),
    kind("wanted", Importance::Look, "The run waits for a person."),
    kind("skipped", Importance::Look, "A configuration was given up."),
    kind("attempt_failed", Importance::Look, "An attempt at a trial failed."),
    kind("twins", Importance::Look, "The fit of the simulated twins has another level."),
    kind("placed", Importance::Look, "A person confirmed a placement of weights."),
    kind("tips", Importance::Notable, "A person entered the number of mounted tips."),
    kind("repeat", Importance::Notable, "A trial is repeated on request."),
    kind("recovering", Importance::Notable, "The service checks whether the cause of a trip is gone."),
    kind("resumed", Importance::Notable, "A run was resumed after the start of the service."),
    kind("ended", Importance::Notable, "The run has ended."),
    kind("rig", Importance::Routine, "The rig has another state."),
    kind("device", Importance::Routine, "A device answered when the wires were opened."),
    kind("touch_off", Importance::Routine, "The surface was found."),
    kind("reference", Importance::Routine, "A reference press was made."),
    kind("estimate", Importance::Routine, "The end of the run was estimated."),
];

/// Kinds with events that are at least notable, without `state`: a history lists the states themselves.
pub fn notable_kinds() -> impl Iterator<Item = &'static str> {
    let notable = KINDS.iter().filter(|kind| kind.most >= Importance::Notable);
    notable.map(|kind| kind.name).filter(|name| *name != "state")
}

/// Importance of an event; routine for an unknown kind.
pub fn importance(kind: &str, data: &Value) -> Importance {
    let known = KINDS.iter().find(|known| known.name == kind);
    let most = known.map_or(Importance::Routine, |known| known.most);
    match kind {
        "safe_end" if data["tips"] != "not_raised" => Importance::Routine,
        "twins" if data["level"] == "ok" => Importance::Notable,
        // It was confirmed, and the skin did not contradict it.
        "placed" if data["verdict"] != "wrong" => Importance::Routine,
        "state" => importance_of_state(data),
        _ => most,
    }
}

/// Whether an event requests the placement of weights for a manual trial. A person must see it while the run waits for
/// it; there is one for each trial, and a list of what happened excludes them. A failed attempt is another event.
pub fn is_placement(kind: &str, data: &Value) -> bool {
    kind == "wanted" && data["wanted"]["contacts"].is_array()
}

fn importance_of_state(data: &Value) -> Importance {
    let why = PausedWhy::deserialize(&data["why"]).ok();
    // The event `wanted` reports these.
    let is_wanted = matches!(why, Some(PausedWhy::TipChange | PausedWhy::ManualTrial));
    match StoredState::deserialize(&data["state"]).ok() {
        Some(StoredState::Panicked) => Importance::Act,
        Some(StoredState::Paused | StoredState::Interrupted) if !is_wanted => Importance::Notable,
        Some(
            StoredState::Queued
            | StoredState::Idle
            | StoredState::Running
            | StoredState::Pausing
            | StoredState::Paused
            | StoredState::Stopping
            | StoredState::Aborting
            | StoredState::Suspending
            | StoredState::Interrupted
            | StoredState::Ended
            | StoredState::Removed,
        )
        | None => Importance::Routine,
    }
}

/// Kind of an event as text for a person.
pub fn shown_kind(kind: &str) -> String {
    kind.replace('_', " ")
}

/// An event as text: its sentence, or its kind with what its data states.
pub fn words(kind: &str, data: &Value) -> String {
    sentence(kind, data).unwrap_or_else(|| {
        let stated = detail(data);
        let separator = if stated.is_empty() { "" } else { ": " };
        format!("{}{separator}{stated}", shown_kind(kind))
    })
}

/// The sentence of an event; `None` for an unknown kind, or data of another form.
fn sentence(kind: &str, data: &Value) -> Option<String> {
    let text = |key: &str| data[key].as_str();
    let plain = |key: &str| text(key).map(|text| text.replace('_', " "));
    let number = |key: &str| data[key].as_f64();
    Some(match kind {
        "state" => {
            let why = plain("why").map_or_else(String::new, |why| format!(" ({why})"));
            let state = plain("state")?;
            let requested = plain("requested").filter(|requested| *requested != state);
            let requested = requested.map_or_else(String::new, |to| format!(", {to} is requested"));
            format!("run {state}{why}{requested}")
        }
        "rig" => format!("rig {}", plain("state")?),
        "device" => format!("{}: {}", text("device")?, text("found")?),
        "trip" => format!("trip ({}): {}", plain("kind")?, text("detail")?),
        "wanted" | "twins" => format!("{kind}: {}", text("words")?),
        "suspended" | "store" | "not_resumed" | "not_begun" => {
            format!("{}: {}", shown_kind(kind), text("why")?)
        }
        "resumed" => "resumed after the start of the service".into(),
        "skipped" => {
            format!("skipped configuration {}: {}", data["configuration"], text("reason")?)
        }
        "attempt_failed" => {
            let of = of_trial(&data["trial"]);
            format!("attempt {}{of} failed: {}", data["attempt"], text("reason")?)
        }
        "repeat" => format!("trial{} is repeated: {}", of_trial(&data["trial"]), text("why")?),
        "recovering" if data["ended"] == true => {
            let why = text("why").map_or_else(String::new, |why| format!(": {why}"));
            format!("no longer recovering automatically{why}")
        }
        "recovering" => "recovering: checking whether the cause is gone".into(),
        "ended" => match (plain("exit_status")?, text("reason")?) {
            // "stopped at 56 of 264 trials" states both.
            (status, reason) if reason.starts_with(&status) => format!("run ended, {reason}"),
            (status, reason) => format!("run ended, {status}: {reason}"),
        },
        "tips" => {
            let tips = counted(data["tips"].as_u64()?, "tip", "tips");
            let who = text("who").map_or_else(String::new, |who| format!(", by {who}"));
            let cells = data["live_cells"].as_u64();
            let cells = cells.map(|cells| counted(cells, "load cell", "load cells"));
            let cells = cells.map_or_else(String::new, |cells| format!("; {cells} connected"));
            format!("{tips} mounted{who}{cells}")
        }
        "placed" => {
            let felt = plain("verdict").filter(|verdict| verdict != "unknown");
            let felt = felt.map_or_else(String::new, |felt| format!(", felt {felt}"));
            let anyway = if data["anyway"] == true { ", stored anyway" } else { "" };
            format!("placement {} confirmed by {}{felt}{anyway}", data["trial"], text("who")?)
        }
        "touch_off" => {
            let tips = counted(data["tips"].as_u64()?, "tip", "tips");
            format!("surface at z {:.2} mm, {tips}", number("surface_z_mm")?)
        }
        "reference" => {
            let flags = data["flags"].as_array().into_iter().flatten().filter_map(Value::as_str);
            let flags: Vec<String> = flags.map(|flag| flag.replace('_', " ")).collect();
            let press = format!("reference press before configuration {}", data["before"]);
            if flags.is_empty() { press } else { format!("{press}, {}", flags.join(", ")) }
        }
        "estimate" => {
            let [left, low, high] =
                ["remaining_s", "low_s", "high_s"].map(|key| number(key).map(duration));
            format!("{} to go ({} .. {})", left?, low?, high?)
        }
        "safe_end" if data["tips"] == "not_raised" => format!("TIPS NOT RAISED: {}", text("why")?),
        "safe_end" => {
            let axes = counted(data["stops"].as_array().map_or(0, Vec::len) as u64, "axis", "axes");
            format!("{axes} stopped, tips {}, {:.1} ms", plain("tips")?, number("took_ms")?)
        }
        "diary_gap" => {
            format!("{} events are missing here: they could not be stored", data["notes"])
        }
        _ => return None,
    })
}

/// ` of configuration 3, depth 1`; empty without a trial.
fn of_trial(key: &Value) -> String {
    match (key["configuration"].as_u64(), key["depth_index"].as_u64()) {
        (Some(configuration), Some(depth)) => {
            format!(" of configuration {configuration}, depth {depth}")
        }
        _ => String::new(),
    }
}

/// The fields of an object, `name value` each; lists by their size.
fn detail(data: &Value) -> String {
    let Some(fields) = data.as_object() else { return data.to_string() };
    if let Some(words) = fields.get("words").and_then(Value::as_str) {
        return words.to_owned();
    }
    let field = |(key, value): (&String, &Value)| {
        let value = match value {
            Value::Null => return None,
            Value::String(text) => text.clone(),
            Value::Number(number) => match number.as_f64() {
                Some(value) if number.is_f64() => format!("{value:.3}"),
                _ => number.to_string(),
            },
            Value::Bool(value) => value.to_string(),
            Value::Array(list) if list.is_empty() => return None,
            Value::Array(list) => format!("({})", list.len()),
            Value::Object(inner) => {
                let plain = |value: &Value| !value.is_array() && !value.is_object();
                match inner.values().all(plain) {
                    true => format!("({})", detail(value)),
                    false => return None,
                }
            }
        };
        Some(format!("{} {value}", key.replace('_', " ")))
    };
    let words = fields.iter().filter_map(field).collect::<Vec<_>>().join(", ");
    match words.char_indices().nth(DETAIL) {
        Some((end, _)) => format!("{}…", &words[..end]),
        None => words,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use serde_json::json;

    #[test]
    fn every_kind_is_listed_once_and_described() {
        let names: BTreeSet<&str> = KINDS.iter().map(|kind| kind.name).collect();
        assert_eq!(names.len(), KINDS.len());
        assert!(KINDS.iter().all(|kind| kind.about.ends_with('.')));
        let notable: Vec<&str> = notable_kinds().collect();
        assert!(notable.contains(&"ended") && !notable.contains(&"state"));
        assert!(!notable.contains(&"touch_off"));
    }

    #[test]
    fn the_importance_of_an_event_follows_from_its_kind_and_its_data() {
        let safe_end = |tips| importance("safe_end", &json!({ "tips": tips, "why": "z lost" }));
        assert_eq!(safe_end("raised"), Importance::Routine);
        assert_eq!(safe_end("not_raised"), Importance::Act);
        let state =
            |state, why: Option<&str>| importance("state", &json!({ "state": state, "why": why }));
        assert_eq!(state("running", None), Importance::Routine);
        assert_eq!(state("paused", Some("operator")), Importance::Notable);
        assert_eq!(state("paused", Some("tip_change")), Importance::Routine);
        assert_eq!(state("panicked", Some("trip")), Importance::Act);
        let twins = |level| importance("twins", &json!({ "level": level }));
        assert_eq!((twins("ok"), twins("warn")), (Importance::Notable, Importance::Look));
        let placed = |verdict| importance("placed", &json!({ "verdict": verdict }));
        assert_eq!((placed("right"), placed("wrong")), (Importance::Routine, Importance::Look));
        assert_eq!(importance("trip", &json!({})), Importance::Act);
        let weights = json!({ "words": "place", "wanted": { "trial": 3, "contacts": [] } });
        assert_eq!(importance("wanted", &weights), Importance::Look, "while the run waits");
        assert!(is_placement("wanted", &weights));
        assert!(!is_placement("wanted", &json!({ "wanted": { "tips": 1 } })));
        assert!(!is_placement("placed", &weights));
        assert_eq!(importance("a later kind", &json!({})), Importance::Routine);
    }

    #[test]
    fn events_are_sentences() {
        let pausing = json!({ "state": "pausing", "why": "tip_change", "requested": "paused" });
        assert_eq!(words("state", &pausing), "run pausing (tip change), paused is requested");
        let ended = json!({ "exit_status": "success", "reason": "every planned trial is stored" });
        assert_eq!(words("ended", &ended), "run ended, success: every planned trial is stored");
        let short = json!({ "exit_status": "stopped", "reason": "stopped at 56 of 264 trials" });
        assert_eq!(words("ended", &short), "run ended, stopped at 56 of 264 trials");
        assert_eq!(words("wanted", &json!({ "words": "mount 1 tip" })), "wanted: mount 1 tip");
        let tips = json!({ "tips": 4, "who": "Ada", "live_cells": 6 });
        assert_eq!(words("tips", &tips), "4 tips mounted, by Ada; 6 load cells connected");
        let trip = json!({ "kind": "force", "detail": "arm 2: 81.0 N over 80.0 N" });
        assert_eq!(words("trip", &trip), "trip (force): arm 2: 81.0 N over 80.0 N");
        let estimate = json!({ "remaining_s": 44.4, "low_s": 37.7, "high_s": 51.1 });
        assert_eq!(words("estimate", &estimate), "44 s to go (38 s .. 51 s)");
        let failed = json!({ "trial": { "configuration": 3, "depth_index": 1 }, "attempt": 2,
            "reason": "no settling" });
        let shown = "attempt 2 of configuration 3, depth 1 failed: no settling";
        assert_eq!(words("attempt_failed", &failed), shown);
        let reference = json!({ "before": 4, "flags": ["unsettled", "depth_missed"] });
        let shown = "reference press before configuration 4, unsettled, depth missed";
        assert_eq!(words("reference", &reference), shown);
        assert_eq!(words("reference", &json!({ "before": 4 })), &shown[..38]);
        let resumed = json!({ "attempt": 1, "why": "no answer" });
        assert_eq!(words("not_resumed", &resumed), "not resumed: no answer");
        let placed = json!({ "trial": 3, "who": "Ada", "verdict": "wrong", "anyway": true });
        let shown = "placement 3 confirmed by Ada, felt wrong, stored anyway";
        assert_eq!(words("placed", &placed), shown);
        assert_eq!(
            words("recovering", &json!({ "ended": true, "why": null })),
            "no longer recovering automatically"
        );
    }

    #[test]
    fn an_event_without_a_sentence_states_its_data() {
        let data = json!({ "trials_stored": 12, "remaining_s": 8.12345, "why": null,
            "key": { "configuration": 3, "depth_index": 1 }, "arms": [1, 2] });
        let stated = detail(&data);
        for part in ["trials stored 12", "remaining s 8.123", "arms (2)", "configuration 3"] {
            assert!(stated.contains(part), "{part}: {stated}");
        }
        assert!(!stated.contains("why"));
        assert_eq!(detail(&json!({ "words": "armed", "n": 1 })), "armed");
        assert!(detail(&json!({ "why": "ä".repeat(500) })).chars().count() <= DETAIL + 1);
        assert_eq!(words("state", &json!({ "n": 1 })), "state: n 1", "an unknown form");
        assert_eq!(words("a_later_kind", &json!({})), "a later kind");
    }
}
