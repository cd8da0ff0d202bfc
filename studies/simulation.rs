//! Fig. 7: how well simulated twins fit the measured trials of a run, as text, tables and figures.
//! PURE. Uses: `evaluate::{simulation, figures}`. Never: computed scores (they are in the report).

use std::fmt::Write;

use serde_json::json;
use sim_core::sensor::Sensor;

use crate::evaluate::figures::{FigureError, Outline, Quantity, boxes, by_force, frames, map};
use crate::evaluate::simulation::{BoxPlot, FORCE_BIN_N, SimulationReport};
use crate::sheet::OutputFile;
use crate::store::RunRow;

/// Returns the numbers (JSON), the tables (CSV) and the figures (SVG) of a report.
///
/// `example`: measured and simulated frame of one trial, V, 784 each, injection-major; without it
/// there is no `frames.svg`. Without a readable sensor file of the run there is no `fvu_map.svg`.
///
/// # Errors
/// `FigureError` if a figure cannot be drawn.
///
/// Source: paper, Fig. 7.
pub fn files(
    run: &RunRow,
    report: &SimulationReport,
    example: Option<(&[f32], &[f32])>,
) -> Result<Vec<OutputFile>, FigureError> {
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
        file("rmse_by_force.svg", by_force(report, Quantity::Rmse)?),
        file("rmse_by_contacts.svg", boxes(report, Quantity::Rmse)?),
        file("fvu_by_force.svg", by_force(report, Quantity::Fvu)?),
        file("fvu_by_contacts.svg", boxes(report, Quantity::Fvu)?),
    ];
    if let Ok(sensor) = Sensor::from_toml(&run.sensor) {
        files.push(file("fvu_map.svg", map(&report.by_point, &outline(&sensor))?));
    }
    if let Some((measured_v, simulated_v)) = example {
        files.push(file("frames.svg", frames(measured_v, simulated_v)?));
    }
    Ok(files)
}

/// Returns the report as text for people.
pub fn text(run: &RunRow, report: &SimulationReport) -> String {
    let number = |v: Option<f64>, scale: f64, unit: &str| {
        v.map_or_else(|| "not known".into(), |v| format!("{:.3}{unit}", scale * v))
    };
    let mut text = format!(
        "run {} ({}): simulation against {} {} ({} excluded by flags)\n\
         contact trials: median FVU {}, median RMSE {}; deadband {}\n",
        run.scan_id,
        run.label.as_str(),
        report.trials,
        if report.trials == 1 { "trial" } else { "trials" },
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
    text.pop();
    text
}

fn outline(sensor: &Sensor) -> Outline {
    Outline {
        size_mm: [sensor.file.width_mm, sensor.file.height_mm],
        electrodes_mm: sensor.electrodes_mm().to_vec(),
        pitch_mm: sensor.pitch_mm(),
    }
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
