//! Events as text next to their kinds.
//! PURE. Uses: `view`, `event` of the vocabulary. Never: an event without words.

use crate::cli::view::EventView;
use crate::event;

/// An event as text: its sentence, or what its data states; without the kind, which is in a separate column.
pub fn words(event: &EventView) -> String {
    let words = event::words(&event.kind, &event.data);
    let prefix = format!("{}: ", event::shown_kind(&event.kind));
    words.strip_prefix(&prefix).map_or(words.clone(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn said(kind: &str, data: Value) -> String {
        words(&EventView { kind: kind.into(), seq: 1, run: None, at: String::new(), data })
    }

    #[test]
    fn events_are_sentences_without_their_kind() {
        assert_eq!(said("wanted", json!({ "words": "mount 1 tip" })), "mount 1 tip");
        assert_eq!(said("not_resumed", json!({ "why": "no answer" })), "no answer");
        let trip = json!({ "kind": "force", "detail": "arm 2: 81.0 N over 80.0 N" });
        assert_eq!(said("trip", trip), "trip (force): arm 2: 81.0 N over 80.0 N");
        assert_eq!(said("state", json!({ "n": 1 })), "n 1", "an unknown form");
    }
}
