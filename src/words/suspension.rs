//! Notices that the computer was suspended: the clock of all deadlines and ages is stopped meanwhile, so that a
//! sample from before looks fresh.
//! Uses: the clocks of the system. Never: a wait.

use std::time::Duration;

/// Shortest suspension that is noticed. Two readings of clocks are never as far apart.
const NOTICED: Duration = Duration::from_secs(1);
/// Readings from which the time before the watch began is known.
const READINGS: usize = 3;

/// Watches how long the computer has been suspended since it was started.
pub struct Suspensions {
    suspended: Box<dyn Fn() -> Duration + Send + Sync>,
    known: Duration,
}

impl Suspensions {
    /// Watches the computer from now on.
    pub fn watch() -> Self {
        Self::of(suspended)
    }

    /// Watches a time that has been spent suspended, as this function states it.
    pub fn of(suspended: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        let known = (0..READINGS).map(|_| suspended()).max().unwrap_or_default();
        Self { suspended: Box::new(suspended), known }
    }

    /// For how long the computer was suspended since the last call; none if it was not.
    pub fn newest(&mut self) -> Option<Duration> {
        let total = (self.suspended)();
        let new = total.saturating_sub(self.known);
        if new < NOTICED {
            return None;
        }
        self.known = total;
        Some(new)
    }
}

/// Time that the computer has been suspended since it was started: the clock that runs meanwhile, less the one that
/// does not. It is read in this order, so that a thread that is held up between the two readings finds too little,
/// never too much.
#[cfg(target_os = "linux")]
fn suspended() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    let read = |clock| Duration::try_from(clock_gettime(clock)).unwrap_or_default();
    let since_start = read(ClockId::Boottime);
    since_start.saturating_sub(read(ClockId::Monotonic))
}

/// Other systems are not asked.
#[cfg(not(target_os = "linux"))]
fn suspended() -> Duration {
    Duration::ZERO
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    #[test]
    fn each_suspension_is_noticed_once_and_the_lateness_of_a_thread_is_none() {
        let slept_ms = Arc::new(AtomicU64::new(7_200_000));
        let source = slept_ms.clone();
        let mut watch =
            Suspensions::of(move || Duration::from_millis(source.load(Ordering::Relaxed)));
        let mut now = |ms: u64| {
            slept_ms.store(ms, Ordering::Relaxed);
            watch.newest()
        };
        assert_eq!(now(7_200_000), None, "before the watch");
        assert_eq!(now(7_197_000), None, "a late reading");
        assert_eq!(now(7_200_900), None);
        assert_eq!(now(7_260_000), Some(Duration::from_secs(60)));
        assert_eq!(now(7_260_000), None);
    }

    #[test]
    fn a_computer_that_is_not_suspended_is_not_said_to_be() {
        let mut watch = Suspensions::watch();
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(watch.newest(), None);
    }
}
