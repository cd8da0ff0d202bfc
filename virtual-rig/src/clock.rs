//! The clock of the rig: process seconds since power-up, `rate` of them per wall second. The only
//! place of this crate that reads the time.
//! Never: waiting.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Process time of the rig.
#[derive(Debug, Clone, Copy)]
pub struct RigClock {
    origin: Instant,
    rate: f64,
}

impl RigClock {
    /// Creates a clock that starts now.
    pub fn start(rate: f64) -> Self {
        Self { origin: Instant::now(), rate }
    }

    /// Process seconds since the start.
    pub fn process_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64() * self.rate
    }

    /// Process seconds per wall second.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Wall time until a process time; zero if it is over.
    pub fn wall_until(&self, process_s: f64) -> Duration {
        Duration::from_secs_f64(((process_s - self.process_s()) / self.rate).clamp(0.0, 3600.0))
    }
}

/// Wall seconds since 1970, for receipts that another process compares with its own.
pub fn unix_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}
