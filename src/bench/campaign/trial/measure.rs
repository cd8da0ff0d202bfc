//! Settling, frames and forces of one held load, with flags for possible faults.
//! Uses: `campaign::bench::stage`, `rig::traits`. Never: storage, the plan.

use std::sync::Arc;

use crate::campaign::bench::evidence::SkinWatch;
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::record::{ARMS, Flag, FrameQuality, FrameRecord, Pose};
use crate::rig::traits::{CellVolts, Frame};
use crate::schedule::experiment::Measure;

/// Result of the wait for the forces after a motion.
#[derive(Debug, Clone, Copy)]
pub struct Settled {
    /// Duration of the wait, process ms.
    pub settle_ms: f64,
    /// Whether the forces settled before the longest wait ended.
    pub at_rest: bool,
}

/// Waits at least `settle_ms` and until no force changes by more than `settle_n` between samples;
/// reads the cells at every poll. Meanwhile the axes are read once, which must be at `target`.
///
/// # Errors
/// Halts on a limit, an axis off its target, a fault or a request. Forces that do not settle are not an error.
pub async fn settle(
    stage: &mut Stage,
    control: &mut Control,
    measure: &Measure,
    target: &Pose,
) -> Result<Settled, Halt> {
    let start_s = stage.clock.process_s();
    let sample_s = (stage.config.cells.update_ms / 1e3).max(0.05);
    // The wait takes no longer unless this does, and no frame is taken of a load elsewhere.
    stage.require_reached(control, target).await?;
    let mut last = stage.read_cells(control).await?.volts;
    let mut last_s = stage.clock.process_s();
    let mut change_n = f64::INFINITY;
    loop {
        stage.poll_pause().await;
        control.attend()?;
        let volts = stage.read_cells(control).await?.volts;
        let now_s = stage.clock.process_s();
        if now_s - last_s >= sample_s {
            let scale = stage.config.cells.newtons_per_volt();
            change_n = (0..usize::from(stage.tips))
                .map(|i| ((volts[i] - last[i]) * scale).abs())
                .fold(0.0, f64::max);
            (last, last_s) = (volts, now_s);
        }
        let settle_ms = (now_s - start_s) * 1e3;
        let at_rest = change_n <= measure.settle_n;
        if settle_ms >= measure.settle_ms && at_rest || settle_ms >= measure.settle_max_ms {
            return Ok(Settled { settle_ms, at_rest });
        }
    }
}

/// Frames of a held load, with the cells read before and after them.
#[derive(Debug, Clone)]
pub struct Taken {
    /// Frames in the order of the stream, each with its voltages, V.
    pub frames: Vec<FrameRecord>,
    /// Mean output of the cells around the frames, V.
    pub volts: [f64; ARMS],
    /// Quality counts of the frames.
    pub quality: FrameQuality,
    /// Possible faults of the frames.
    pub flags: Vec<Flag>,
}

/// Takes the frames of a load that is held from now on, and meanwhile reads the cells. When this
/// returns, every attached cell has returned more than one value since the hold began: each of them
/// still measures.
///
/// # Errors
/// Halts on a limit, a fault, a request, missing frames or a frame of another size.
pub async fn take(
    stage: &mut Stage,
    control: &mut Control,
    measure: &Measure,
) -> Result<Taken, Halt> {
    let count = measure.frames_per_trial as usize;
    let skin = stage.bench.skin.clone();
    let counters_before = skin.counters();
    let before = stage.read_cells(control).await?;
    let frames = skin.take(stage.clock.now(), count);
    let frames = stage.watch_while(control, frames).await?;
    let frames = frames.map_err(|e| stage.no_frames(e))?;
    let after = proven(stage, control).await?;
    let volts = std::array::from_fn(|i| (before.volts[i] + after.volts[i]) / 2.0);
    let expected = usize::from(stage.config.ert.electrodes()).pow(2);
    if let Some(wrong) = frames.iter().find(|f| f.counts.len() != expected) {
        let found = wrong.counts.len();
        return Err(Halt::Failed(format!("a frame of {found} values, {expected} expected")));
    }
    let mut flags = frame_flags(&frames, measure);
    let counters = skin.counters();
    let missed = counters.missed - counters_before.missed;
    let garbled = counters.garbled - counters_before.garbled;
    let quality = FrameQuality {
        dropped_packets: Some((missed + garbled) as u32),
        stuck_channels: frames.first().map(|frame| stage.stuck.push(&frame.counts)),
        ..frame_quality(&frames)
    };
    let consecutive = frames.windows(2).all(|p| p[1].sequence == p[0].sequence.wrapping_add(1));
    if !consecutive && missed > 0 {
        flags.push(Flag::DroppedFrames);
    }
    let forces = stage.forces_n(&volts);
    let attached = &forces[..usize::from(stage.tips)];
    let silent = |watch: &SkinWatch| frames.iter().all(|f| watch.is_silent(f, attached));
    if stage.skin.as_ref().is_some_and(silent) {
        flags.push(Flag::SilentSkin);
    }
    let frames = frames.iter().map(|f| record(f)).collect();
    Ok(Taken { frames, volts, quality, flags })
}

/// Reads the cells until each attached cell has returned a new value recently, so that the last
/// value of a hanging module is not stored. A cell that does not change trips within
/// `cells.repeats_max` updates.
async fn proven(stage: &mut Stage, control: &mut Control) -> Result<CellVolts, Halt> {
    /// Updates without a change that are compatible with noise.
    const LATELY: u32 = 3;
    loop {
        let reading = stage.read_cells(control).await?;
        let limit = stage.config.cells.repeats_max();
        let lately = |i| limit == 0 || reading.repeats[i] <= LATELY.max(limit / 2);
        if (0..usize::from(stage.tips)).all(lately) {
            return Ok(reading);
        }
        control.attend()?;
        stage.poll_pause().await;
    }
}

/// Flags that follow from frames alone.
pub fn frame_flags(frames: &[Arc<Frame>], measure: &Measure) -> Vec<Flag> {
    let mut flags = Vec::new();
    if frames.iter().any(|f| f.saturated_channels() > 0) {
        flags.push(Flag::SaturatedChannels);
    }
    if frames.iter().any(|f| f.largest_injection_sum_v() > measure.injection_sum_v) {
        flags.push(Flag::InjectionSum);
    }
    flags
}

/// Quality counts that follow from frames alone.
pub fn frame_quality(frames: &[Arc<Frame>]) -> FrameQuality {
    let saturated = frames.iter().map(|f| f.saturated_channels()).max().unwrap_or(0);
    FrameQuality {
        saturated_channels: Some(saturated as u32),
        // A frame that lacks a channel is never accepted.
        missing_channels: Some(0),
        injection_sum_v: frames.iter().map(|f| f.largest_injection_sum_v()).reduce(f64::max),
        ..FrameQuality::default()
    }
}

/// Frame in the form in which it is stored.
pub fn record(frame: &Frame) -> FrameRecord {
    FrameRecord {
        sequence: frame.sequence,
        device_time_us: frame.device_time_us,
        volts_per_count: frame.volts_per_count,
        counts: frame.counts.clone(),
    }
}
