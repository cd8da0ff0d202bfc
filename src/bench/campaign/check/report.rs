//! Findings of the rig check, as a value and as a table.
//! Uses: `rig::link` (counts). Never: devices, waits.

use std::fmt;

use serde::Serialize;

use crate::record::ARMS;
use crate::rig::config::Guard;
use crate::rig::link::LineCounts;

/// Findings of a rig check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// Name of the rig.
    pub rig: String,
    /// Label of the rig: `measured` or `virtual`.
    pub label: &'static str,
    /// Whether control of the drives was taken and their servos switched on.
    pub enabled: bool,
    /// Findings for the four axes; empty for a skin alone.
    pub axes: Vec<AxisFound>,
    /// Findings for the load cells; absent for a skin alone.
    pub cells: Option<CellsFound>,
    /// Findings for the voltage stream.
    pub stream: StreamFound,
    /// Counters of the wires.
    pub lines: Vec<LineFound>,
    /// Problems, as text; empty on a working rig.
    pub problems: Vec<String>,
    /// Properties of the drives that could not be checked in their present state, as text.
    pub unchecked: Vec<String>,
}

impl CheckReport {
    /// Whether no problem was found.
    pub fn is_sound(&self) -> bool {
        self.problems.is_empty()
    }
}

/// Findings for one axis; values that were not measured are absent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisFound {
    /// Name of the axis: `x`, `y`, `z` or `radial`.
    pub name: &'static str,
    /// Unit of its position: `mm` or `deg`.
    pub unit: &'static str,
    /// Identity that the drive reports.
    pub identity: Option<String>,
    /// Guards that the rig file requests from the drive.
    pub guard: Guard,
    /// Measured position, in `unit`.
    pub position: Option<f64>,
    /// Whether homing has been completed since power-up.
    pub homed: Option<bool>,
    /// Alarm code; absent without an alarm.
    pub alarm: Option<u32>,
    /// Median duration of a status request, wall us.
    pub status_us: Option<f64>,
    /// Longest duration of a status request, wall us.
    pub status_us_max: Option<f64>,
}

/// Findings for the load cells; values that were not measured are absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CellsFound {
    /// Identity that the module reports.
    pub identity: Option<String>,
    /// Mean output of arms 1 to 6, V.
    pub volts: Option<[f64; ARMS]>,
    /// Mean forces of arms 1 to 6 above the nominal zero of the cells (not tared), N.
    pub force_n: Option<[f64; ARMS]>,
    /// Standard deviation of each force, N.
    pub noise_n: Option<[f64; ARMS]>,
    /// Number of connected cells.
    pub live: Option<usize>,
    /// Median duration of a reading, wall us.
    pub read_us: Option<f64>,
}

/// Findings for the voltage stream; values that were not measured are absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StreamFound {
    /// Last line of text from the device.
    pub status_line: Option<String>,
    /// Number of frames evaluated.
    pub frames: usize,
    /// Frames per process second, by the clock of the device.
    pub frame_rate_hz: Option<f64>,
    /// Device seconds per wall second; on a working rig the `clock_rate` of the rig file.
    pub device_rate: Option<f64>,
    /// Number of frames missing according to the sequence numbers, since the bench was opened.
    pub missed: u64,
    /// Number of damaged packets since the bench was opened.
    pub garbled: u64,
    /// Standard deviation over the channels of the mean frame, V.
    pub frame_sd_v: Option<f64>,
    /// Standard deviation of a channel over the frames, V.
    pub noise_sd_v: Option<f64>,
    /// Ratio of `frame_sd_v` to `noise_sd_v`.
    pub signal_to_noise: Option<f64>,
    /// Largest magnitude of an injection sum, V; only noise in a valid frame.
    pub injection_sum_v: Option<f64>,
    /// Number of saturated channels in the last frame.
    pub saturated_channels: Option<usize>,
}

/// Counters of one wire.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LineFound {
    /// Name of the wire in the rig file.
    pub name: String,
    /// Counters since the wire was opened.
    pub counts: LineCounts,
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scope = match (&self.cells, self.enabled) {
            (None, _) => "a skin alone",
            (Some(_), true) => "drives enabled",
            (Some(_), false) => "read only",
        };
        writeln!(f, "rig {} ({}), {scope}\n", self.rig, self.label)?;
        for problem in &self.problems {
            writeln!(f, "WRONG  {problem}")?;
        }
        if !self.is_sound() {
            writeln!(f)?;
        }
        if let Some(cells) = &self.cells {
            self.fmt_bench(cells, f)?;
        }
        self.fmt_stream(f)?;
        if self.cells.is_some() {
            self.fmt_lines(f)?;
        }
        writeln!(f)?;
        for unchecked in &self.unchecked {
            writeln!(f, "NOT CHECKED  {unchecked}")?;
        }
        match (self.is_sound(), self.unchecked.is_empty()) {
            (true, true) => writeln!(f, "All devices match the rig file."),
            (true, false) => writeln!(f, "Everything that was checked matches the rig file."),
            (false, _) => Ok(()),
        }
    }
}

impl CheckReport {
    fn fmt_bench(&self, c: &CellsFound, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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

    fn fmt_lines(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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
        Ok(())
    }

    fn fmt_stream(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = &self.stream;
        let rate = shown(s.frame_rate_hz, |r| format!("{r:.2} frames/s"));
        let clock = shown(s.device_rate, |r| format!("{r:.2}"));
        writeln!(
            f,
            "\nert: {rate}, device clock at {clock} of wall time; \
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
        if let Some(line) = &s.status_line { writeln!(f, "  status: {line}") } else { Ok(()) }
    }
}

/// Returns a value as text, or a dash if it was not measured.
fn shown<T>(value: Option<T>, show: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| "-".into(), show)
}
