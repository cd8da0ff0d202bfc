//! Events as sentences, those that a followed run does not show too.
//! PURE. Uses: `view` (the words of notable events). Never: an event without words.

use serde_json::Value;

use crate::cli::output::{counted, duration};
use crate::cli::view::{EventView, shown_kind};

/// Longest words of an event without a sentence, characters.
const DETAIL: usize = 160;

/// An event as text: its sentence, or what its data states.
pub fn words(event: &EventView) -> String {
    let words = sentence(&event.kind, &event.data).or_else(|| event.words());
    let words = words.unwrap_or_else(|| detail(&event.data));
    // The kind is in a separate column.
    let prefix = format!("{}: ", shown_kind(&event.kind));
    words.strip_prefix(&prefix).map_or(words.clone(), str::to_owned)
}

/// Sentences of kinds that `EventView::words` leaves to the progress of a run.
fn sentence(kind: &str, data: &Value) -> Option<String> {
    let text = |key: &str| data[key].as_str().map(|text| text.replace('_', " "));
    let number = |key: &str| data[key].as_f64();
    Some(match kind {
        "state" => {
            let why = text("why").map_or_else(String::new, |why| format!(" ({why})"));
            let state = text("state")?;
            let requested = text("requested").filter(|requested| *requested != state);
            let requested = requested.map_or_else(String::new, |to| format!(", {to} is requested"));
            format!("{state}{why}{requested}")
        }
        "ended" => format!("{}: {}", text("exit_status")?, data["reason"].as_str()?),
        "rig" => text("state")?,
        "device" => format!("{}: {}", data["device"].as_str()?, data["found"].as_str()?),
        "tips" => {
            let tips = counted(data["tips"].as_u64()?, "tip", "tips");
            let who = data["who"].as_str().map_or_else(String::new, |who| format!(", by {who}"));
            format!("{tips} mounted{who}")
        }
        "touch_off" => {
            let tips = counted(data["tips"].as_u64()?, "tip", "tips");
            format!("surface at z {:.2} mm, {tips}", number("surface_z_mm")?)
        }
        "reference" => format!("reference press before configuration {}", data["before"]),
        "estimate" => {
            let [left, low, high] =
                ["remaining_s", "low_s", "high_s"].map(|key| number(key).map(duration));
            format!("{} to go ({} .. {})", left?, low?, high?)
        }
        "safe_end" if data["tips"] != "not_raised" => {
            let axes = counted(data["stops"].as_array().map_or(0, Vec::len) as u64, "axis", "axes");
            format!("{axes} stopped, tips {}, {:.1} ms", text("tips")?, number("took_ms")?)
        }
        _ => return None,
    })
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
    use super::*;
    use serde_json::json;

    fn said(kind: &str, data: Value) -> String {
        words(&EventView { kind: kind.into(), seq: 1, run: None, at: String::new(), data })
    }

    #[test]
    fn events_are_sentences_without_their_kind() {
        let pausing = json!({ "state": "pausing", "why": "tip_change", "requested": "paused" });
        assert_eq!(said("state", pausing), "pausing (tip change), paused is requested");
        let ended = json!({ "exit_status": "success", "reason": "every planned trial is stored" });
        assert_eq!(said("ended", ended), "success: every planned trial is stored");
        assert_eq!(said("wanted", json!({ "words": "mount 1 tip" })), "mount 1 tip");
        assert_eq!(said("tips", json!({ "tips": 4, "who": "Ada" })), "4 tips mounted, by Ada");
        let trip = json!({ "kind": "force", "detail": "arm 2: 81.0 N over 80.0 N" });
        assert_eq!(said("trip", trip), "trip (force): arm 2: 81.0 N over 80.0 N");
        let estimate = json!({ "remaining_s": 44.4, "low_s": 37.7, "high_s": 51.1 });
        assert_eq!(said("estimate", estimate), "44 s to go (38 s .. 51 s)");
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
        assert_eq!(said("state", json!({ "n": 1 })), "n 1", "an unknown form");
    }
}
