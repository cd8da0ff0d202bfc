//! Zeros of the cells and of the skin, measured in the air before each configuration, with limits; also on request of a
//! person.
//! Uses: `campaign::bench::stage`. Never: storage, a motion.

use futures::future::{Either, select};

use crate::campaign::bench::evidence::SkinWatch;
use crate::campaign::bench::interlock::{self, FOREIGN_N, TripKind};
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::record::{ARMS, Untouched};
use crate::rig::config::RigConfig;
use crate::rig::traits::CellVolts;

/// Limit of the spread of a cell's readings in the air, as a multiple of its noise.
const TARE_NOISE_MULTIPLE: f64 = 10.0;
/// Frames of the untouched skin: at 30 frames per second they arrive while the cells are read.
const UNTOUCHED_FRAMES: usize = 4;

/// Zeros that a tare accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Accept {
    /// Any zero: no earlier tare is a limit.
    AnyZero,
    /// A zero that has drifted by no more than the limit since the last tare.
    NearLast,
}

/// Tares the cells and meanwhile takes frames of the untouched skin, so that each can then
/// cross-check the other. Returns arms and their zeros, V.
///
/// # Errors
/// As [`tare`]; also if the frames of the skin do not arrive, or on a request meanwhile.
pub async fn tare_untouched(
    stage: &mut Stage,
    control: &mut Control,
    samples: u32,
    accept: Accept,
) -> Result<Vec<(u8, f64)>, Halt> {
    let skin = stage.bench.skin.clone();
    let stream_since = skin.counters().since;
    let mut untouched = skin.take(stage.clock.now(), UNTOUCHED_FRAMES);
    // A tare that ends early, and a request after it, wait for no frame.
    let (zeros, early) = {
        let tared = std::pin::pin!(tare(stage, control, samples, accept));
        let first = select(tared, &mut untouched).await;
        match first {
            Either::Left((zeros, _)) => (zeros?, None),
            Either::Right((frames, tared)) => (tared.await?, Some(frames)),
        }
    };
    let frames = match early {
        Some(frames) => frames,
        None => control.attending(untouched).await?,
    };
    let frames = frames.map_err(|e| stage.no_frames(e))?;
    stage.skin = SkinWatch::untouched(&frames);
    if let Some(watch) = &stage.skin {
        let at = stage.clock.timestamp();
        control.untouched(Untouched {
            voltages_v: watch.untouched_v(),
            at,
            frames: frames.len(),
            run: control.run_uid(),
            stream_since: skin.counters().since_of_frames(stream_since, at),
        });
    }
    stage.begin_watch();
    Ok(zeros)
}

/// Tares on request of a person, with any zero, if z is measured clear of the skin before and after it. `entered`: number
/// of tips, as for `assume_tips`.
///
/// # Errors
/// As [`tare`]; fails as well if z is not clear, not at rest or not homed. The zeros then do not change.
pub async fn tare_on_request(
    stage: &mut Stage,
    control: &mut Control,
    entered: Option<u8>,
    samples: u32,
) -> Result<(), Halt> {
    stage.require_clear_to_tare(control).await?;
    control.attending(stage.assume_tips(entered)).await??;
    let last_v = stage.tare_v;
    tare(stage, control, samples, Accept::AnyZero).await?;
    let checked = stage.require_clear_to_tare(control).await;
    if checked.is_err() {
        stage.tare_v = last_v;
    }
    checked
}

/// Averages `samples` fresh readings of the cells and makes them the zeros, if they are accepted.
/// Connected cells on arms without a tip get zeros too, so that a load on them is detected.
///
/// # Errors
/// Trips on a disconnected cell, a drifted zero, or a load in the air; fails the attempt if a cell is not
/// quiet. A fault of the wire or a request halts as well.
pub async fn tare(
    stage: &mut Stage,
    control: &mut Control,
    samples: u32,
    accept: Accept,
) -> Result<Vec<(u8, f64)>, Halt> {
    let mut readings: Vec<[f64; ARMS]> = Vec::with_capacity(samples as usize);
    let mut newest = None;
    for _ in 0..samples {
        // A module returns the same sample twice if it is read faster than it converts.
        stage.clock.sleep(stage.config.cells.update_ms / 1e3).await;
        control.attend()?;
        let reading = control.attending(stage.bench.cells.read()).await??;
        stage.publish(&reading, None);
        readings.push(reading.volts);
        newest = Some(reading);
    }
    let zeros = zeros(&stage.config, stage.tips, accept, &stage.tare_v, &readings);
    stage.tare_v = zeros.map_err(|halt| unless_hung(halt, stage, newest.as_ref()))?;
    Ok((1..=stage.tips).map(|arm| (arm, stage.tare_v[usize::from(arm) - 1])).collect())
}

/// Why a tare is refused: a module that hangs returns an earlier load, which is none. A disconnected cell repeats its
/// value, too: it stays the reason.
fn unless_hung(halt: Halt, stage: &Stage, newest: Option<&CellVolts>) -> Halt {
    let (cells, tips) = (&stage.config.cells, usize::from(stage.tips));
    let newest = newest.filter(|reading| reading.volts[..tips].iter().all(|&v| cells.is_live(v)));
    match newest.map(|reading| interlock::check_alive(cells, reading, tips)) {
        Some(Err(hung)) => hung.into(),
        Some(Ok(())) | None => halt,
    }
}

/// Zeros of arms 1 to 6, V, from readings in the air. `last_v`: those before.
fn zeros(
    config: &RigConfig,
    tips: u8,
    accept: Accept,
    last_v: &[f64; ARMS],
    readings: &[[f64; ARMS]],
) -> Result<[f64; ARMS], Halt> {
    let cells = &config.cells;
    let n = readings.len() as f64;
    let mut zeros = *last_v;
    for i in 0..ARMS {
        let arm = i + 1;
        let mean = readings.iter().map(|r| r[i]).sum::<f64>() / n;
        let live = cells.is_live(mean);
        let load_n = (mean - cells.zero_v()) * cells.newtons_per_volt();
        if arm > usize::from(tips) {
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
        let spread = readings.iter().map(|r| (r[i] - mean).abs()).fold(0.0, f64::max);
        let spread_n = spread * cells.newtons_per_volt();
        if spread_n > TARE_NOISE_MULTIPLE * cells.force_noise_n {
            let limit = TARE_NOISE_MULTIPLE * cells.force_noise_n;
            return Err(Halt::Failed(format!(
                "cell {arm} varies by {spread_n:.2} N in the air, limit {limit:.2} N"
            )));
        }
        let moved_n = ((mean - last_v[i]) * cells.newtons_per_volt()).abs();
        let limit = config.limits.tare_drift_n;
        if accept == Accept::NearLast && moved_n > limit {
            let detail = format!(
                "zero of cell {arm} moved by {moved_n:.2} N since the last tare, limit {limit} N"
            );
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        let limit = cells.in_air_n();
        if load_n.abs() > limit {
            let detail = format!(
                "cell {arm} reads {load_n:.1} N in the air, from the nominal zero \
                 (limit {limit} N, cells.in_air_n): check what touches its tip"
            );
            return Err(Halt::trip(TripKind::Cell, detail));
        }
        zeros[i] = mean;
    }
    Ok(zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in::{StandIns, config as rig};

    const LAST: [f64; ARMS] = [0.5; ARMS];

    /// Zeros of two tips, from readings of `forces_n` relative to the last zeros, arms 1 to 6.
    fn tared(accept: Accept, forces_n: &[[f64; ARMS]]) -> Result<[f64; ARMS], Halt> {
        let config = rig();
        let volts = |f: &[f64; ARMS]| f.map(|n| 0.5 + n / config.cells.newtons_per_volt());
        let readings: Vec<_> = forces_n.iter().map(volts).collect();
        zeros(&config, 2, accept, &LAST, &readings)
    }

    fn words(refused: Result<[f64; ARMS], Halt>) -> String {
        match refused.unwrap_err() {
            Halt::Trip(trip) if trip.kind == TripKind::Cell => trip.detail,
            Halt::Failed(words) => format!("failed: {words}"),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_zero_that_moved_too_far_since_the_last_tare_trips() {
        let limit_n = rig().limits.tare_drift_n;
        let below = [0.0, 0.9 * limit_n, 0.0, 0.0, 0.0, 0.0];
        let zeros = tared(Accept::NearLast, &[below]).unwrap();
        assert!(zeros[0] == LAST[0] && zeros[1] > LAST[1]);
        let beyond = [0.0, -1.1 * limit_n, 0.0, 0.0, 0.0, 0.0];
        let detail = words(tared(Accept::NearLast, &[beyond]));
        assert!(detail.starts_with("zero of cell 2 moved by"), "{detail}");
        assert!(tared(Accept::AnyZero, &[beyond]).is_ok(), "the first tare has no predecessor");
    }

    #[test]
    fn a_load_is_no_zero_although_no_tare_was_before_nor_if_it_has_come_slowly() {
        let limit_n = rig().cells.in_air_n();
        // At -0.9 of the limit an amplifier of 5 V is not live.
        for force_n in [0.9 * limit_n, -0.5 * limit_n] {
            assert!(tared(Accept::AnyZero, &[[force_n, 0.0, 0.0, 0.0, 0.0, 0.0]]).is_ok());
        }
        for force_n in [1.1 * limit_n, -1.1 * limit_n] {
            let detail = words(tared(Accept::AnyZero, &[[force_n, 0.0, 0.0, 0.0, 0.0, 0.0]]));
            assert!(
                detail.starts_with("cell 1 reads") && detail.contains("in the air"),
                "{detail}"
            );
        }
        // The last zeros have crept.
        let (config, crept) = (rig(), limit_n / rig().cells.newtons_per_volt());
        let [last, now] = [0.95, 1.05].map(|share| LAST.map(|v| v + share * crept));
        let detail = words(zeros(&config, 2, Accept::NearLast, &last, &[now]));
        assert!(detail.contains("from the nominal zero (limit 10 N, cells.in_air_n)"), "{detail}");
        // Cells of a larger range have a larger offset.
        let mut large = rig();
        large.cells.full_scale_n = 445.0;
        let offset_v = 0.03 * 445.0 / large.cells.newtons_per_volt();
        let read_v = std::array::from_fn(|i| LAST[i] + if i < 2 { offset_v } else { 0.0 });
        assert!(zeros(&large, 2, Accept::AnyZero, &LAST, &[read_v]).is_ok());
    }

    #[test]
    fn a_module_that_hangs_with_an_earlier_load_is_stale_and_the_load_none() {
        let mut stage = StandIns::default().stage();
        stage.tips = 2;
        let refused_at = |volts, repeats| {
            let reading = CellVolts { volts, repeats, at: tokio::time::Instant::now() };
            unless_hung(Halt::trip(TripKind::Cell, "a load"), &stage, Some(&reading))
        };
        let refused = |repeats| refused_at(LAST, repeats);
        let kind = |halt: Halt| halt.as_trip().map(|trip| trip.kind);
        assert_eq!(kind(refused([99; ARMS])), Some(TripKind::Stale));
        assert_eq!(kind(refused([0; ARMS])), Some(TripKind::Cell));
        // Unplugged, all of them.
        let unplugged = refused_at([0.0; ARMS], [99; ARMS]);
        assert_eq!(unplugged.as_trip().map(|trip| trip.detail.as_str()), Some("a load"));
    }

    #[test]
    fn a_cell_that_is_not_quiet_fails_the_attempt_and_does_not_trip() {
        let limit_n = TARE_NOISE_MULTIPLE * rig().cells.force_noise_n;
        let swings = |n: f64| [[n, 0.0, 0.0, 0.0, 0.0, 0.0], [-n, 0.0, 0.0, 0.0, 0.0, 0.0]];
        assert!(tared(Accept::NearLast, &swings(0.9 * limit_n)).is_ok());
        let why = words(tared(Accept::NearLast, &swings(1.1 * limit_n)));
        assert!(why.starts_with("failed: cell 1 varies by"), "{why}");
    }

    #[test]
    fn a_load_on_an_arm_without_a_tip_trips_and_an_unplugged_cell_there_does_not() {
        let at = |n| [0.0, 0.0, 0.0, n, 0.0, 0.0];
        let detail = words(tared(Accept::NearLast, &[at(1.1 * FOREIGN_N)]));
        assert!(detail.contains("no tip is entered for arm 4"), "{detail}");
        let unplugged = -0.5 * rig().cells.newtons_per_volt();
        assert_eq!(tared(Accept::NearLast, &[at(unplugged)]).unwrap()[3], LAST[3]);
    }
}
