//! One manual trial: wait until the signal settles, take the frames, commit.
//! Uses: `rig::traits`, `campaign::{trial::measure, diary}`. Never: motion; the stage is not
//! needed.
//!
//! Paper II-C: weights on the skin; the forces are nominal, not measured.

use std::sync::Arc;

use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::shown::placement::Confirmation;
use crate::campaign::shown::status::Phase;
use crate::campaign::trial::measure::{frame_flags, frame_quality, record};
use crate::campaign::trial::rest::{WINDOW, Window, changes_within};
use crate::clock::Clock;
use crate::ids::{RunUid, TrialKey};
use crate::record::{Flag, FrameQuality, PlacedContact, TrialRecord, TrialScalars};
use crate::rig::traits::SkinReader;
use crate::schedule::experiment::Measure;
use crate::schedule::manual::PlannedPlacement;

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
    /// Who has placed the weights, and the verdict.
    pub confirmation: Confirmation,
    /// How the placement is measured.
    pub measure: &'a Measure,
    /// Number of the attempt, from 1.
    pub attempt: u32,
}

/// Measures a placement that a person has confirmed.
///
/// # Errors
/// Halts if frames do not arrive, on an e-stop or a request, or if the store fails. Fails the attempt if the stream is
/// opened again meanwhile, or its device restarts.
pub async fn measure(
    skin: &Arc<dyn SkinReader>,
    clock: &Clock,
    control: &mut Control,
    confirmed: Confirmed<'_>,
    placement: &PlannedPlacement,
) -> Result<(), Halt> {
    let Confirmed { run, confirmation, measure: plan_measure, attempt } = confirmed;
    let key = TrialKey { configuration: placement.index, depth_index: 0 };
    control.show_run(|run| run.trial = Some(key));
    control.phase(Phase::Settle);
    let started_at = clock.timestamp();
    let stream_since = skin.counters().since;
    let (settle_ms, at_rest) = settle(skin, clock, control, plan_measure).await?;
    control.phase(Phase::Measure);
    let before = skin.counters();
    let frames = skin.take(clock.now(), plan_measure.frames_per_trial as usize);
    let frames = control.attending(frames).await??;
    let after = skin.counters();
    // Nothing is stored of weights that lay while the computer was suspended.
    control.attend()?;
    if after.since != stream_since {
        // Offsets may differ from those of the untouched frame.
        let words = "the voltage stream was opened again, or its device restarted, meanwhile";
        return Err(Halt::Failed(words.into()));
    }
    let dropped = (after.missed - before.missed) + (after.garbled - before.garbled);
    let quality = FrameQuality { dropped_packets: Some(dropped as u32), ..frame_quality(&frames) };
    let mut flags = frame_flags(&frames, plan_measure);
    // A hand may come back to the weights while they are measured.
    if !at_rest || changes_within(&frames) {
        flags.push(Flag::Unsettled);
    }
    if confirmation.is_doubted() {
        flags.push(Flag::Doubted);
    }
    let placed = contacts(placement);
    let trial = TrialRecord {
        key,
        attempt,
        tips: placed.len() as u8,
        depth_mm: None,
        target: None,
        reached: None,
        arms: Vec::new(),
        placed,
        placed_by: Some(confirmation.who),
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
        let frames = control.attending(skin.take(clock.now(), WINDOW)).await??;
        let window = Window::of(&frames);
        let settle_ms = (clock.process_s() - start_s) * 1e3;
        let at_rest = last.as_ref().is_some_and(|last| window.rests_after(last));
        if settle_ms >= measure.settle_ms && at_rest || settle_ms >= measure.settle_max_ms {
            return Ok((settle_ms, at_rest));
        }
        last = Some(window);
    }
}
