//! What prevents a motion command from being sent: the latched emergency stop of the rig, and a
//! stop of the same axis that came later than the command.
//! PURE except for atomics. Uses: `LineError`. Never: ports, waits.
//!
//! A stop overtakes everything in the queue, so a motion that was queued before it would be sent
//! after it and start the axis again. A motion therefore carries a permit, taken when the command
//! was issued, and the owner of the wire checks it immediately before the bytes are sent.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::error::LineError;

/// Emergency stop of the rig, latched until a person clears it; released by default. All clones share it.
#[derive(Debug, Clone, Default)]
pub struct StopLatch(Arc<AtomicBool>);

impl StopLatch {
    /// Latches: no wire sends a motion command any more.
    pub fn latch(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Releases: motion is allowed again.
    pub fn clear(&self) {
        self.0.store(false, Ordering::SeqCst);
    }

    /// Whether the stop is latched, so that motion is refused.
    fn is_latched(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// The gate of one axis: it issues permits for motions, and a stop withdraws all earlier permits.
#[derive(Debug, Clone)]
pub struct MotionGate {
    latch: StopLatch,
    stops: Arc<AtomicU64>,
}

impl MotionGate {
    /// Creates a gate under the latch of the rig.
    pub fn new(latch: StopLatch) -> Self {
        Self { latch, stops: Arc::default() }
    }

    /// Issues a permit for one motion command, to be checked at each of its writes.
    ///
    /// # Errors
    /// `LineError::Latched` if the emergency stop is latched.
    pub fn permit(&self) -> Result<MotionPermit, LineError> {
        let seen = self.stops.load(Ordering::SeqCst);
        let permit = MotionPermit { gate: self.clone(), seen };
        permit.check()?;
        Ok(permit)
    }

    /// Withdraws every permit issued before: the axis was commanded to stop.
    pub fn void(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
    }
}

/// Permission to send the writes of one motion command.
#[derive(Debug, Clone)]
pub struct MotionPermit {
    gate: MotionGate,
    seen: u64,
}

impl MotionPermit {
    /// Checks that the motion may still be sent.
    ///
    /// # Errors
    /// `LineError::Latched` if the emergency stop is latched, `LineError::Withdrawn` after a stop
    /// of the axis.
    pub fn check(&self) -> Result<(), LineError> {
        if self.gate.latch.is_latched() {
            Err(LineError::Latched)
        } else if self.gate.stops.load(Ordering::SeqCst) != self.seen {
            Err(LineError::Withdrawn)
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_voids_what_was_permitted_before_it_and_nothing_after() {
        let gate = MotionGate::new(StopLatch::default());
        let before = gate.permit().unwrap();
        gate.void();
        assert_eq!(before.check(), Err(LineError::Withdrawn));
        assert_eq!(gate.permit().unwrap().check(), Ok(()));
    }

    #[test]
    fn a_latched_rig_refuses_every_axis_until_cleared() {
        let latch = StopLatch::default();
        let (x, y) = (MotionGate::new(latch.clone()), MotionGate::new(latch.clone()));
        let given = x.permit().unwrap();
        latch.latch();
        assert_eq!(given.check(), Err(LineError::Latched));
        assert_eq!(y.permit().unwrap_err(), LineError::Latched);
        latch.clear();
        assert!(y.permit().is_ok());
    }
}
