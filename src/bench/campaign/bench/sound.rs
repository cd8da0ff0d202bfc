//! Whether one reading of a drive permits to rely on it: no alarm, its zero is known, its motor is on.
//! Uses: `campaign::{bench::interlock, bench::stopping, run::halt}`, `rig::traits`, `clock`. Never: positions.

use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stopping::POLL_S;
use crate::campaign::run::halt::Halt;
use crate::clock::Clock;
use crate::rig::error::RigError;
use crate::rig::traits::{Axis, AxisStatus};

/// Longest time until a drive at rest reports that it is ready, process s: it may do so a moment after its motion ends.
const READY_WITHIN_S: f64 = 0.2;

pub(super) fn require_no_alarm(axis: &dyn Axis, status: &AxisStatus) -> Result<(), Halt> {
    let Some(alarm) = status.alarm else { return Ok(()) };
    Err(Halt::trip(TripKind::Device, format!("{} reports alarm {alarm:#x}", axis.name())))
}

/// A drive that restarted may have lost its zero: its positions, and the targets of its motions, would be wrong.
pub(super) fn require_zero(axis: &dyn Axis, status: &AxisStatus) -> Result<(), Halt> {
    if status.homed {
        return Ok(());
    }
    let detail =
        format!("{} is not homed any more: it has restarted, or lost its zero", axis.name());
    Err(Halt::trip(TripKind::Position, detail))
}

/// A drive whose motor is off holds no load and carries out no motion, and need not report an alarm. Only at rest: while
/// it homes, a drive may be neither ready nor in motion for a moment.
pub(super) fn require_on(axis: &dyn Axis, status: &AxisStatus) -> Result<(), Halt> {
    if status.ready {
        return Ok(());
    }
    let detail = format!(
        "{} is not ready, without an alarm: its motor is off, or an input stops it; check its power and its inputs",
        axis.name()
    );
    Err(Halt::trip(TripKind::Device, detail))
}

/// Reads axes that are at rest; again for a moment, as long as none has an alarm and one is not ready: it may have
/// arrived just now.
pub(super) async fn read_ready<A: AsRef<[AxisStatus]>, F: Future<Output = Result<A, RigError>>>(
    clock: &Clock,
    read: impl Fn() -> F,
) -> Result<A, RigError> {
    let deadline = clock.now() + clock.wall(READY_WITHIN_S);
    loop {
        let statuses = read().await?;
        let axes = statuses.as_ref();
        let awaits_ready =
            axes.iter().all(|axis| axis.alarm.is_none()) && axes.iter().any(|axis| !axis.ready);
        if !awaits_ready || clock.now() >= deadline {
            return Ok(statuses);
        }
        clock.sleep(POLL_S).await;
    }
}
