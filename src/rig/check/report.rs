//! What the rig check found, as a value and as a table.
//! Uses: `rig::link` (counts). Never: devices, waits.

use std::fmt;

use serde::Serialize;

use crate::rig::config::{ARMS, Guard};
use crate::rig::link::LineCounts;

/// What the check found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// Name of the rig.
    pub rig: String,
    /// `measured` or `virtual`.
    pub label: &'static str,
    /// Control of the drives was taken and their servos were switched on.
    pub enabled: bool,
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
    /// What could not be told of the drives as they stand, in words.
    pub unchecked: Vec<String>,
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
    /// What the rig file has the drive do by itself.
    pub guard: Guard,
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

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scope = if self.enabled { "drives enabled" } else { "read only" };
        writeln!(f, "rig {} ({}), {scope}\n", self.rig, self.label)?;
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
        for unchecked in &self.unchecked {
            writeln!(f, "NOT CHECKED  {unchecked}")?;
        }
        match (self.is_sound(), self.unchecked.is_empty()) {
            (true, true) => writeln!(f, "All devices answer as the rig file says."),
            (true, false) => writeln!(f, "What was checked answers as the rig file says."),
            (false, _) => Ok(()),
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
            "\nert: {rate}, its clock at {clock} of the wall's; \
             {} frames seen, {} missed, {} garbled",
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
