//! What a line has done so far, for the metrics and the rig check.
//! Uses: nothing. Never: waits, locks.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

/// What a line has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct LineCounts {
    /// Requests answered soundly.
    pub answered: u64,
    /// Attempts beyond the first.
    pub retries: u64,
    /// Replies that did not come in time.
    pub timeouts: u64,
    /// Replies that made no sense.
    pub garbled: u64,
    /// Modbus exceptions.
    pub exceptions: u64,
    /// Connections opened after the first.
    pub reconnects: u64,
    /// Requests that a stop cut off.
    pub cut_off: u64,
    /// Last request to reply, microseconds; 0 before the first.
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
    /// The counts as they stand.
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
