//! Pauses that double with each failure: of a request, and of the orders that this machine cannot make.
//! Uses: the clock that is passed in. Never: the queue.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::WorkerError;

/// First and longest pause after a failure.
const PAUSE: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(60));

/// A pause that doubles with each failure.
#[derive(Debug, Default)]
pub struct Pause {
    failures: u32,
}

impl Pause {
    /// The pause after one more failure.
    pub fn next_pause(&mut self) -> Duration {
        let (first, longest) = PAUSE;
        let pause = first.saturating_mul(1 << self.failures.min(10)).min(longest);
        self.failures += 1;
        pause
    }

    /// Ends the failures, and returns whether there were some.
    pub fn ends(&mut self) -> bool {
        std::mem::take(&mut self.failures) > 0
    }

    /// Logs the first failure, and then each tenth.
    pub fn warn(&self, error: &WorkerError, what: &str) {
        if self.failures.is_multiple_of(10) {
            tracing::warn!(%error, failures = self.failures, "{what}");
        }
    }
}

/// Orders of which this machine could not make a chunk, each left for a pause. The chunks of others are taken
/// meanwhile.
#[derive(Debug, Default)]
pub struct LeftOrders(BTreeMap<String, (Pause, Instant)>);

impl LeftOrders {
    /// Leaves an order for its next pause.
    pub fn leave(&mut self, order: &str, now: Instant) {
        let (pause, until) =
            self.0.entry(order.to_owned()).or_insert_with(|| (Pause::default(), now));
        *until = now + pause.next_pause();
    }

    /// Ends the pauses of an order: this machine has made one of its chunks.
    pub fn returns(&mut self, order: &str) {
        self.0.remove(order);
    }

    /// The orders that are left now.
    pub fn now(&self, now: Instant) -> Vec<String> {
        let left = self.0.iter().filter(|(_, (_, until))| *until > now);
        left.map(|(order, _)| order.clone()).collect()
    }

    /// Time to the end of the first pause; `None` if no order is left.
    pub fn first_end(&self, now: Instant) -> Option<Duration> {
        self.0
            .values()
            .filter_map(|(_, until)| until.checked_duration_since(now))
            .filter(|time| !time.is_zero())
            .min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_grows_to_its_longest_and_begins_again() {
        let mut pause = Pause::default();
        let pauses: Vec<u128> = (0..11).map(|_| pause.next_pause().as_millis()).collect();
        assert_eq!(pauses[..4], [200, 400, 800, 1600]);
        assert_eq!(pauses[10], 60_000);
        assert!(pause.ends() && !pause.ends());
        assert_eq!(pause.next_pause().as_millis(), 200);
    }

    #[test]
    fn an_order_is_left_for_its_own_pause_until_one_of_its_chunks_is_made() {
        let mut orders = LeftOrders::default();
        let now = Instant::now();
        let after = |ms: u64| now + Duration::from_millis(ms);
        assert_eq!(orders.first_end(now), None);
        orders.leave("a", now);
        orders.leave("a", after(200));
        orders.leave("b", after(300));
        assert_eq!(orders.now(after(400)), ["a", "b"]);
        assert_eq!(orders.first_end(after(400)), Some(Duration::from_millis(100)));
        // 200 ms + 400 ms, and 300 ms + 200 ms.
        assert_eq!(orders.now(after(550)), ["a"]);
        assert!(orders.now(after(600)).is_empty());
        assert_eq!(orders.first_end(after(600)), None);
        orders.returns("a");
        orders.leave("a", after(1000));
        assert!(orders.now(after(1200)).is_empty());
    }
}
