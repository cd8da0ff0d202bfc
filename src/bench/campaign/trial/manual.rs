//! One manual trial: wait until the signal settles, take the frames, commit.
//! Uses: `rig::traits`, `campaign::{trial::measure, diary}`. Never: motion; the stage is not
//! needed.
//!
//! Paper II-C: weights on the skin; the forces are nominal, not measured.

use std::sync::Arc;

use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::status::Phase;
use crate::campaign::trial::measure::{frame_flags, frame_quality, record};
use crate::clock::Clock;
use crate::ids::{RunUid, TrialKey};
use crate::record::{Flag, FrameQuality, PlacedContact, TrialRecord, TrialScalars};
use crate::rig::traits::{Frame, SkinReader};
use crate::schedule::experiment::Measure;
use crate::schedule::manual::PlannedPlacement;

/// Frames per window; the means of two successive windows are compared.
const WINDOW: usize = 10;
/// Largest change between windows that counts as noise, as a multiple of the noise of their means.
const NOISE_MULTIPLE: f64 = 1.5;

/// Contacts of a placement, as stored and shown.
pub fn contacts(placement: &PlannedPlacement) -> Vec<PlacedContact> {
    placement
        .contacts
        .iter()
        .map(|c| PlacedContact { x_mm: c.x_mm, y_mm: c.y_mm, force_n: c.force_n })
        .collect()
}

/// Confirmation by a person that the weights of a placement are placed.
#[derive(Debug)]
pub struct Confirmed<'a> {
    /// Run that asked for the placement.
    pub run: RunUid,
    /// Name of the person.
    pub who: String,
    /// How the placement is measured.
    pub measure: &'a Measure,
}

/// Measures a placement that a person has confirmed.
///
/// # Errors
/// Halts if frames do not arrive, on an e-stop or a request, or if the store fails.
pub async fn measure(
    skin: &Arc<dyn SkinReader>,
    clock: &Clock,
    control: &mut Control,
    confirmed: Confirmed<'_>,
    placement: &PlannedPlacement,
) -> Result<(), Halt> {
    let Confirmed { run, who, measure: plan_measure } = confirmed;
    let key = TrialKey { configuration: placement.index, depth_index: 0 };
    control.show_run(|run| run.trial = Some(key));
    control.phase(Phase::Settle);
    let started_at = clock.timestamp();
    let (settle_ms, at_rest) = settle(skin, clock, control, plan_measure).await?;
    control.phase(Phase::Measure);
    let before = skin.counters();
    let frames = skin.take(clock.now(), plan_measure.frames_per_trial as usize).await?;
    let after = skin.counters();
    let dropped = (after.missed - before.missed) + (after.garbled - before.garbled);
    let quality = FrameQuality {
        dropped_packets: Some(dropped as u32),
        ..frame_quality(frames.iter().map(AsRef::as_ref))
    };
    let mut flags = frame_flags(frames.iter().map(AsRef::as_ref), plan_measure);
    if !at_rest {
        flags.push(Flag::Unsettled);
    }
    let placed = contacts(placement);
    let trial = TrialRecord {
        key,
        attempt: 1,
        tips: placed.len() as u8,
        depth_mm: None,
        target: None,
        reached: None,
        arms: Vec::new(),
        placed,
        placed_by: Some(who),
        frames: frames.iter().map(|f| record(f)).collect(),
        quality,
        flags,
        settle_ms,
        scalars: TrialScalars::default(),
        started_at,
        measured_at: clock.timestamp(),
    };
    control.phase(Phase::Commit);
    let diary = control.diary.clone();
    control.at_rest(diary.trial(run, trial)).await?;
    control.show_run(|run| run.trials_stored += 1);
    Ok(())
}

/// Waits until two successive windows of frames differ by no more than their noise.
async fn settle(
    skin: &Arc<dyn SkinReader>,
    clock: &Clock,
    control: &mut Control,
    measure: &Measure,
) -> Result<(f64, bool), Halt> {
    let start_s = clock.process_s();
    let mut last: Option<Window> = None;
    loop {
        control.attend()?;
        let window = Window::of(&skin.take(clock.now(), WINDOW).await?);
        let settle_ms = (clock.process_s() - start_s) * 1e3;
        let at_rest = last.as_ref().is_some_and(|last| window.rests_after(last));
        if settle_ms >= measure.settle_ms && at_rest || settle_ms >= measure.settle_max_ms {
            return Ok((settle_ms, at_rest));
        }
        last = Some(window);
    }
}

/// Mean of the frames of a window, and noise of one frame, V.
struct Window {
    mean_v: Vec<f64>,
    noise_v: f64,
    frames: f64,
}

impl Window {
    fn of(frames: &[Arc<Frame>]) -> Self {
        let n = frames.len() as f64;
        let channels = frames.first().map_or(0, |f| f.counts.len());
        let (mut mean_v, mut square) = (vec![0.0; channels], 0.0);
        for f in frames {
            for (m, v) in mean_v.iter_mut().zip(f.voltages_v()) {
                *m += f64::from(v) / n;
            }
        }
        for f in frames {
            for (m, v) in mean_v.iter().zip(f.voltages_v()) {
                square += (f64::from(v) - m).powi(2);
            }
        }
        let noise_v = (square / ((n - 1.0).max(1.0) * channels.max(1) as f64)).sqrt();
        Self { mean_v, noise_v, frames: n }
    }

    fn rests_after(&self, last: &Self) -> bool {
        let square: f64 = self.mean_v.iter().zip(&last.mean_v).map(|(a, b)| (a - b).powi(2)).sum();
        let change_v = (square / self.mean_v.len().max(1) as f64).sqrt();
        let noise_v = self.noise_v.max(last.noise_v) * (2.0 / self.frames).sqrt();
        change_v <= NOISE_MULTIPLE * noise_v
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::Instant;

    fn frames(level: f64, drift: f64) -> Vec<Arc<Frame>> {
        (0..WINDOW)
            .map(|i| {
                let counts = (0..784)
                    .map(|c| {
                        let noise = f64::from((c * 31 + i as i32 * 17) % 7 - 3);
                        (level + drift * i as f64 + noise) as i16
                    })
                    .collect();
                Arc::new(Frame {
                    sequence: i as u32,
                    device_time_us: 0,
                    volts_per_count: 1e-3,
                    counts,
                    received: Instant::now(),
                })
            })
            .collect()
    }

    #[test]
    fn noise_alone_rests_and_a_creeping_signal_does_not() {
        let still = Window::of(&frames(100.0, 0.0));
        assert!(Window::of(&frames(100.0, 0.0)).rests_after(&still));
        assert!(!Window::of(&frames(104.0, 0.0)).rests_after(&still));
    }
}
