//! What keeps a motion command off the wire: the rig's latched emergency stop, and a stop of the
//! same axis that came later than the command.
//! PURE but for atomics. Uses: `LineError`. Never: ports, waits.
//!
//! A stop overtakes everything in the queue, so a move that was queued before it would be sent
//! after it and start the axis again. Therefore a motion carries a permit, taken when the command
//! was given, and the owner of the wire looks at it at the last instant before the bytes leave.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::LineError;

/// The rig's emergency stop, latched until a person clears it. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct StopLatch(Arc<AtomicBool>);

impl StopLatch {
    /// A latch that is open: motion is allowed.
    pub fn new() -> Self {
        Self::default()
    }

    /// From now on no wire carries a motion command.
    pub fn latch(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Allows motion again.
    pub fn clear(&self) {
        self.0.store(false, Ordering::SeqCst);
    }

    /// Whether motion is refused.
    pub fn is_latched(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// The gate of one axis: motions pass it, a stop voids all that passed before.
#[derive(Debug, Clone)]
pub struct MotionGate {
    latch: StopLatch,
    stops: Arc<AtomicU64>,
}

impl MotionGate {
    /// An open gate under the rig's latch.
    pub fn new(latch: StopLatch) -> Self {
        Self { latch, stops: Arc::default() }
    }

    /// A permit for one motion command, to be shown at every write of it.
    pub fn permit(&self) -> Result<MotionPermit, LineError> {
        let seen = self.stops.load(Ordering::SeqCst);
        let permit = MotionPermit { gate: self.clone(), seen };
        permit.check()?;
        Ok(permit)
    }

    /// Voids every permit given so far: the axis has been told to stop.
    pub fn void(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
    }
}

/// Leave to send the writes of one motion command.
#[derive(Debug, Clone)]
pub struct MotionPermit {
    gate: MotionGate,
    seen: u64,
}

impl MotionPermit {
    /// Whether the motion may still be sent.
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
        let gate = MotionGate::new(StopLatch::new());
        let before = gate.permit().unwrap();
        gate.void();
        assert_eq!(before.check(), Err(LineError::Withdrawn));
        assert_eq!(gate.permit().unwrap().check(), Ok(()));
    }

    #[test]
    fn a_latched_rig_refuses_every_axis_until_cleared() {
        let latch = StopLatch::new();
        let (x, y) = (MotionGate::new(latch.clone()), MotionGate::new(latch.clone()));
        let given = x.permit().unwrap();
        latch.latch();
        assert_eq!(given.check(), Err(LineError::Latched));
        assert_eq!(y.permit().unwrap_err(), LineError::Latched);
        latch.clear();
        assert!(y.permit().is_ok());
    }
}
