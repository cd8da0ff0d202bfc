//! Times of the program, printed for a person; run with `--ignored`.
//! Uses: `common`. Never: a test that depends on a time.

use std::path::PathBuf;

use palpate_words::query_lines::Form;
use polars::prelude::DataFrame;

use crate::common::{BOUNDS, Folder, Trials, ask, seconds, table, text};

/// Files of the scalars of 3.3 million trials.
const FILES: u64 = 100;
const ROWS: u64 = 33_000;

const SCALARS: [(&str, &str); 8] = [
    ("count", "SELECT count(*) FROM trials"),
    (
        "group by tips",
        "SELECT tips, count(*) AS n, avg(fvu) AS fvu FROM trials GROUP BY tips ORDER BY tips",
    ),
    (
        "group by run",
        "SELECT scan_id, count(*) AS n, avg(fvu) AS fvu, max(max_force_n) AS f FROM trials \
         GROUP BY scan_id ORDER BY scan_id LIMIT 3",
    ),
    (
        "group by label",
        "SELECT label, count(*) AS n FROM trials GROUP BY label ORDER BY label LIMIT 3",
    ),
    (
        "histogram",
        "SELECT floor(max_force_n / 0.5) * 0.5 AS force_n, count(*) AS n FROM trials \
         GROUP BY force_n ORDER BY force_n LIMIT 3",
    ),
    (
        "filter and group",
        "SELECT tips, avg(rmse_v) AS rmse_v FROM trials WHERE max_force_n > 10 AND tips IN (1, 2) \
         GROUP BY tips ORDER BY tips",
    ),
    ("top 10", "SELECT trial_id, fvu FROM trials WHERE fvu IS NOT NULL ORDER BY fvu DESC LIMIT 10"),
    ("median", "SELECT tips, median(fvu) AS fvu FROM trials GROUP BY tips ORDER BY tips"),
];

const FRAME_QUERIES: [(&str, &str); 2] = [
    (
        "FVU by pair",
        "SELECT pair, avg((voltage_v - sim_voltage_v) * (voltage_v - sim_voltage_v)) \
         / (avg(voltage_v * voltage_v) - avg(voltage_v) * avg(voltage_v)) AS fvu \
         FROM voltages WHERE sim_voltage_v IS NOT NULL GROUP BY pair ORDER BY pair LIMIT 3",
    ),
    (
        "frames of three contacts",
        "SELECT f.* FROM frames f JOIN trials t USING (trial_id) \
      WHERE t.tips = 3 AND t.max_force_n > 10 LIMIT 10000",
    ),
];

fn measured(kind: &str, files: &[PathBuf], form: &dyn Fn(&str) -> Form, asked: &[(&str, &str)]) {
    for (name, sql) in asked {
        let tables: Vec<_> =
            ["trials", "frames", "voltages"].map(|name| table(name, form(name), files)).into();
        let mut times = Vec::new();
        let mut rows = DataFrame::empty();
        for _ in 0..4 {
            let (time, outcome) = seconds(|| ask(sql, &tables, BOUNDS));
            times.push(time * 1000.0);
            rows = match outcome {
                crate::common::Outcome::Rows(rows) => rows,
                other => {
                    println!("{kind}: {name}: {other:?}");
                    break;
                }
            };
        }
        let first = times[0];
        times.sort_by(f64::total_cmp);
        let shown = if rows.height() <= 10 { text(&rows) } else { rows.height().to_string() };
        println!(
            "{kind}: {name}: {:.0} ms at best, {first:.0} ms the first time: {}",
            times[0],
            shown.replace('\n', "; ").chars().take(100).collect::<String>()
        );
    }
}

#[test]
#[ignore = "prints times; writes 300 MB"]
fn times_of_queries() {
    let start = || ask("SELECT 1 AS one", &[], BOUNDS).rows();
    start();
    let mut times: Vec<f64> = (0..20).map(|_| seconds(start).0 * 1000.0).collect();
    times.sort_by(f64::total_cmp);
    println!("start, SELECT 1, end: {:.1} ms at best, {:.1} ms median", times[0], times[10]);

    let folder = Folder::new("speed");
    let mut files = Vec::new();
    for file in 0..FILES {
        let path = folder.file(&format!("{file}.parquet"));
        let first = file * ROWS;
        Trials { first, count: ROWS, channels: 0, without_twin: 10 }.write(&path);
        files.push(path);
    }
    measured("3.3 million trials", &files, &|_| Form::Trials, &SCALARS);

    let mut files = Vec::new();
    for file in 0..11 {
        let path = folder.file(&format!("frames-{file}.parquet"));
        Trials { first: file * 3000, count: 3000, channels: 784, without_twin: 10 }.write(&path);
        files.push(path);
    }
    let form = |name: &str| match name {
        "trials" => Form::Trials,
        "frames" => Form::Frames,
        _ => Form::Voltages,
    };
    measured("33,000 frames", &files, &form, &FRAME_QUERIES);
}
