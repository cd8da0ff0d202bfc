//! Which frames the readout takes, and of which load. A frame during which the load changed belongs
//! to no load and is dropped.
//! PURE. Uses: `bench::contact`. Never: voltages, packets, clocks.

use std::collections::VecDeque;
use std::sync::Arc;

use super::contact::Load;

/// Largest number of frames that wait for the stream; beyond it the oldest are lost.
const WAITING_MAX: usize = 4096;
/// A pause of the process longer than this number of frames is skipped, not caught up.
const CATCH_UP_MAX: f64 = 50_000.0;

/// A frame that was taken under one held load.
#[derive(Debug, Clone)]
pub struct TakenFrame {
    /// Sequence number of the device.
    pub sequence: u32,
    /// Process time of its first sample, s.
    pub first_sample_s: f64,
    /// Load during the whole frame.
    pub load: Arc<Load>,
}

/// Sequence of frames of the readout.
pub struct FrameLedger {
    rate_hz: f64,
    next: u64,
    spoilt: bool,
    waiting: VecDeque<TakenFrame>,
    dropped: u64,
}

impl FrameLedger {
    /// Creates a readout that starts at process time zero.
    pub fn new(rate_hz: f64) -> Self {
        Self { rate_hz, next: 0, spoilt: false, waiting: VecDeque::new(), dropped: 0 }
    }

    /// Process time at which the frame in progress ends, s.
    pub fn end_s(&self) -> f64 {
        (self.next + 1) as f64 / self.rate_hz
    }

    /// Sequence number of the frame in progress.
    pub fn sequence(&self) -> u32 {
        self.next as u32
    }

    /// Number of frames dropped because their load changed or because they were not taken in time.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Records that the load changed during the frame in progress.
    pub fn spoil(&mut self) {
        self.spoilt = true;
    }

    /// Whether the frame in progress is spoilt.
    pub fn spoilt(&self) -> bool {
        self.spoilt
    }

    /// Ends the frame in progress.
    pub fn finish(&mut self, load: impl FnOnce() -> Arc<Load>) {
        if self.spoilt {
            self.dropped += 1;
        } else {
            if self.waiting.len() >= WAITING_MAX {
                self.waiting.pop_front();
                self.dropped += 1;
            }
            let first_sample_s = self.next as f64 / self.rate_hz;
            let sequence = self.sequence();
            self.waiting.push_back(TakenFrame { sequence, first_sample_s, load: load() });
        }
        self.spoilt = false;
        self.next += 1;
    }

    /// After a pause of the whole process, continues with the frame that is due at `t_s`.
    pub fn skip_to(&mut self, t_s: f64) {
        let due = (t_s * self.rate_hz).floor();
        if due - self.next as f64 > CATCH_UP_MAX {
            self.dropped += due as u64 - self.next;
            self.next = due as u64;
            self.spoilt = true;
        }
    }

    /// Returns the frames taken since the last call.
    pub fn take(&mut self) -> VecDeque<TakenFrame> {
        std::mem::take(&mut self.waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spoilt_frame_leaves_a_gap_in_the_sequence() {
        let mut ledger = FrameLedger::new(30.0);
        let load = Arc::new(Load::default());
        for i in 0..4 {
            if i == 2 {
                ledger.spoil();
            }
            ledger.finish(|| Arc::clone(&load));
        }
        let sequence: Vec<u32> = ledger.take().iter().map(|f| f.sequence).collect();
        assert_eq!(sequence, [0, 1, 3]);
        assert_eq!(ledger.dropped(), 1);
        assert!((ledger.end_s() - 5.0 / 30.0).abs() < 1e-12);
    }
}
