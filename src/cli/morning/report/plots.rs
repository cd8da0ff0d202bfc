//! The figures of a report, each with title, axes, units, n and label.
//! PURE. Uses: `evaluate::run_figures`, `facts`. Never: a figure without data.

use std::collections::BTreeMap;

use sim_core::stats::median;

use super::super::answers::{TrialFacts, tips_words};
use super::facts::Facts;
use crate::api::forces_by_depth;
use crate::cli::output::counted;
use crate::cli::summary::table_one;
use crate::evaluate::charts::Line;
use crate::evaluate::figures::{FigureResult, map};
use crate::evaluate::run_figures::{Band, Contacts, bands, contacts, histogram, over_time};
use crate::figure::{Heading, with_n};
use crate::store::RunKind;

/// FVU at the end of the histogram, and trials in a point of the FVU over time.
const FVU_END: f64 = 2.0;
const FVU_POINTS: usize = 60;
/// Most points of a line over time: more are thinned evenly.
const POINTS: usize = 400;

/// A figure with its caption.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// The figure as an `svg` element.
    pub svg: String,
    /// What it shows, for people.
    pub caption: String,
}

fn plot(svg: String, caption: impl Into<String>) -> Plot {
    Plot { svg, caption: caption.into() }
}

/// Force over depth by number of tips, and by arm where several tips press at once.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
pub fn forces(facts: &Facts) -> FigureResult<Vec<Plot>> {
    let label = facts.run().label.as_str();
    let mut plots = Vec::new();
    let mut by_tips = BTreeMap::<u8, Vec<(f64, f64)>>::new();
    let mut by_arm = BTreeMap::<usize, Vec<(f64, f64)>>::new();
    let most = facts.trials.iter().map(|trial| trial.tips).max().unwrap_or(0);
    for (depth_mm, arm, force_n, tips) in facts.trials.iter().flat_map(readings) {
        by_tips.entry(tips).or_default().push((depth_mm, force_n));
        if tips == most {
            by_arm.entry(arm).or_default().push((depth_mm, force_n));
        }
    }
    if !by_tips.is_empty() {
        let n = by_tips.values().map(Vec::len).sum::<usize>();
        let heading = Heading::new("Force of a tip over depth", n as u64, "readings", label);
        let kind = facts.run().kind;
        let named = by_tips.iter().map(|(tips, values)| (tips_words(kind, *tips), values));
        let svg = bands(&heading, "force of a tip (N)", &curves(named))?;
        plots.push(plot(svg, "Median and quartiles of the force of each attached tip, by the number of tips. n: readings."));
    }
    if by_arm.len() > 1 {
        let n = by_arm.values().map(Vec::len).sum::<usize>();
        let title = format!("Force of each arm, {}", tips_words(facts.run().kind, most));
        let heading = Heading::new(title, n as u64, "readings", label);
        let named = by_arm.iter().map(|(arm, values)| (format!("arm {arm}"), values));
        let svg = bands(&heading, "force (N)", &curves(named))?;
        plots.push(plot(
            svg,
            "Median and quartiles by arm: arms that differ have another tip, cell or place.",
        ));
    }
    Ok(plots)
}

/// Depth, mm, arm, force, N, and number of tips of each attached tip.
fn readings(trial: &TrialFacts) -> impl Iterator<Item = (f64, usize, f64, u8)> + '_ {
    let depth_mm = trial.depth_mm;
    let arms = trial.forces_n.iter().enumerate();
    arms.filter_map(move |(arm, force_n)| Some((depth_mm?, arm + 1, (*force_n)?, trial.tips)))
}

fn curves<'a>(named: impl Iterator<Item = (String, &'a Vec<(f64, f64)>)>) -> Vec<Band> {
    let curve = |(name, values): (String, &Vec<(f64, f64)>)| {
        let name = with_n(&name, values.len() as u64);
        let at = forces_by_depth(None, values.iter().copied()).into_iter();
        Band { name, places: at.map(|at| [at.depth_mm, at.q1_n, at.median_n, at.q3_n]).collect() }
    };
    named.map(curve).collect()
}

/// Trials by contacts against Table I.
///
/// # Errors
/// `FigureError` if the figure cannot be drawn.
pub fn counts(facts: &Facts) -> FigureResult<Option<Plot>> {
    let (run, here) = (facts.run(), facts.summary.contact_counts);
    let stored: u64 = here.iter().sum();
    if stored == 0 {
        return Ok(None);
    }
    let published = table_one(run.kind, stored);
    let heading = Heading::new("Trials by contacts", stored, "trials", run.label.as_str());
    let name = format!("run {} ({})", run.scan_id, run.label.as_str());
    let rule = match run.kind {
        // Placed weights are known: those below the deadband are contacts, too.
        RunKind::RealRandom => "Each placed weight is a contact".to_owned(),
        RunKind::RealHex | RunKind::Imported => {
            format!("Contacts below {} N are not counted", run.deadband_n)
        }
    };
    let caption = match &published {
        Some((name, _)) => format!(
            "{name} of the paper's Table I (measured), scaled to as many trials. {rule}; a run with \
             other numbers of contacts than the paper's has other shares."
        ),
        None => format!("{rule}."),
    };
    let published = published.map(|(name, all)| (format!("{name}, Table I, scaled"), all));
    let svg = contacts(&heading, &Contacts { here, name, published })?;
    Ok(Some(plot(svg, caption)))
}

/// Fit of the twins: histogram, and the map of single tips.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
pub fn twins(facts: &Facts) -> FigureResult<Vec<Plot>> {
    let label = facts.run().label.as_str();
    let values: Vec<f64> =
        facts.trials.iter().filter(|t| t.contact_count > 0).filter_map(|t| t.fvu).collect();
    let mut plots = Vec::new();
    if !values.is_empty() {
        let n = values.len() as u64;
        let heading = Heading::new("FVU of the twins", n, "trials with contacts", label);
        let mark = median(values.iter().copied()).map(|fvu| ("median", fvu));
        let svg = histogram(&heading, "fraction of variance unexplained", &values, FVU_END, mark)?;
        plots.push(plot(svg, "FVU (paper, Eq. 2) of each measured frame by its simulated twin; 0 is a perfect twin, 1 explains nothing."));
    }
    if let Some(outline) = facts.outline.as_ref().filter(|_| facts.fit.by_point.len() > 2) {
        let n = facts.fit.by_point.iter().map(|point| point.trials).sum();
        let heading =
            Heading::new("FVU of the twins on the skin", n, "trials of single tips", label);
        let svg = map(&heading, &facts.fit.by_point, outline)?;
        plots.push(plot(svg, "Mean FVU by position on the skin, single tips in contact."));
    }
    Ok(plots)
}

/// Drift: tares, reference presses, fit over time.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
pub fn drift(facts: &Facts) -> FigureResult<Vec<Plot>> {
    let label = facts.run().label.as_str();
    let x = format!("time since the start ({})", facts.time_unit().0);
    let mut plots = Vec::new();
    let mut tares = BTreeMap::<u8, Vec<(f64, f64)>>::new();
    for tare in &facts.tares {
        for (arm, volts) in &tare.volts {
            tares.entry(*arm).or_default().push((facts.since_start(tare.at), *volts));
        }
    }
    let changes = tares.iter().map(|(arm, all)| {
        let first = all.first().map_or(0.0, |at| at.1);
        let places = thinned(all).map(|(hours, volts)| (hours, 1e3 * (volts - first))).collect();
        Line { name: format!("arm {arm}"), places }
    });
    let changes: Vec<Line> = changes.filter(|line| line.places.len() > 1).collect();
    if !changes.is_empty() {
        let heading =
            Heading::new("Cells without load, change", facts.tares.len() as u64, "tares", label);
        let svg = over_time(&heading, &x, "change of the tare (mV)", &changes)?;
        plots.push(plot(svg, "Output of each cell without load, minus its first one. n: tares."));
    }
    let mut presses = BTreeMap::<(usize, u8), Vec<(f64, f64)>>::new();
    for press in &facts.references {
        for arm in &press.arms {
            let at = (facts.since_start(press.at), arm.force_n);
            presses.entry((press.arms.len(), arm.arm)).or_default().push(at);
        }
    }
    let lines: Vec<Line> = presses
        .iter()
        .filter(|(_, all)| all.len() > 1)
        .map(|((tips, arm), all)| {
            let name = format!("{}, arm {arm}", counted(*tips as u64, "tip", "tips"));
            Line { name, places: thinned(all).collect() }
        })
        .collect();
    if !lines.is_empty() {
        let heading =
            Heading::new("Reference press", facts.references.len() as u64, "presses", label);
        let svg = over_time(&heading, &x, "force (N)", &lines)?;
        plots.push(plot(svg, "Force of presses at a fixed place and depth: its change is that of skin and cells. n: presses."));
    }
    plots.extend(fit_over_time(facts)?);
    Ok(plots)
}

/// Medians of the FVU over time, trials with contacts, by the number of tips.
fn fit_over_time(facts: &Facts) -> FigureResult<Option<Plot>> {
    let mut by_tips = BTreeMap::<u8, Vec<(f64, f64)>>::new();
    for trial in facts.trials.iter().filter(|trial| trial.contact_count > 0) {
        if let (Some(at), Some(fvu)) = (trial.measured_at, trial.fvu) {
            by_tips.entry(trial.tips).or_default().push((facts.since_start(at), fvu));
        }
    }
    let n: usize = by_tips.values().map(Vec::len).sum();
    let size = n.div_ceil(FVU_POINTS).max(5);
    let lines = by_tips.iter().map(|(tips, all)| {
        let points = all
            .chunks(size)
            .filter(|chunk| chunk.len() == size)
            .filter_map(|chunk| Some((chunk[size / 2].0, median(chunk.iter().map(|at| at.1))?)));
        Line { name: tips_words(facts.run().kind, *tips), places: points.collect() }
    });
    let lines: Vec<Line> = lines.filter(|line| line.places.len() > 1).collect();
    if lines.is_empty() {
        return Ok(None);
    }
    let x = format!("time since the start ({})", facts.time_unit().0);
    let label = facts.run().label.as_str();
    let heading =
        Heading::new("Fit of the twins over time", n as u64, "trials with contacts", label);
    let svg = over_time(&heading, &x, "median FVU", &lines)?;
    let caption = format!("Median FVU of {size} consecutive trials with contacts.");
    Ok(Some(plot(svg, caption)))
}

fn thinned(all: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + '_ {
    all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied()
}
