//! Fig. 7: how well simulated twins fit the measured trials of a run, as text, tables and figures.
//! PURE. Uses: `evaluate::{simulation, figures, frame_pairs}`. Never: computed scores (they are in the report).

use std::fmt::Write;

use serde_json::json;
use sim_core::sensor::Sensor;

use crate::evaluate::figures::{FigureResult, Quantity, boxes, by_force, map};
use crate::evaluate::frame_pairs::{FramePair, frame_pairs};
use crate::evaluate::simulation::{BoxPlot, FORCE_BIN_N, SimulationReport};
use crate::figure::Heading;
use crate::figure::skin::Outline;
use crate::plain::counted;
use crate::sheet::OutputFile;
use crate::store::RunRow;

/// Number of pairs of electrodes in the text, the worst first.
const PAIRS_IN_TEXT: usize = 3;

/// Returns the numbers (JSON), the tables (CSV) and the figures (SVG) of a report.
///
/// `pairs`: trials whose frames are drawn; without any there is no `frames.svg`. Without a readable sensor file of the run there is no `fvu_map.svg`.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
///
/// Source: paper, Fig. 7.
pub fn files(
    run: &RunRow,
    report: &SimulationReport,
    pairs: &[FramePair],
) -> FigureResult<Vec<OutputFile>> {
    let numbers = json!({
        "run": run.uid, "scan_id": run.scan_id, "experiment": run.experiment, "label": run.label,
        "report": report,
    });
    let file = |name: &str, text: String| OutputFile::new(name, text);
    let mut files = vec![
        file("simulation.json", format!("{numbers:#}\n")),
        file("by_force.csv", by_force_csv(report)),
        file("by_contacts.csv", by_contacts_csv(report)),
        file("by_point.csv", by_point_csv(report)),
        file("by_pair.csv", by_pair_csv(report)),
    ];
    let of_run = format!("run {}", run.scan_id);
    let heading = |title: &str, n: u64, of: &str| {
        Heading::new(format!("{title}, {of_run}"), n, of, run.label.as_str())
    };
    let touched: u64 = report.by_contacts.iter().map(|b| b.trials).sum();
    for (key, quantity) in [("rmse", Quantity::Rmse), ("fvu", Quantity::Fvu)] {
        let name = key.to_uppercase();
        let title = format!("{name} of the twins by force");
        let figure = by_force(&heading(&title, report.trials, "trials"), report, quantity)?;
        files.push(file(&format!("{key}_by_force.svg"), figure));
        let title = format!("{name} of the twins by the number of contacts");
        let figure = boxes(&heading(&title, touched, "trials with contacts"), report, quantity)?;
        files.push(file(&format!("{key}_by_contacts.svg"), figure));
    }
    if let Ok(sensor) = Sensor::from_toml(&run.sensor) {
        let single: u64 = report.by_point.iter().map(|p| p.trials).sum();
        let heading = heading("FVU of the twins on the skin", single, "trials of single tips");
        files.push(file("fvu_map.svg", map(&heading, &report.by_point, &Outline::of(&sensor))?));
    }
    if !pairs.is_empty() {
        let heading = heading("Measured frames and their twins", pairs.len() as u64, "trials");
        files.push(file("frames.svg", frame_pairs(&heading, pairs)?));
    }
    Ok(files)
}

/// Returns the report as text for people.
pub fn text(run: &RunRow, report: &SimulationReport) -> String {
    let number = |v: Option<f64>, scale: f64, unit: &str| {
        v.map_or_else(|| "not known".into(), |v| format!("{:.3}{unit}", scale * v))
    };
    let mut text = format!(
        "run {} ({}): simulation against {} ({} excluded by flags)\n\
         contact trials: median FVU {}, median RMSE {}; deadband {}\n",
        run.scan_id,
        run.label.as_str(),
        counted(report.trials, "trial", "trials"),
        report.flagged,
        number(report.median_fvu, 1.0, ""),
        number(report.median_rmse_v, 1e3, " mV"),
        number(report.deadband_n, 1.0, " N"),
    );
    let _ = writeln!(text, "contacts   trials   FVU q1   median   q3      RMSE median, mV");
    let _ = writeln!(text, "{:>8} {:>8}", 0, report.contact_counts[0]);
    for b in &report.by_contacts {
        let _ = writeln!(
            text,
            "{:>8} {:>8} {:>8.3} {:>8.3} {:>8.3} {:>12.2}",
            b.contacts,
            b.trials,
            b.fvu.q1,
            b.fvu.median,
            b.fvu.q3,
            1e3 * b.rmse_v.median
        );
    }
    let mut pairs = report.by_pair.clone();
    pairs.sort_by(|a, b| b.fvu.total_cmp(&a.fvu));
    pairs.truncate(PAIRS_IN_TEXT);
    if !pairs.is_empty() {
        let worst =
            pairs.iter().map(|p| format!("{}-{} {:.3}", p.electrodes[0], p.electrodes[1], p.fvu));
        let worst = worst.collect::<Vec<_>>().join(", ");
        let trials = report.pair_trials;
        let _ = writeln!(
            text,
            "FVU of the worst pairs of electrodes, newest contact trials ({trials}): {worst}"
        );
    }
    text.pop();
    text
}

/// Table of Fig. 7B and 7E: forces in N, RMSE in V.
fn by_force_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("contacts,from_n,to_n,trials,mean_rmse_v,mean_fvu\n");
    for b in &report.by_force {
        let contacts = b.contacts.map_or_else(|| "all".into(), |n| n.to_string());
        let (from, to) = (b.from_n, b.from_n + FORCE_BIN_N);
        let _ =
            writeln!(csv, "{contacts},{from},{to},{},{},{}", b.trials, b.mean_rmse_v, b.mean_fvu);
    }
    csv
}

/// Table of Fig. 7C and 7F: box plots, RMSE in V.
fn by_contacts_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("contacts,trials,quantity,low,q1,median,q3,high,outliers\n");
    for b in &report.by_contacts {
        for (name, BoxPlot { low, q1, median, q3, high, outliers }) in
            [("rmse_v", b.rmse_v), ("fvu", b.fvu)]
        {
            let (n, trials) = (b.contacts, b.trials);
            let _ = writeln!(csv, "{n},{trials},{name},{low},{q1},{median},{q3},{high},{outliers}");
        }
    }
    csv
}

/// Table of Fig. 7D: positions in skin coordinates, mm.
fn by_point_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("x_mm,y_mm,trials,mean_fvu\n");
    for p in &report.by_point {
        let _ = writeln!(csv, "{},{},{},{}", p.x_mm, p.y_mm, p.trials, p.mean_fvu);
    }
    csv
}

/// Table of the pairs of neighbouring electrodes, numbered from 0.
fn by_pair_csv(report: &SimulationReport) -> String {
    let mut csv = String::from("electrode,next,fvu\n");
    for p in &report.by_pair {
        let _ = writeln!(csv, "{},{},{}", p.electrodes[0], p.electrodes[1], p.fvu);
    }
    csv
}
