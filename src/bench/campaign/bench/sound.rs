//! Whether the readings of a drive permit to rely on it: no alarm, its zero is known, its motor is on.
//! Uses: `campaign::{bench::interlock, bench::stopping, run::halt}`, `rig::traits`, `clock`. Never: positions.

use tokio::time::Instant;

use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stopping::POLL_S;
use crate::campaign::run::halt::Halt;
use crate::clock::Clock;
use crate::rig::error::RigError;
use crate::rig::traits::{Axis, AxisStatus};

/// Longest time for which a drive may not be ready, process s: a moment at the start of a motion, and after its end.
const READY_WITHIN_S: f64 = 0.2;
/// Longest time for which an axis that homes may be neither ready nor in motion, process s: longer than the pauses between
/// the phases of a homing.
pub(super) const HOMING_READY_WITHIN_S: f64 = 3.0;
/// The same for z in an attempt to raise it, process s. The three attempts wait 9 s for a drive that switches its motor on
/// again; after them a person must come.
pub(super) const RAISE_READY_WITHIN_S: f64 = 3.0;

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

/// Readings of an axis that moves or homes, one after the other: whether it has lost its zero, and whether its motor is off.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SoundWatch {
    /// Whether the last reading showed no zero.
    has_no_zero: bool,
    /// Arrival of the first of the last readings that showed the motor off.
    off_since: Option<Instant>,
}

impl SoundWatch {
    /// Takes the next reading.
    ///
    /// # Errors
    /// A trip if two readings in succession show no zero, since a flipped bit does not recur, or if the motor is off for
    /// longer than the moment that a motion begins or ends with.
    pub(super) fn take(
        &mut self,
        clock: &Clock,
        axis: &dyn Axis,
        status: &AxisStatus,
    ) -> Result<(), Halt> {
        if std::mem::replace(&mut self.has_no_zero, !status.homed) {
            require_zero(axis, status)?;
        }
        self.take_ready(clock, axis, status, READY_WITHIN_S)
    }

    /// Takes the next reading of an axis that homes, or of z while it is raised: its zero is not checked, and in motion it
    /// need not be ready.
    ///
    /// # Errors
    /// A trip if it is neither ready nor in motion for longer than `within_s`, process s.
    pub(super) fn take_ready_or_moving(
        &mut self,
        clock: &Clock,
        axis: &dyn Axis,
        status: &AxisStatus,
        within_s: f64,
    ) -> Result<(), Halt> {
        let status = AxisStatus { ready: status.ready || status.moving, ..*status };
        self.take_ready(clock, axis, &status, within_s)
    }

    fn take_ready(
        &mut self,
        clock: &Clock,
        axis: &dyn Axis,
        status: &AxisStatus,
        within_s: f64,
    ) -> Result<(), Halt> {
        if status.ready {
            self.off_since = None;
            return Ok(());
        }
        let since = *self.off_since.get_or_insert(status.at);
        if status.at.saturating_duration_since(since) <= clock.wall(within_s) {
            return Ok(());
        }
        require_on(axis, status)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::campaign::bench::stand_in::StandIns;

    #[test]
    fn one_reading_without_a_zero_and_a_motor_that_is_off_for_a_moment_end_no_motion() {
        let (axes, clock) = (StandIns::default(), Clock::new(1.0));
        let sound = axes.x.present();
        let after = |ms: u64, status: AxisStatus| AxisStatus {
            at: sound.at + Duration::from_millis(ms),
            ..status
        };
        let (unhomed, off) =
            (AxisStatus { homed: false, ..sound }, AxisStatus { ready: false, ..sound });
        let kind = |readings: &[AxisStatus]| {
            let mut watch = SoundWatch::default();
            let mut taken = readings.iter().map(|now| watch.take(&clock, &*axes.x, now));
            taken.find_map(Result::err).and_then(|halt| halt.as_trip().map(|trip| trip.kind))
        };
        assert_eq!(kind(&[unhomed, sound, unhomed, sound]), None);
        assert_eq!(kind(&[sound, unhomed, unhomed]), Some(TripKind::Position));
        assert_eq!(
            kind(&[after(0, off), after(200, off), after(201, sound), after(402, off)]),
            None
        );
        assert_eq!(
            kind(&[after(0, off), after(100, off), after(201, off)]),
            Some(TripKind::Device)
        );
    }

    #[test]
    fn a_pause_between_the_phases_of_a_homing_is_no_motor_that_is_off() {
        let (axes, clock) = (StandIns::default(), Clock::new(1.0));
        let pauses = AxisStatus { homed: false, ready: false, ..axes.x.present() };
        let moves = AxisStatus { moving: true, ..pauses };
        let kind = |readings: &[(u64, AxisStatus)]| {
            let mut watch = SoundWatch::default();
            let mut taken = readings.iter().map(|(ms, now)| {
                let now = AxisStatus { at: pauses.at + Duration::from_millis(*ms), ..*now };
                watch.take_ready_or_moving(&clock, &*axes.x, &now, HOMING_READY_WITHIN_S)
            });
            taken.find_map(Result::err).and_then(|halt| halt.as_trip().map(|trip| trip.kind))
        };
        assert_eq!(kind(&[(0, pauses), (3000, pauses), (3001, moves), (5000, pauses)]), None);
        assert_eq!(kind(&[(0, pauses), (3000, pauses), (3001, pauses)]), Some(TripKind::Device));
    }
}
