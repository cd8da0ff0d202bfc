//! Every sample of the load cells, published for their followers.
//! Uses: tokio's broadcast channel, `record`. Never: a wait for a follower; one that is too slow
//! misses samples.

use tokio::sync::broadcast;

use crate::record::ARMS;

/// Samples that a follower may be behind: a second of the fastest rig.
const SAMPLES_BEHIND: usize = 8192;

/// One sample of the load cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSample {
    /// Wall time of the reading, ms since 1970.
    pub at_ms: i64,
    /// Machine z read with it, mm; `None` if z was not read.
    pub z_mm: Option<f64>,
    /// Forces of arms 1 to 6 after subtraction of the tare, N; `None` for a disconnected cell.
    pub forces_n: [Option<f64>; ARMS],
}

/// Publishes samples. Clones share the followers.
#[derive(Debug, Clone)]
pub struct Samples(broadcast::Sender<ForceSample>);

impl Default for Samples {
    fn default() -> Self {
        Self(broadcast::Sender::new(SAMPLES_BEHIND))
    }
}

impl Samples {
    /// Publishes a sample without waiting for its followers.
    pub fn publish(&self, sample: ForceSample) {
        // Without followers there is nothing to do.
        let _ = self.0.send(sample);
    }

    /// Follows the samples from now on.
    pub fn follow(&self) -> broadcast::Receiver<ForceSample> {
        self.0.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_follower_misses_samples_and_delays_nobody() {
        let samples = Samples::default();
        let sample = |at_ms| ForceSample { at_ms, z_mm: None, forces_n: [None; ARMS] };
        samples.publish(sample(-1));
        let mut slow = samples.follow();
        let most = SAMPLES_BEHIND as i64 + 10;
        (0..most).for_each(|at_ms| samples.publish(sample(at_ms)));
        assert_eq!(slow.try_recv(), Err(broadcast::error::TryRecvError::Lagged(10)));
        assert_eq!(slow.try_recv().unwrap().at_ms, 10);
    }
}
