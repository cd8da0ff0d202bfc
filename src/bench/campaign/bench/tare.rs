//! Zeros of the cells and of the skin, measured in the air before each configuration, with limits.
//! Uses: `campaign::bench::stage`. Never: storage.

use crate::campaign::bench::evidence::SkinWatch;
use crate::campaign::bench::interlock::{FOREIGN_N, TripKind};
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::rig::config::ARMS;

/// Limit of the spread of a cell's readings in the air, as a multiple of its noise.
const NOISE_MULTIPLE: f64 = 10.0;
/// Frames of the untouched skin: at 30 frames per second they arrive while the cells are read.
const UNTOUCHED_FRAMES: usize = 4;

/// Tares the cells and meanwhile takes frames of the untouched skin, so that each can then
/// cross-check the other. Returns arms and their zeros, V.
///
/// # Errors
/// As [`tare`]; also if the frames of the skin do not arrive.
pub async fn tare_untouched(
    stage: &mut Stage,
    control: &mut Control,
    samples: u32,
    first: bool,
) -> Result<Vec<(u8, f64)>, Halt> {
    let skin = stage.bench.skin.clone();
    let untouched = skin.take(stage.clock.now(), UNTOUCHED_FRAMES);
    let (zeros, frames) = futures::join!(tare(stage, control, samples, first), untouched);
    let zeros = zeros?;
    let frames = frames.map_err(|e| stage.no_frames(e))?;
    stage.skin = SkinWatch::untouched(&frames);
    stage.begin_watch();
    Ok(zeros)
}

/// Averages `samples` fresh readings of the cells and makes them the zeros. With `first`, any zero
/// is accepted; otherwise it may not have drifted by more than the limit since the last tare.
/// Connected cells on arms without a tip get zeros too, so that a load on them is detected.
///
/// # Errors
/// Trips on a disconnected cell, a drifted zero, or a load on an arm without a tip; fails the
/// attempt if a cell is not quiet. A fault of the wire or a request halts as well.
pub async fn tare(
    stage: &mut Stage,
    control: &mut Control,
    samples: u32,
    first: bool,
) -> Result<Vec<(u8, f64)>, Halt> {
    let tips = usize::from(stage.tips);
    let mut readings: Vec<[f64; ARMS]> = Vec::with_capacity(samples as usize);
    for _ in 0..samples {
        // A module returns the same sample twice if it is read faster than it converts.
        stage.clock.sleep(stage.config.cells.update_ms / 1e3).await;
        control.attend()?;
        readings.push(stage.bench.cells.read().await?.volts);
    }
    let cells = &stage.config.cells;
    let n = readings.len() as f64;
    let mut zeros = stage.tare_v;
    for i in 0..ARMS {
        let arm = i + 1;
        let mean = readings.iter().map(|r| r[i]).sum::<f64>() / n;
        let spread = readings.iter().map(|r| (r[i] - mean).abs()).fold(0.0, f64::max);
        let spread_n = spread * cells.newtons_per_volt();
        let live = cells.is_live(mean);
        if i >= tips {
            let load_n = (mean - cells.zero_v()) * cells.newtons_per_volt();
            if live && load_n.abs() > FOREIGN_N {
                let detail = format!(
                    "cell {arm} reads {load_n:.1} N in the air and no tip is entered for arm \
                     {arm} (limit {FOREIGN_N} N): check which tips are mounted"
                );
                return Err(Halt::trip(TripKind::Cell, detail));
            }
            if live {
                zeros[i] = mean;
            }
            continue;
        }
        if !live {
            let detail = format!("cell {arm} reads {mean:.3} V in the air: disconnected");
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        if spread_n > NOISE_MULTIPLE * cells.force_noise_n {
            let limit = NOISE_MULTIPLE * cells.force_noise_n;
            return Err(Halt::Failed(format!(
                "cell {arm} varies by {spread_n:.2} N in the air, limit {limit:.2} N"
            )));
        }
        let moved_n = ((mean - stage.tare_v[i]) * cells.newtons_per_volt()).abs();
        let limit = stage.config.limits.tare_drift_n;
        if !first && moved_n > limit {
            let detail = format!(
                "zero of cell {arm} moved by {moved_n:.2} N since the last tare, limit {limit} N"
            );
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        zeros[i] = mean;
    }
    stage.tare_v = zeros;
    Ok((0..tips).map(|i| (i as u8 + 1, zeros[i])).collect())
}
