//! Counters of a line, for the metrics and the rig check.
//! Uses: nothing. Never: waits, locks.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

/// Counters of a line since it was created.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct LineCounts {
    /// Number of requests with a valid reply.
    pub answered: u64,
    /// Number of attempts after the first.
    pub retries: u64,
    /// Number of replies that did not arrive in time.
    pub timeouts: u64,
    /// Number of invalid replies.
    pub garbled: u64,
    /// Number of Modbus exceptions.
    pub exceptions: u64,
    /// Number of connections opened after the first.
    pub reconnects: u64,
    /// Number of requests that a stop interrupted.
    pub cut_off: u64,
    /// Time from the last request to its reply, us; 0 before the first.
    pub last_round_trip_us: u64,
}

#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) answered: AtomicU64,
    pub(super) retries: AtomicU64,
    pub(super) timeouts: AtomicU64,
    pub(super) garbled: AtomicU64,
    pub(super) exceptions: AtomicU64,
    pub(super) reconnects: AtomicU64,
    pub(super) cut_off: AtomicU64,
    pub(super) last_round_trip_us: AtomicU64,
}

pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

impl Counters {
    /// Returns the present values.
    pub(super) fn counts(&self) -> LineCounts {
        let get = |c: &AtomicU64| c.load(Ordering::Relaxed);
        LineCounts {
            answered: get(&self.answered),
            retries: get(&self.retries),
            timeouts: get(&self.timeouts),
            garbled: get(&self.garbled),
            exceptions: get(&self.exceptions),
            reconnects: get(&self.reconnects),
            cut_off: get(&self.cut_off),
            last_round_trip_us: get(&self.last_round_trip_us),
        }
    }
}
