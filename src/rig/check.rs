//! The rig check: talks to every device of a bench and says what it found, and what is wrong in
//! words. Nothing moves.
//! Uses: `registry`, `traits`, `config`, `clock`. Never: motion, homing, tares that are kept.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use tokio::time::Instant;

use super::config::{ARMS, RigConfig};
use super::link::LineCounts;
use super::registry::OpenBench;
use super::traits::{Axis, CellVolts, Frame};
use crate::clock::Clock;

/// Round trips that are timed on each axis.
const ROUND_TRIPS: usize = 20;
/// Samples of the cells.
const CELL_SAMPLES: usize = 10;
/// Frames that are looked at.
const FRAMES: usize = 30;
/// A frame rate that differs from the file's by more than this part is wrong.
const RATE_TOLERANCE: f64 = 0.1;
/// Output, as a part of the supply, below which a cell counts as disconnected (live zero is 0.1).
const DEAD_BELOW: f64 = 0.02;
/// Output, as a part of the supply, above which a cell counts as saturated (full scale is 0.9).
const SATURATED_ABOVE: f64 = 0.95;
/// An injection's sum counts as noise up to this many deviations of a sum of its channels.
const SUM_SIGMAS: f64 = 6.0;

/// What the check found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// Name of the rig.
    pub rig: String,
    /// `measured` or `virtual`.
    pub label: &'static str,
    /// The four axes.
    pub axes: Vec<AxisFound>,
    /// The load cells.
    pub cells: CellsFound,
    /// The voltage stream.
    pub stream: StreamFound,
    /// The wires.
    pub lines: Vec<LineFound>,
    /// What is wrong, in words; empty on a sound rig.
    pub problems: Vec<String>,
}

impl CheckReport {
    /// Nothing is wrong.
    pub fn is_sound(&self) -> bool {
        self.problems.is_empty()
    }
}

/// One axis. What was not measured is absent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisFound {
    /// `x`, `y`, `z` or `radial`.
    pub name: &'static str,
    /// Unit of its position.
    pub unit: &'static str,
    /// What the drive says of itself.
    pub identity: Option<String>,
    /// Measured position, in `unit`.
    pub position: Option<f64>,
    /// Homing has been done since power-up.
    pub homed: Option<bool>,
    /// Alarm code.
    pub alarm: Option<u32>,
    /// Median time of a status, wall us.
    pub status_us: Option<f64>,
    /// Longest time of a status, wall us.
    pub status_us_max: Option<f64>,
}

/// The load cells.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CellsFound {
    /// What the module says of itself.
    pub identity: Option<String>,
    /// Mean output of arms 1 to 6, V.
    pub volts: Option<[f64; ARMS]>,
    /// The same as force above the cells' nominal zero (not tared), N.
    pub force_n: Option<[f64; ARMS]>,
    /// Standard deviation of each, N.
    pub noise_n: Option<[f64; ARMS]>,
    /// Cells with a live zero.
    pub live: Option<usize>,
    /// Median time of a reading, wall us.
    pub read_us: Option<f64>,
}

/// The voltage stream.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamFound {
    /// The device's last line of text.
    pub status_line: Option<String>,
    /// Frames looked at.
    pub frames: usize,
    /// Frames a process second, by the device's own clock.
    pub frame_rate_hz: Option<f64>,
    /// Device seconds in a wall second: the rig file's `clock_rate`, if all is well.
    pub device_rate: Option<f64>,
    /// Frames missing by their numbers, since the bench was opened.
    pub missed: u64,
    /// Damaged packets, since the bench was opened.
    pub garbled: u64,
    /// Standard deviation over the channels of the mean frame, V.
    pub frame_sd_v: Option<f64>,
    /// Standard deviation of a channel over the frames, V.
    pub noise_sd_v: Option<f64>,
    /// Their ratio.
    pub signal_to_noise: Option<f64>,
    /// Largest magnitude of an injection's sum, V: noise, on a sound frame.
    pub injection_sum_v: Option<f64>,
    /// Channels at the converter's end in the last frame.
    pub saturated_channels: Option<usize>,
}

/// One wire.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LineFound {
    /// Name in the rig file.
    pub name: String,
    /// What it has done.
    pub counts: LineCounts,
}

/// Talks to every device of an open bench. Takes a few seconds at most on a sound rig; on a dead
/// one each device costs its deadline.
pub async fn check(config: &RigConfig, open: &OpenBench, clock: &Clock) -> CheckReport {
    let mut problems = Vec::new();
    let mut axes = Vec::with_capacity(4);
    for (axis, unit) in [
        (&open.bench.x, "mm"),
        (&open.bench.y, "mm"),
        (&open.bench.z, "mm"),
        (&open.bench.radial, "deg"),
    ] {
        axes.push(check_axis(axis, unit, clock, &mut problems).await);
    }
    let cells = check_cells(config, open, clock, &mut problems).await;
    let stream = check_stream(config, open, clock, &mut problems).await;
    let lines = open
        .lines
        .iter()
        .map(|(name, line)| LineFound { name: name.clone(), counts: line.counts() })
        .collect();
    let (rig, label) = (config.name.clone(), config.label.as_str());
    CheckReport { rig, label, axes, cells, stream, lines, problems }
}

async fn check_axis(
    axis: &Arc<dyn Axis>,
    unit: &'static str,
    clock: &Clock,
    problems: &mut Vec<String>,
) -> AxisFound {
    let mut found = AxisFound {
        name: axis.name(),
        unit,
        identity: None,
        position: None,
        homed: None,
        alarm: None,
        status_us: None,
        status_us_max: None,
    };
    match axis.prepare().await {
        Ok(identity) => found.identity = Some(identity),
        Err(error) => problems.push(error.to_string()),
    }
    let mut times_us = Vec::with_capacity(ROUND_TRIPS);
    for _ in 0..ROUND_TRIPS {
        let asked = clock.now();
        match axis.status().await {
            Ok(status) => {
                times_us.push(micros(status.at - asked));
                found.position = Some(status.position);
                found.homed = Some(status.homed);
                found.alarm = status.alarm;
            }
            Err(error) => {
                if found.identity.is_some() {
                    problems.push(error.to_string());
                }
                break;
            }
        }
    }
    let [min, max] = axis.travel();
    if let (Some(position), Some(true)) = (found.position, found.homed)
        && !(min..=max).contains(&position)
    {
        let name = axis.name();
        problems.push(format!("{name}: stands at {position:.3} {unit}, outside [{min}, {max}]"));
    }
    found.status_us = median(&mut times_us);
    found.status_us_max = times_us.last().copied();
    found
}

async fn check_cells(
    config: &RigConfig,
    open: &OpenBench,
    clock: &Clock,
    problems: &mut Vec<String>,
) -> CellsFound {
    let cells = &open.bench.cells;
    let mut found = CellsFound {
        identity: None,
        volts: None,
        force_n: None,
        noise_n: None,
        live: None,
        read_us: None,
    };
    match cells.prepare().await {
        Ok(identity) => found.identity = Some(identity),
        Err(error) => {
            problems.push(error.to_string());
            return found;
        }
    }
    let (mut samples, mut times_us) = (Vec::<CellVolts>::new(), Vec::new());
    for _ in 0..CELL_SAMPLES {
        let asked = clock.now();
        match cells.read().await {
            Ok(sample) => {
                times_us.push(micros(sample.at - asked));
                samples.push(sample);
            }
            Err(error) => {
                problems.push(error.to_string());
                break;
            }
        }
        clock.sleep(config.cells.update_ms * 1e-3).await;
    }
    found.read_us = median(&mut times_us);
    if samples.is_empty() {
        return found;
    }
    let statistics: [(f64, f64); ARMS] =
        std::array::from_fn(|arm| mean_and_sd(samples.iter().map(|s| s.volts[arm])));
    let volts = statistics.map(|(mean, _)| mean);
    let (scale, zero_v) = (config.cells.newtons_per_volt(), config.cells.zero_v());
    found.force_n = Some(volts.map(|v| (v - zero_v) * scale));
    found.noise_n = Some(statistics.map(|(_, sd)| sd * scale));
    found.live = Some(volts.iter().filter(|&&v| v > DEAD_BELOW * config.cells.supply_v).count());
    found.volts = Some(volts);
    for (i, v) in volts.iter().enumerate() {
        if *v > SATURATED_ABOVE * config.cells.supply_v {
            problems.push(format!("cells: arm {} is saturated at {v:.3} V", i + 1));
        }
    }
    if found.live == Some(0) {
        problems.push("cells: none has a live zero: no supply, or nothing attached".into());
    }
    found
}

async fn check_stream(
    config: &RigConfig,
    open: &OpenBench,
    clock: &Clock,
    problems: &mut Vec<String>,
) -> StreamFound {
    let mut found = StreamFound {
        status_line: None,
        frames: 0,
        frame_rate_hz: None,
        device_rate: None,
        missed: 0,
        garbled: 0,
        frame_sd_v: None,
        noise_sd_v: None,
        signal_to_noise: None,
        injection_sum_v: None,
        saturated_channels: None,
    };
    let frames = collect(config, open, clock).await;
    let counters = open.bench.skin.counters();
    found.status_line = open.stream.status_line();
    (found.missed, found.garbled, found.frames) = (counters.missed, counters.garbled, frames.len());
    if frames.len() < FRAMES {
        let why = open.stream.wire_trouble().unwrap_or_else(|| "the wire is open".into());
        problems.push(format!("ert: {} of {FRAMES} frames came ({why})", frames.len()));
    }
    let Some((first, last)) = frames.first().zip(frames.last()).filter(|_| frames.len() > 1) else {
        return found;
    };
    let device_s = (last.device_time_us as f64 - first.device_time_us as f64) * 1e-6;
    let steps = f64::from(last.sequence.wrapping_sub(first.sequence));
    let wall_s = (last.received - first.received).as_secs_f64();
    if device_s > 0.0 && wall_s > 0.0 {
        let (rate, device_rate) = (steps / device_s, device_s / wall_s);
        found.frame_rate_hz = Some(rate);
        found.device_rate = Some(device_rate);
        let stated = config.ert.frame_rate_hz();
        if (rate / stated - 1.0).abs() > RATE_TOLERANCE {
            problems.push(format!("ert: {rate:.1} frames/s, but the rig file says {stated}"));
        }
        if (device_rate / clock.rate() - 1.0).abs() > 2.0 * RATE_TOLERANCE {
            let stated = clock.rate();
            problems.push(format!(
                "ert: its clock runs at {device_rate:.2} times the wall's, \
                 but clock_rate is {stated}: frames cannot be placed in time"
            ));
        }
    }
    signal(&frames, &mut found, problems);
    found
}

/// Waits for frames, at most a second longer than they take.
async fn collect(config: &RigConfig, open: &OpenBench, clock: &Clock) -> Vec<Arc<Frame>> {
    let mut feed = open.stream.subscribe();
    let needed = clock.wall(FRAMES as f64 / config.ert.frame_rate_hz());
    let age = Duration::from_millis(config.limits.frame_age_ms);
    let deadline: Instant = clock.now() + 2 * needed + age + Duration::from_secs(1);
    let mut frames = Vec::with_capacity(FRAMES);
    while frames.len() < FRAMES {
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
    // Rounding to counts alone leaves half a count in each of the sum's terms.
    let electrodes = (channels as f64).sqrt();
    let step_v = frames.iter().map(|f| f64::from(f.volts_per_count)).fold(0.0, f64::max);
    let limit_v = electrodes.sqrt() * SUM_SIGMAS * noise_sd.max(step_v);
    if sum_v > limit_v {
        problems.push(format!(
            "ert: an injection sums to {sum_v:.4} V, noise would stay under {limit_v:.4} V: \
             a channel is wrong"
        ));
    }
    let saturated = frames.last().map(|f| f.saturated_channels());
    if let Some(n) = saturated.filter(|&n| n > 0) {
        problems.push(format!("ert: {n} channels are at the converter's end"));
    }
    found.saturated_channels = saturated;
}

fn micros(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e6
}

/// Sorts, and gives the middle.
fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn mean_and_sd(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "rig {} ({})\n", self.rig, self.label)?;
        writeln!(
            f,
            "{:<8}{:>14}{:>8}{:>8}{:>12}  device",
            "axis", "position", "homed", "alarm", "status"
        )?;
        for a in &self.axes {
            let position = shown(a.position, |p| format!("{p:.3} {}", a.unit));
            let homed = shown(a.homed, |h| if h { "yes".into() } else { "no".into() });
            let alarm = shown(a.alarm, |c| format!("{c:X}"));
            let status = shown(a.status_us, |t| format!("{t:.0} us"));
            let device = shown(a.identity.as_deref(), str::to_owned);
            writeln!(f, "{:<8}{position:>14}{homed:>8}{alarm:>8}{status:>12}  {device}", a.name)?;
        }
        self.fmt_cells(f)?;
        self.fmt_stream(f)?;
        writeln!(
            f,
            "\n{:<12}{:>10}{:>9}{:>10}{:>12}{:>12}",
            "line", "answered", "retries", "timeouts", "reconnects", "last"
        )?;
        for l in &self.lines {
            let c = &l.counts;
            let last = format!("{} us", c.last_round_trip_us);
            let (n, r, t, o) = (c.answered, c.retries, c.timeouts, c.reconnects);
            writeln!(f, "{:<12}{n:>10}{r:>9}{t:>10}{o:>12}{last:>12}", l.name)?;
        }
        writeln!(f)?;
        for problem in &self.problems {
            writeln!(f, "WRONG  {problem}")?;
        }
        if self.is_sound() {
            writeln!(f, "All devices answer as the rig file says.")
        } else {
            Ok(())
        }
    }
}

impl CheckReport {
    fn fmt_cells(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.cells;
        let device = shown(c.identity.as_deref(), str::to_owned);
        let read = shown(c.read_us, |t| format!("{t:.0} us"));
        let live = shown(c.live, |n| format!("{n} of {ARMS}"));
        writeln!(f, "\ncells: {device}; {live} live; a reading takes {read}")?;
        let Some(((volts, force), noise)) = c.volts.zip(c.force_n).zip(c.noise_n) else {
            return Ok(());
        };
        for arm in 0..ARMS {
            let (v, n, sd) = (volts[arm], force[arm], noise[arm]);
            writeln!(f, "  arm {}  {v:>8.4} V  {n:>9.3} N  sd {sd:.3} N", arm + 1)?;
        }
        Ok(())
    }

    fn fmt_stream(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = &self.stream;
        let rate = shown(s.frame_rate_hz, |r| format!("{r:.2} frames/s"));
        let clock = shown(s.device_rate, |r| format!("{r:.2}"));
        writeln!(
            f,
            "\nert: {rate}, its clock at {clock} of the wall's; {} frames looked at, {} missed, {} garbled",
            s.frames, s.missed, s.garbled
        )?;
        let volts = |v: Option<f64>| shown(v, |v| format!("{v:.5} V"));
        let snr = shown(s.signal_to_noise, |r| format!("{r:.1} ({:.1} dB)", 20.0 * r.log10()));
        writeln!(
            f,
            "  frame sd {}, noise sd {}, ratio {snr}",
            volts(s.frame_sd_v),
            volts(s.noise_sd_v)
        )?;
        let saturated = shown(s.saturated_channels, |n| n.to_string());
        writeln!(
            f,
            "  largest injection sum {}, saturated channels {saturated}",
            volts(s.injection_sum_v)
        )?;
        if let Some(line) = &s.status_line { writeln!(f, "  says: {line}") } else { Ok(()) }
    }
}

/// A value, or a dash if it was not measured.
fn shown<T>(value: Option<T>, show: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "-".into(), show)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(noise: i16, broken: i16) -> Vec<Arc<Frame>> {
        let received = Clock::new(1.0).now();
        (0..30_u32)
            .map(|n| {
                let wobble = if n % 2 == 0 { noise } else { -noise };
                let mut counts = vec![100 + wobble, -60 - wobble, -40, 0];
                counts = counts.repeat(4);
                counts[5] += broken;
                Arc::new(Frame {
                    sequence: n,
                    device_time_us: u64::from(n) * 33_333,
                    volts_per_count: 1e-3,
                    counts,
                    received,
                })
            })
            .collect()
    }

    fn judge(frames: &[Arc<Frame>]) -> (StreamFound, Vec<String>) {
        let mut found = StreamFound {
            status_line: None,
            frames: frames.len(),
            frame_rate_hz: None,
            device_rate: None,
            missed: 0,
            garbled: 0,
            frame_sd_v: None,
            noise_sd_v: None,
            signal_to_noise: None,
            injection_sum_v: None,
            saturated_channels: None,
        };
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
