//! The rig check: reads identity and state of every device of a bench and reports problems as text.
//! Nothing moves, and nothing but a stop is written to a device unless enabling is requested.
//! Uses: `rig`, `bench::estop`, `clock`. Never: motion, homing, tares that are kept.

mod report;
mod stream;

use std::sync::Arc;
use std::time::Duration;

use sim_core::stats::{sorted, upper_quantile};
use tokio::time::Instant;

pub use self::report::{AxisFound, CellsFound, CheckReport, LineFound, StreamFound};
use crate::campaign::bench::estop::StopSwitch;
use crate::clock::Clock;
use crate::record::{ARMS, Label};
use crate::rig::config::{CellsConfig, RigConfig};
use crate::rig::error::RigError;
use crate::rig::ert_stream::ErtStream;
use crate::rig::registry::{self, OpenBench};
use crate::rig::setup::{RigSetup, SkinConfig};
use crate::rig::traits::{Axis, Bench, CellVolts};

/// Number of timed round trips per axis.
const ROUND_TRIPS: usize = 20;
/// Minimum number of samples of the cells; more if `repeats_max` needs more to be exceeded.
const CELL_SAMPLES: u32 = 10;
/// Longest wait after a press until every axis stands; then the wires are closed, since nothing was moved.
const STANDS_LIMIT: Duration = Duration::from_secs(10);
/// Period of that wait.
const STANDS_POLL: Duration = Duration::from_millis(10);

/// Extent of a check: what it may do to the drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// Registers are read, none is written.
    Look,
    /// Take control and switch the servos on, like connecting. They stay on.
    Enable,
}

/// Opens the wires of a rig, checks the bench and closes them. A press of `estop`, the emergency stop of the rig, ends
/// the check: the stops are sent as in a campaign, and the wires are closed once every axis stands.
///
/// # Errors
/// `RigError::Latched` if the emergency stop is or becomes latched, `RigError::NotReady` if an axis does not stand in time
/// then; other variants if a wire or reader cannot be opened. Findings of the check are part of the report.
///
/// # Panics
/// Outside a tokio runtime.
pub async fn run_on(
    rig: &RigSetup,
    estop: &StopSwitch,
    scope: Scope,
) -> Result<CheckReport, RigError> {
    let latched = || RigError::Latched { device: rig.name().into(), operation: "check".into() };
    let presses = estop.presses();
    if estop.pressed().is_some() {
        return Err(latched());
    }
    let clock = Clock::new(rig.clock_rate());
    let checked = match rig {
        RigSetup::Bench(config) => {
            let open = registry::open(config, &clock, &estop.latch())?;
            let work = check(config, &open, &clock, scope);
            unless_stopped(estop, presses, &open.bench, work).await?
        }
        RigSetup::Skin(skin) => {
            let open = registry::open_skin(skin, &clock)?;
            tokio::select! {
                biased;
                () = estop.pressed_after(presses) => None,
                report = check_skin(skin, &open, &clock) => Some(report),
            }
        }
    };
    checked.ok_or_else(latched)
}

/// Works on an open bench until the end, or until a press of the e-stop after the first `presses`: `None` once every
/// axis stands then.
async fn unless_stopped<T>(
    estop: &StopSwitch,
    presses: u64,
    bench: &Bench,
    work: impl Future<Output = T>,
) -> Result<Option<T>, RigError> {
    let guarded = async {
        tokio::select! {
            biased;
            () = estop.pressed_after(presses) => stand(estop).await.map(|()| None),
            done = work => Ok(Some(done)),
        }
    };
    tokio::select! {
        // Ends with its switch only, which outlasts this.
        () = estop.clone().serve(bench.clone()) => Ok(None),
        done = guarded => done,
    }
}

/// Waits until every axis stands.
async fn stand(estop: &StopSwitch) -> Result<(), RigError> {
    let deadline = Instant::now() + STANDS_LIMIT;
    loop {
        let stops = estop.pressed().map_or_else(Vec::new, |press| press.stops());
        let moving = stops.iter().find(|stop| stop.stood_ms.is_none());
        if moving.is_none() && !stops.is_empty() {
            return Ok(());
        }
        if Instant::now() > deadline {
            let device = moving.map_or_else(|| "bench".into(), |stop| stop.axis.clone());
            let error = moving.and_then(|stop| stop.error.as_deref());
            let why = format!("not stopped: {}", error.unwrap_or("not known to be at rest"));
            let operation = "the end of the check".into();
            return Err(RigError::NotReady { device, operation, why });
        }
        tokio::time::sleep(STANDS_POLL).await;
    }
}

/// Checks the stream of a skin alone.
async fn check_skin(config: &SkinConfig, open: &ErtStream, clock: &Clock) -> CheckReport {
    let mut problems = Vec::new();
    let frame_age = Duration::from_millis(config.limits.frame_age_ms);
    let stream = stream::check(&config.ert, frame_age, open, clock, &mut problems).await;
    CheckReport {
        rig: config.name.clone(),
        label: Label::from(config.label).as_str(),
        enabled: false,
        axes: Vec::new(),
        cells: None,
        stream,
        lines: Vec::new(),
        problems,
        unchecked: Vec::new(),
    }
}

/// Problems found and items that could not be checked, as text.
#[derive(Default)]
struct Words {
    problems: Vec<String>,
    unchecked: Vec<String>,
}

/// Checks every device of an open bench. Takes at most a few seconds on a working rig; each dead
/// device adds its deadline.
pub async fn check(
    config: &RigConfig,
    open: &OpenBench,
    clock: &Clock,
    scope: Scope,
) -> CheckReport {
    let mut words = Words::default();
    let mut axes = Vec::with_capacity(4);
    for (axis, unit) in [
        (&open.bench.x, "mm"),
        (&open.bench.y, "mm"),
        (&open.bench.z, "mm"),
        (&open.bench.radial, "deg"),
    ] {
        axes.push(check_axis(axis, unit, clock, scope, &mut words).await);
    }
    let Words { mut problems, unchecked } = words;
    let cells = Some(check_cells(config, open, clock, &mut problems).await);
    let frame_age = Duration::from_millis(config.limits.frame_age_ms);
    let stream = stream::check(&config.ert, frame_age, &open.stream, clock, &mut problems).await;
    let lines = open
        .lines
        .iter()
        .map(|(name, line)| LineFound { name: name.clone(), counts: line.counts() })
        .collect();
    let (rig, label) = (config.name.clone(), Label::from(config.label).as_str());
    let enabled = scope == Scope::Enable;
    CheckReport { rig, label, enabled, axes, cells, stream, lines, problems, unchecked }
}

/// Reads the identity of a drive and, if the scope allows it, takes control. Returns the identity.
async fn identify(axis: &dyn Axis, scope: Scope, words: &mut Words) -> Option<String> {
    let name = axis.name();
    let seen = match axis.identify().await {
        Ok(seen) => seen,
        Err(error) => {
            words.problems.push(error.to_string());
            return None;
        }
    };
    let faults = seen.faults();
    words.problems.extend(faults.iter().map(|fault| format!("{name}: {fault}")));
    let untried = seen.untried().into_iter().map(|what| format!("{name}: {what}"));
    match scope {
        Scope::Look => words.unchecked.extend(untried),
        Scope::Enable if !faults.is_empty() => {
            let because = faults.join(", ");
            words.unchecked.extend(untried.map(|what| format!("{what} ({because})")));
        }
        Scope::Enable => match axis.prepare().await {
            Ok(found) => return Some(found),
            Err(error) => words.problems.push(error.to_string()),
        },
    }
    Some(seen.to_string())
}

async fn check_axis(
    axis: &Arc<dyn Axis>,
    unit: &'static str,
    clock: &Clock,
    scope: Scope,
    words: &mut Words,
) -> AxisFound {
    let mut found = AxisFound {
        name: axis.name(),
        unit,
        identity: identify(axis.as_ref(), scope, words).await,
        guard: axis.guard(),
        position: None,
        homed: None,
        alarm: None,
        status_us: None,
        status_us_max: None,
    };
    let problems = &mut words.problems;
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
        problems.push(format!("{name}: position {position:.3} {unit}, outside [{min}, {max}]"));
    }
    let times_us = sorted(times_us);
    found.status_us = upper_quantile(&times_us, 0.5);
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
    let mut found = CellsFound::default();
    match cells.prepare().await {
        Ok(identity) => found.identity = Some(identity),
        Err(error) => {
            problems.push(error.to_string());
            return found;
        }
    }
    let (mut samples, mut times_us) = (Vec::<CellVolts>::new(), Vec::new());
    for _ in 0..CELL_SAMPLES.max(config.cells.repeats_max() + 2) {
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
    found.read_us = upper_quantile(&sorted(times_us), 0.5);
    if samples.is_empty() {
        return found;
    }
    let statistics: [(f64, f64); ARMS] =
        std::array::from_fn(|arm| mean_and_sd(samples.iter().map(|s| s.volts[arm])));
    let volts = statistics.map(|(mean, _)| mean);
    let (scale, zero_v) = (config.cells.newtons_per_volt(), config.cells.zero_v());
    found.force_n = Some(volts.map(|v| (v - zero_v) * scale));
    found.noise_n = Some(statistics.map(|(_, sd)| sd * scale));
    found.live = Some(volts.iter().filter(|&&v| config.cells.is_live(v)).count());
    found.volts = Some(volts);
    judge_cells(&config.cells, &samples, problems);
    if found.live == Some(0) {
        problems.push("cells: none has a live zero: no supply, or nothing attached".into());
    }
    found
}

/// Reports what would trip a run at its first reading: a saturated output, a value that repeats.
fn judge_cells(cells: &CellsConfig, samples: &[CellVolts], problems: &mut Vec<String>) {
    for arm in 0..ARMS {
        let highest_v = samples.iter().map(|s| s.volts[arm]).fold(0.0, f64::max);
        let live = samples.iter().any(|s| cells.is_live(s.volts[arm]));
        let repeats = samples.iter().map(|s| s.repeats[arm]).max().unwrap_or(0);
        if cells.is_saturated(highest_v) {
            let (arm, end_v) = (arm + 1, cells.saturated_v());
            problems.push(format!(
                "cells: arm {arm} is saturated at {highest_v:.3} V (limit {end_v} V)"
            ));
        } else if live && cells.is_hung(repeats) {
            let (arm, most) = (arm + 1, cells.repeats_max());
            problems.push(format!(
                "cells: arm {arm} has returned one value for {repeats} update periods, limit \
                 {most} (cells.repeats_max): the module hangs, or update_ms is too short"
            ));
        }
    }
}

fn micros(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e6
}

fn mean_and_sd(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::campaign::bench::stand_in::{self, StandIns};

    #[tokio::test]
    async fn a_check_that_is_stopped_ends_once_each_axis_has_acknowledged_and_stands() {
        let (estop, axes) = (StopSwitch::default(), StandIns::default());
        axes.x.replies.store(false, Ordering::SeqCst);
        axes.z.status.lock().moving = true;
        let bench = axes.bench();
        // A check that does not end by itself.
        let checks = unless_stopped(&estop, 0, &bench, std::future::pending::<()>());
        let mut checks = std::pin::pin!(checks);
        let mut within =
            async |ms| tokio::time::timeout(Duration::from_millis(ms), checks.as_mut()).await.ok();
        assert_eq!(within(50).await, None);
        assert_eq!(axes.stops(), 0);
        estop.press("hands");
        // Sent again to the one that is silent.
        assert_eq!(within(300).await, None);
        assert!(axes.stops() >= 3 && axes.x.stops.load(Ordering::SeqCst) == 0);
        axes.x.replies.store(true, Ordering::SeqCst);
        assert_eq!(within(300).await, None, "z moves");
        assert!(axes.x.stops.load(Ordering::SeqCst) > 0);
        axes.z.status.lock().moving = false;
        assert_eq!(within(10_000).await, Some(Ok(None)));
        let estop = StopSwitch::default();
        assert_eq!(unless_stopped(&estop, 0, &bench, std::future::ready(7)).await, Ok(Some(7)));
    }

    fn judged(volts: f64, repeats: u32) -> Vec<String> {
        let config = stand_in::config();
        let (mut all, mut held, at) = ([0.0; ARMS], [99; ARMS], Clock::new(1.0).now());
        (all[1], held[1]) = (volts, repeats);
        let mut problems = Vec::new();
        judge_cells(&config.cells, &[CellVolts { volts: all, repeats: held, at }], &mut problems);
        problems
    }

    #[test]
    fn a_cell_that_would_trip_a_run_fails_the_check_and_an_unplugged_one_does_not() {
        assert_eq!(judged(0.5, 3), Vec::<String>::new());
        assert!(judged(4.55, 0)[0].starts_with("cells: arm 2 is saturated at 4.550 V"));
        assert!(judged(0.5, 9)[0].starts_with("cells: arm 2 has returned one value for 9 update"));
    }
}
