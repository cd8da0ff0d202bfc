//! The rig check of the voltage stream: whether frames arrive, at which rate, and whether their
//! signal can be that of a working skin.
//! Uses: `ert_stream`, `traits`, `config`, `clock`. Never: writes.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::mean_and_sd;
use super::report::StreamFound;
use crate::clock::Clock;
use crate::rig::config::ErtConfig;
use crate::rig::ert_stream::ErtStream;
use crate::rig::traits::{Frame, SkinReader};

/// Minimum number of frames evaluated.
const FRAMES_MIN: usize = 30;
/// Minimum wall time over which they are collected, so that rates are accurate on an accelerated
/// rig too.
const FRAMES_OVER: Duration = Duration::from_millis(1500);
/// Largest relative deviation of the frame rate from the rig file.
const RATE_TOLERANCE: f64 = 0.1;
/// Limit of an injection sum, in standard deviations of a sum of its channels.
const SUM_SIGMAS: f64 = 6.0;

/// Evaluates the frames of the stream and reports problems.
pub(super) async fn check(
    config: &ErtConfig,
    frame_age: Duration,
    stream: &ErtStream,
    clock: &Clock,
    problems: &mut Vec<String>,
) -> StreamFound {
    let mut found = StreamFound::default();
    let frames = collect(config, frame_age, stream, clock).await;
    let counters = stream.counters();
    found.status_line = stream.status_line();
    (found.missed, found.garbled, found.frames) = (counters.missed, counters.garbled, frames.len());
    if frames.len() < FRAMES_MIN {
        let why = stream.wire_trouble().unwrap_or_else(|| "the wire is open".into());
        problems.push(format!("ert: {} of {FRAMES_MIN} frames arrived ({why})", frames.len()));
    }
    let Some((first, last)) = frames.first().zip(frames.last()).filter(|_| frames.len() > 1) else {
        return found;
    };
    let device_s = (last.device_time_us as f64 - first.device_time_us as f64) * 1e-6;
    if device_s > 0.0 {
        let rate = f64::from(last.sequence.wrapping_sub(first.sequence)) / device_s;
        found.frame_rate_hz = Some(rate);
        let stated = config.frame_rate_hz();
        if (rate / stated - 1.0).abs() > RATE_TOLERANCE {
            problems.push(format!("ert: {rate:.1} frames/s, but the rig file states {stated}"));
        }
    }
    found.device_rate = device_rate(&frames);
    if let Some(rate) = found.device_rate
        && (rate / clock.rate() - 1.0).abs() > 2.0 * RATE_TOLERANCE
    {
        let stated = clock.rate();
        problems.push(format!(
            "ert: device clock at {rate:.2} of wall time, but clock_rate is {stated}: \
             the time of a frame cannot be determined"
        ));
    }
    signal(&frames, &mut found, problems);
    found
}

/// Device seconds per wall second, from the least delayed frames of the first and the last third of
/// the wall time: delays in buffers have no effect.
fn device_rate(frames: &[Arc<Frame>]) -> Option<f64> {
    let first = frames.first()?;
    let place = |f: &Frame| {
        let wall_s = (f.received - first.received).as_secs_f64();
        (wall_s, (f.device_time_us as f64 - first.device_time_us as f64) * 1e-6)
    };
    let (span_s, device_s) = place(frames.last()?);
    // The least delayed frame is the most advanced in device time, relative to the approximate
    // rate.
    let about = device_s / span_s;
    let least_delayed = |from: f64, to: f64| {
        let within = frames.iter().map(|f| place(f)).filter(|p| (from..=to).contains(&p.0));
        within.max_by(|a, b| (a.1 - about * a.0).total_cmp(&(b.1 - about * b.0)))
    };
    let early = least_delayed(0.0, span_s / 3.0)?;
    let late = least_delayed(span_s * 2.0 / 3.0, span_s)?;
    let rate = (late.1 - early.1) / (late.0 - early.0);
    rate.is_finite().then_some(rate)
}

/// Collects frames, for at most twice their duration plus the frame age plus a second.
async fn collect(
    config: &ErtConfig,
    frame_age: Duration,
    stream: &ErtStream,
    clock: &Clock,
) -> Vec<Arc<Frame>> {
    let mut feed = stream.follow();
    let needed = clock.wall(FRAMES_MIN as f64 / config.frame_rate_hz());
    let deadline: Instant = clock.now() + 2 * needed + frame_age + Duration::from_secs(1);
    let mut frames: Vec<Arc<Frame>> = Vec::with_capacity(FRAMES_MIN);
    let enough = |frames: &[Arc<Frame>]| {
        let span = frames.first().zip(frames.last()).map(|(a, b)| b.received - a.received);
        frames.len() >= FRAMES_MIN && span >= Some(FRAMES_OVER)
    };
    while !enough(&frames) {
        match tokio::time::timeout_at(deadline, feed.recv()).await {
            Ok(Ok(frame)) => frames.push(frame),
            Ok(Err(tokio::sync::broadcast::error::RecvError::Lagged(_))) => {}
            Ok(Err(tokio::sync::broadcast::error::RecvError::Closed)) | Err(_) => break,
        }
    }
    frames
}

fn signal(frames: &[Arc<Frame>], found: &mut StreamFound, problems: &mut Vec<String>) {
    let voltages: Vec<Vec<f32>> = frames.iter().map(|f| f.voltages_v()).collect();
    let channels = voltages.iter().map(Vec::len).min().unwrap_or(0);
    let per_channel: Vec<(f64, f64)> =
        (0..channels).map(|c| mean_and_sd(voltages.iter().map(|v| f64::from(v[c])))).collect();
    let (_, frame_sd) = mean_and_sd(per_channel.iter().map(|(mean, _)| *mean));
    let variance = per_channel.iter().map(|(_, sd)| sd * sd).sum::<f64>() / channels.max(1) as f64;
    let noise_sd = variance.sqrt();
    found.frame_sd_v = Some(frame_sd);
    found.noise_sd_v = Some(noise_sd);
    found.signal_to_noise = (noise_sd > 0.0).then(|| frame_sd / noise_sd);
    let sum_v = frames.iter().map(|f| f.largest_injection_sum_v()).fold(0.0, f64::max);
    found.injection_sum_v = Some(sum_v);
    if noise_sd == 0.0 {
        problems.push("ert: no channel changes from frame to frame: is the reading frozen?".into());
    }
    // Rounding to counts alone adds half a count to each term of the sum.
    let electrodes = (channels as f64).sqrt();
    let step_v = frames.iter().map(|f| f64::from(f.volts_per_count)).fold(0.0, f64::max);
    let limit_v = electrodes.sqrt() * SUM_SIGMAS * noise_sd.max(step_v);
    if sum_v > limit_v {
        problems.push(format!(
            "ert: an injection sum is {sum_v:.4} V, limit of noise {limit_v:.4} V: \
             a channel is wrong"
        ));
    }
    let saturated = frames.last().map(|f| f.saturated_channels());
    if let Some(n) = saturated.filter(|&n| n > 0) {
        problems.push(format!("ert: {n} channels are saturated"));
    }
    found.saturated_channels = saturated;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in;

    #[test]
    fn the_devices_rate_is_seen_through_frames_that_wait() {
        let start = Clock::new(1.0).now();
        let frames: Vec<Arc<Frame>> = (0..300_u32)
            .map(|n| {
                let lag_ms = if n % 10 == 0 { 1 } else { 400 + u64::from(n) % 37 };
                let received = start + Duration::from_millis(5 * u64::from(n) + lag_ms);
                // 20 device seconds per wall second.
                let device_time_us = u64::from(n) * 100_000;
                let (sequence, counts) = (n, Vec::new());
                let volts_per_count = 1e-3;
                Arc::new(Frame { sequence, device_time_us, volts_per_count, counts, received })
            })
            .collect();
        let rate = device_rate(&frames).unwrap();
        assert!((rate - 20.0).abs() < 0.5, "{rate}");
        assert_eq!(device_rate(&frames[..1]), None);
    }

    fn frames(noise: i16, broken: i16) -> Vec<Arc<Frame>> {
        let frame = |n: u32| {
            let wobble = if n.is_multiple_of(2) { noise } else { -noise };
            let mut counts = [100 + wobble, -60 - wobble, -40, 0].repeat(4);
            counts[5] += broken;
            stand_in::frame(n, counts)
        };
        (0..30).map(frame).collect()
    }

    fn judge(frames: &[Arc<Frame>]) -> (StreamFound, Vec<String>) {
        let mut found = StreamFound { frames: frames.len(), ..StreamFound::default() };
        let mut problems = Vec::new();
        signal(frames, &mut found, &mut problems);
        (found, problems)
    }

    #[test]
    fn a_sound_stream_has_a_ratio_and_no_problem() {
        let (found, problems) = judge(&frames(2, 0));
        assert!(problems.is_empty(), "{problems:?}");
        assert!(found.signal_to_noise.unwrap() > 20.0);
        assert_eq!(found.injection_sum_v, Some(0.0));
    }

    #[test]
    fn a_broken_channel_shows_in_its_injections_sum_and_a_frozen_stream_is_named() {
        let (_, problems) = judge(&frames(2, 900));
        assert!(problems.iter().any(|p| p.contains("a channel is wrong")), "{problems:?}");
        let (found, problems) = judge(&frames(0, 0));
        assert!(problems.iter().any(|p| p.contains("frozen")), "{problems:?}");
        assert_eq!(found.signal_to_noise, None);
    }
}
