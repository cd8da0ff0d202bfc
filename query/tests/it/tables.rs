//! The rows of each form of table.
//! Uses: `common`. Never: what a statement may contain.

use std::collections::BTreeMap;

use palpate_words::query_lines::{Form, Table};
use polars::prelude::*;

use crate::common::{BOUNDS, Folder, Trials, ask, table, tables, text, write};

/// Trials 0 to 39; every tenth lacks a twin.
const FEW: Trials = Trials { first: 0, count: 40, channels: 16, without_twin: 10 };

/// The rows that a statement returns, as text.
fn answer(sql: &str, known: &[Table]) -> String {
    text(&ask(sql, known, BOUNDS).rows())
}

#[test]
fn each_form_has_its_rows_and_columns() {
    let folder = Folder::new("forms");
    let path = folder.file("a.parquet");
    FEW.write(&path);
    let known = tables(std::slice::from_ref(&path), "run-3");
    let columns = |sql: &str| {
        let rows = ask(sql, &known, BOUNDS).rows();
        rows.get_column_names().iter().map(|name| name.as_str()).collect::<Vec<_>>().join(" ")
    };
    let count = |name: &str| answer(&format!("SELECT count(*) FROM {name}"), &known);
    let of_trials =
        "label tips contact_count max_force_n sim_model rmse_v fvu measured_at contacts";
    for (table, wanted) in [
        ("trials", of_trials),
        ("contacts", "x_mm y_mm force_n diameter_mm"),
        ("frames", "voltages_v sim_voltages_v"),
        ("twins", "sim_model rmse_v fvu sim_voltages_v"),
        ("voltages", "position injection pair voltage_v sim_voltage_v"),
    ] {
        let found = columns(&format!("SELECT * FROM {table} LIMIT 0"));
        assert_eq!(found, format!("trial_id scan_id {wanted}"), "{table}");
    }
    assert_eq!(count("trials"), "40");
    // Trial n has n mod 4 contacts.
    assert_eq!(count("contacts"), "60");
    assert_eq!(count("frames"), "40");
    assert_eq!(count("twins"), "36");
    assert_eq!(count("voltages"), "640");
    assert_eq!(count("\"run-3\""), "40");
    let rows = FEW.rows();
    let force = rows.column("contacts").unwrap().list().unwrap().get_as_series(7).unwrap();
    let force = force.struct_().unwrap().field_by_name("force_n").unwrap();
    let asked = "SELECT trial_id, scan_id, force_n FROM contacts WHERE trial_id = 7";
    let asked = ask(asked, &known, BOUNDS).rows();
    assert!(asked.column("force_n").unwrap().as_materialized_series().equals(&force));
    assert_eq!(asked.height(), 3);
}

#[test]
fn a_voltage_has_its_position_injection_and_pair_and_its_twin_if_there_is_one() {
    let folder = Folder::new("voltages");
    let path = folder.file("a.parquet");
    FEW.write(&path);
    let known = tables(&[path], "run-3");
    let rows = ask("SELECT * FROM voltages ORDER BY trial_id, position", &known, BOUNDS).rows();
    let u32s = |name: &str| rows.column(name).unwrap().u32().unwrap().clone();
    let (injection, pair) = (u32s("injection"), u32s("pair"));
    let f32s = |name: &str| rows.column(name).unwrap().f32().unwrap().clone();
    let (measured, simulated) = (f32s("voltage_v"), f32s("sim_voltage_v"));
    for row in 0..640 {
        let (trial, position) = (row as u64 / 16, row % 16);
        assert_eq!(injection.get(row), Some(position as u32 / 4));
        assert_eq!(pair.get(row), Some(position as u32 % 4));
        assert_eq!(measured.get(row), Some(Trials::voltage(trial, position)));
        let twin = (trial % 10 != 0).then(|| Trials::simulated(trial, position));
        assert_eq!(simulated.get(row), twin);
    }
    let nulls = "SELECT count(*) FROM voltages WHERE sim_voltage_v IS NULL";
    assert_eq!(answer(nulls, &known), "64");
}

#[test]
fn skins_of_different_numbers_of_channels_are_in_one_table() {
    let folder = Folder::new("channels");
    let sizes = [("a", 16, 0), ("b", 9, 100), ("c", 16, 200), ("d", 10, 300)];
    let files = sizes.map(|(name, channels, first)| {
        let path = folder.file(name);
        Trials { first, count: 8, channels, without_twin: 10 }.write(&path);
        path
    });
    let known = tables(&files, "run-3");
    let lengths = "SELECT array_length(voltages_v) AS n, count(*) AS frames FROM frames GROUP BY n ORDER BY n";
    assert_eq!(answer(lengths, &known), "9 | 8\n10 | 8\n16 | 16");
    // Ten channels are no square: they have a position only.
    let pairs = "SELECT trial_id, max(position) AS p, max(injection) AS i, max(pair) AS e \
                 FROM voltages WHERE trial_id IN (1, 101, 301) GROUP BY trial_id ORDER BY trial_id";
    assert_eq!(answer(pairs, &known), "1 | 15 | 3 | 3\n101 | 8 | 2 | 2\n301 | 9 | null | null");
    assert_eq!(answer("SELECT count(*) FROM voltages", &known), "408");
    assert_eq!(answer("SELECT count(*), sum(tips) FROM trials", &known), "32 | 48");
    let first = "SELECT trial_id FROM trials LIMIT 1";
    assert_eq!(answer(first, &known), "0");
}

#[test]
fn a_column_that_a_file_lacks_is_null_there() {
    let folder = Folder::new("lacks");
    let [whole, part] = ["whole", "part"].map(|name| folder.file(name));
    FEW.write(&whole);
    let mut lacking = Trials { first: 100, ..FEW }.rows();
    lacking = lacking.drop_many(["rmse_v", "label", "sim_voltages_v", "contacts"]);
    write(&mut lacking, &part);
    let known = tables(&[whole.clone(), part.clone()], "run-3");
    let asked = "SELECT count(*) AS n, count(rmse_v) AS r, count(label) AS l FROM trials";
    assert_eq!(answer(asked, &known), "80 | 36 | 40");
    let asked = "SELECT count(*) AS n, count(sim_voltages_v) AS s FROM frames";
    assert_eq!(answer(asked, &known), "80 | 36");
    let asked = "SELECT count(*) AS n, count(sim_voltage_v) AS s FROM voltages";
    assert_eq!(answer(asked, &known), "1280 | 576");
    assert_eq!(answer("SELECT count(*) FROM contacts", &known), "60");
    let asked = "SELECT trial_id FROM trials WHERE label IS NULL ORDER BY trial_id LIMIT 1";
    assert_eq!(answer(asked, &known), "100");

    // A file of another type in a column of the same name becomes the wider one.
    let other = folder.file("other");
    let mut rows = Trials { first: 200, channels: 0, ..FEW }.rows();
    let wider = rows.column("tips").unwrap().cast(&DataType::UInt32).unwrap();
    rows.with_column(wider).unwrap();
    write(&mut rows, &other);
    let known = [table("trials", Form::Trials, &[whole, other])];
    assert_eq!(answer("SELECT count(*), sum(tips) FROM trials", &known), "80 | 120");
    // A table without rows has its columns.
    let none = folder.file("none");
    write(&mut FEW.rows().head(Some(0)), &none);
    let known = tables(&[none], "run-3");
    for name in ["trials", "contacts", "frames", "twins", "voltages"] {
        let rows = ask(&format!("SELECT * FROM {name}"), &known, BOUNDS).rows();
        assert_eq!(rows.height(), 0);
        assert!(rows.width() > 3, "{name}");
    }
}

#[test]
fn the_fvu_by_pair_of_electrodes_is_the_one_computed_without_sql() {
    let folder = Folder::new("fvu");
    let path = folder.file("a.parquet");
    let trials = Trials { first: 0, count: 200, channels: 784, without_twin: 10 };
    trials.write(&path);
    let known = tables(&[path], "run-3");
    let by_sums = "SELECT pair, \
               sum((v - s) * (v - s)) / (sum(v * v) - sum(v) * sum(v) / count(*)) AS fvu \
               FROM (SELECT pair, CAST(voltage_v AS DOUBLE) AS v, CAST(sim_voltage_v AS DOUBLE) AS s \
               FROM voltages WHERE sim_voltage_v IS NOT NULL) AS both GROUP BY pair ORDER BY pair";
    is_fvu_by_pair(by_sums, &known, |_| true);
    // As the service writes it, for trials that meet a condition. Trial n has n mod 4 tips.
    let selected = "SELECT pair AS pair, AVG(POWER(CAST(voltage_v AS DOUBLE) - sim_voltage_v, 2)) / \
               (AVG(POWER(CAST(voltage_v AS DOUBLE), 2)) - POWER(AVG(CAST(voltage_v AS DOUBLE)), 2)) AS fvu, \
               COUNT(*) AS count FROM voltages SEMI JOIN (SELECT trial_id FROM trials WHERE tips = 3) AS selected \
               USING (trial_id) WHERE sim_voltage_v IS NOT NULL AND scan_id = 1 AND trial_id < 150 GROUP BY pair \
               ORDER BY pair NULLS LAST LIMIT 1001";
    is_fvu_by_pair(selected, &known, |trial| trial % 4 == 3 && trial < 150);
}

/// Checks the FVU of 28 pairs in an answer against those of the selected trials from 0 to 199.
fn is_fvu_by_pair(sql: &str, known: &[Table], is_selected: impl Fn(u64) -> bool) {
    let rows = ask(sql, known, BOUNDS).rows();
    let asked = rows.column("fvu").unwrap().f64().unwrap();
    assert_eq!(rows.height(), 28, "{sql}");
    let mut of_pair: BTreeMap<usize, Vec<(f64, f64)>> = BTreeMap::new();
    for trial in (0..200_u64).filter(|trial| trial % 10 != 0 && is_selected(*trial)) {
        for position in 0..784 {
            let both = (Trials::voltage(trial, position), Trials::simulated(trial, position));
            of_pair.entry(position % 28).or_default().push((both.0.into(), both.1.into()));
        }
    }
    for (pair, values) in of_pair {
        let mean = values.iter().map(|(v, _)| v).sum::<f64>() / values.len() as f64;
        let unexplained: f64 = values.iter().map(|(v, s)| (v - s).powi(2)).sum();
        let variance: f64 = values.iter().map(|(v, _)| (v - mean).powi(2)).sum();
        let fvu = unexplained / variance;
        let found = asked.get(pair).unwrap();
        assert!((found - fvu).abs() < 1e-9 * fvu, "{sql}: pair {pair}: {found}, {fvu}");
    }
}
