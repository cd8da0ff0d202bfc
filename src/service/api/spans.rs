//! The states of a run over time, from the events of its changes.
//! PURE. Uses: `journal` (its events), `state`. Never: the store.
//!
//! A change of state is an event. A process that ends without warning stores none: the next process
//! begins with `running`, after a change to the state that the run had before. There the run was
//! interrupted since its last record.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::journal::Event;
use crate::state::{PausedWhy, StoredState};

/// A state of a run, from a time until the next.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StateSpan {
    /// State that the run had.
    pub state: StoredState,
    /// Reason why the run waits or is about to wait; null in other states.
    pub why: Option<PausedWhy>,
    /// Wall time at which the run reached it.
    pub from: Timestamp,
    /// Wall time at which the run left it; null while it lasts.
    pub to: Option<Timestamp>,
}

/// State of a change, with its reason.
#[derive(Deserialize)]
struct Change {
    state: StoredState,
    why: Option<PausedWhy>,
}

fn changes(events: &[Event]) -> impl Iterator<Item = (Timestamp, Change)> + '_ {
    let change = |event: &Event| {
        let change = Change::deserialize(&event.data).ok()?;
        Some((event.at, change))
    };
    events.iter().filter_map(change)
}

/// Whether a change from one state to the next is the start of another process: within a process a state
/// follows another one, and `running` follows only what may be resumed.
fn is_restart(before: StoredState, next: StoredState) -> bool {
    use StoredState::{Aborting, Panicked, Running, Stopping, Suspending};
    next == Running && matches!(before, Running | Stopping | Aborting | Suspending | Panicked)
}

/// Returns the times at which a later process continued a run that an earlier one did not end.
///
/// `events`: changes of state, oldest first.
pub fn restarts(events: &[Event]) -> Vec<Timestamp> {
    let mut before = None;
    let mut found = Vec::new();
    for (at, change) in changes(events) {
        if before.is_some_and(|before| is_restart(before, change.state)) {
            found.push(at);
        }
        before = Some(change.state);
    }
    found
}

/// Returns the states of a run over time, oldest first.
///
/// `events`: changes of state, oldest first. `last_records`: for each time of [`restarts`] that of the
/// last record before it. `ended_at`: end of the run. `interrupted_at`: time of the last record of a run
/// that is interrupted now.
pub fn spans(
    events: &[Event],
    last_records: &[Timestamp],
    ended_at: Option<Timestamp>,
    interrupted_at: Option<Timestamp>,
) -> Vec<StateSpan> {
    let interrupted = |from, to| StateSpan {
        state: StoredState::Interrupted,
        why: Some(PausedWhy::Restart),
        from,
        to,
    };
    let mut last_records = last_records.iter().copied();
    let mut spans: Vec<StateSpan> = Vec::new();
    for (at, Change { state, why }) in changes(events) {
        if let Some(last) = spans.last_mut() {
            last.to = Some(at);
            if is_restart(last.state, state) {
                let record = last_records.next().unwrap_or(at).clamp(last.from, at);
                last.to = Some(record);
                spans.push(interrupted(record, Some(at)));
            }
        }
        spans.push(StateSpan { state, why, from: at, to: None });
    }
    if let Some(last) = spans.last_mut() {
        last.to = ended_at.or(interrupted_at).map(|to| to.max(last.from));
    }
    if let Some(from) = interrupted_at.filter(|_| ended_at.is_none()) {
        spans.push(interrupted(from, None));
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(second).unwrap()
    }

    fn event(second: i64, state: StoredState, why: Option<PausedWhy>) -> Event {
        let data = json!({ "state": state, "requested": null, "why": why });
        Event { seq: second, run: None, at: at(second), kind: "state".into(), data }
    }

    fn shown(spans: &[StateSpan]) -> Vec<(StoredState, i64, Option<i64>)> {
        let second = |t: Timestamp| t.as_second();
        spans.iter().map(|s| (s.state, second(s.from), s.to.map(second))).collect()
    }

    #[test]
    fn a_state_lasts_until_the_next_one_or_the_end() {
        use StoredState::{Paused, Pausing, Running};
        let tips = Some(PausedWhy::TipChange);
        let events = [
            event(10, Running, None),
            event(20, Pausing, tips),
            event(21, Paused, tips),
            event(30, Running, None),
        ];
        assert!(restarts(&events).is_empty());
        let ended = spans(&events, &[], Some(at(50)), None);
        let wanted = [
            (Running, 10, Some(20)),
            (Pausing, 20, Some(21)),
            (Paused, 21, Some(30)),
            (Running, 30, Some(50)),
        ];
        assert_eq!(shown(&ended), wanted);
        assert_eq!((ended[0].why, ended[2].why), (None, tips));
        let active = spans(&events, &[], None, None);
        assert_eq!(shown(&active)[3], (Running, 30, None));
        assert_eq!(spans(&[], &[], None, None), []);
    }

    #[test]
    fn a_crash_interrupts_since_the_last_record() {
        use StoredState::{Interrupted, Running};
        let events = [event(10, Running, None), event(40, Running, None)];
        assert_eq!(restarts(&events), [at(40)]);
        let resumed = spans(&events, &[at(25)], None, None);
        let wanted = [(Running, 10, Some(25)), (Interrupted, 25, Some(40)), (Running, 40, None)];
        assert_eq!(shown(&resumed), wanted);
        let killed = spans(&events[..1], &[], None, Some(at(25)));
        assert_eq!(shown(&killed), [(Running, 10, Some(25)), (Interrupted, 25, None)]);
        assert_eq!(killed[1].why, Some(PausedWhy::Restart));
    }
}
