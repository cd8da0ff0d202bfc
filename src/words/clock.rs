//! The clock: wall time for wires and watchdogs, process time for motion, settling and frames.
//! The only place that converts between the two.
//! Never: sleeping past a stop (callers select on their own stop signals).
//!
//! A rig may run faster than wall time: `clock_rate` in its file is the number of process seconds
//! per wall second. Deadlines of wires, staleness and watchdogs remain wall time.

use std::time::Duration;

use jiff::Timestamp;
use tokio::time::Instant;

/// Duration below which a timer of the runtime (1 ms granularity) is too coarse.
const TIMER_GRAIN: Duration = Duration::from_millis(2);

/// Wall and process time of one rig.
#[derive(Debug, Clone)]
pub struct Clock {
    rate: f64,
    origin: Instant,
}

impl Clock {
    /// Creates a clock with `rate` process seconds per wall second.
    pub fn new(rate: f64) -> Self {
        Self { rate, origin: Instant::now() }
    }

    /// Process seconds per wall second.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Present instant, for deadlines.
    pub fn now(&self) -> Instant {
        Instant::now()
    }

    /// Process seconds since this clock was created.
    pub fn process_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64() * self.rate
    }

    /// Process seconds at an instant.
    pub fn process_s_at(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.origin).as_secs_f64() * self.rate
    }

    /// Wall time of a process duration.
    pub fn wall(&self, process_s: f64) -> Duration {
        Duration::from_secs_f64((process_s / self.rate).max(0.0))
    }

    /// Waits until a process duration has passed. Short waits of an accelerated rig block the
    /// thread, since the timer of the runtime would round them up to a millisecond.
    pub async fn sleep(&self, process_s: f64) {
        let wall = self.wall(process_s);
        if wall >= TIMER_GRAIN {
            tokio::time::sleep(wall).await;
        } else {
            tokio::task::yield_now().await;
            std::thread::sleep(wall);
        }
    }

    /// Time of day: a label of records, never a deadline.
    pub fn timestamp(&self) -> Timestamp {
        Timestamp::now()
    }
}
