//! The clock: wall time for wires and watchdogs, process time for motion, settling and frames.
//! The only place that asks what time it is.
//! Never: sleeping past a stop (callers select on their own stop signals).
//!
//! A rig may run faster than the wall: its file's `clock_rate` says how many process seconds pass
//! in one wall second. Deadlines of wires, staleness and watchdogs stay wall time.

use std::time::Duration;

use jiff::Timestamp;
use tokio::time::Instant;

/// Below this a timer of the runtime (1 ms granularity) is too coarse.
const TIMER_GRAIN: Duration = Duration::from_millis(2);

/// Wall and process time of one rig.
#[derive(Debug, Clone)]
pub struct Clock {
    rate: f64,
    origin: Instant,
}

impl Clock {
    /// A clock on which `rate` process seconds pass in a wall second.
    pub fn new(rate: f64) -> Self {
        Self { rate, origin: Instant::now() }
    }

    /// Process seconds in one wall second.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// The instant, for deadlines.
    pub fn now(&self) -> Instant {
        Instant::now()
    }

    /// Process seconds since this clock was made.
    pub fn process_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64() * self.rate
    }

    /// Process seconds at an instant.
    pub fn process_s_at(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.origin).as_secs_f64() * self.rate
    }

    /// Wall time that a process duration takes.
    pub fn wall(&self, process_s: f64) -> Duration {
        Duration::from_secs_f64((process_s / self.rate).max(0.0))
    }

    /// Waits until a process duration has passed. Short waits of an accelerated rig sleep on the
    /// thread, since the runtime's timer would round them up to a millisecond.
    pub async fn sleep(&self, process_s: f64) {
        let wall = self.wall(process_s);
        if wall >= TIMER_GRAIN {
            tokio::time::sleep(wall).await;
        } else {
            tokio::task::yield_now().await;
            std::thread::sleep(wall);
        }
    }

    /// The time of day: a label on records, never a deadline.
    pub fn timestamp(&self) -> Timestamp {
        Timestamp::now()
    }
}
