//! Skins that are not Palpate's, from a Parquet file to scores: positions on a pad of 192 channels, patterns
//! on a sheet of 3,000. Ridge and kernel ridge regression agree with scikit-learn's.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{Folder, PALPATE, python};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/evaluate/python/skins.py");
/// Number of trials of each skin.
const ROWS: &str = "500";

/// Runs a command in a folder; its standard output.
fn run(program: &str, folder: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new(program);
    command.args(arguments).current_dir(folder).env("PALPATE_DATA", folder.join("data"));
    let out = command.output().unwrap();
    let words = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{arguments:?}: {words}{}", String::from_utf8_lossy(&out.stdout));
    String::from_utf8(out.stdout).unwrap()
}

/// Scores of a quantity by the name of the net: (error or share that is not right, of the best constant).
fn scores(folder: &Path, skin: &str, quantity: &str) -> impl Fn(&str) -> f64 {
    let epochs = ["--epochs", "120"];
    let arguments = ["evaluate", "quantity", quantity, "--dataset", skin, "--json"];
    let text = run(PALPATE, folder, &[&arguments[..], &epochs].concat());
    let sheet: Value = serde_json::from_str(&text).unwrap();
    move |name| {
        let nets = sheet["nets"].as_array().unwrap();
        let scores = &nets.iter().find(|net| net["name"] == name).unwrap()["scores"];
        assert_eq!(scores["rows"], 100, "{scores}");
        let wrong = scores["right"]["mean"].as_f64().map(|right| 1.0 - right);
        wrong.or(scores["error"]["mean"].as_f64()).unwrap()
    }
}

#[test]
fn nets_and_regressions_are_compared_on_skins_of_other_channels() {
    let Some(python) = python("sklearn, pyarrow, numpy") else { return };
    let folder = Folder::new("skins");
    run(&python, &folder, &[SCRIPT, "make", ".", ROWS]);
    for (skin, quantity) in [("pad", "position"), ("sheet", "pattern")] {
        let [file, sensor, split] =
            [".parquet", ".toml", "-split.toml"].map(|end| format!("{skin}{end}"));
        let name = format!("{skin}-trials");
        let import = ["dataset", "import", &file, "--sensor", &sensor, "--label", "virtual"];
        run(PALPATE, &folder, &[&import[..], &["--name", &name]].concat());
        let made = run(PALPATE, &folder, &["dataset", "make", &split, "--json"]);
        let made: Value = serde_json::from_str(made.lines().last().unwrap()).unwrap();
        let id = made["id"].as_str().unwrap();
        let ours = scores(&folder, skin, quantity);
        let data = folder.join("data/datasets").join(format!("{id}.parquet"));
        let theirs = run(&python, &folder, &[SCRIPT, "compare", &data.display().to_string(), skin]);
        let theirs: Value = serde_json::from_str(&theirs).unwrap();
        for (name, within) in [("ridge", 0.05), ("kernel ridge", 0.15)] {
            let (ours, theirs) = (ours(name), theirs[name].as_f64().unwrap());
            // Some rows of a hundred may fall on either side.
            let most = (1.0 + within) * theirs + if skin == "sheet" { 0.03 } else { 0.0 };
            assert!(ours <= most, "{skin}: {name} {ours}, scikit-learn {theirs}");
        }
        // The net is one of 120 epochs, and some rows of a hundred may fall on either side: that it learns is
        // what is checked.
        assert!(ours("mlp") < ours("ridge") * 1.5 + 0.1, "{skin}: mlp {}", ours("mlp"));
    }
    // A model answers frames of the sensor that it was trained for, with and without a name.
    let frame: Vec<String> = (0..192).map(|c| format!("{:.3}", 0.01 * f64::from(c))).collect();
    std::fs::write(folder.join("frame.jsonl"), format!("[{}]\n", frame.join(", "))).unwrap();
    run(
        PALPATE,
        &folder,
        &["train", "ridge", "--dataset", "pad", "--answers", "position", "--name", "mine"],
    );
    let answer = run(PALPATE, &folder, &["infer", "frame.jsonl", "--model", "mine", "--json"]);
    let answer: Value = serde_json::from_str(&answer).unwrap();
    assert_eq!(answer["position_mm"].as_array().unwrap().len(), 2, "{answer}");
    run(PALPATE, &folder, &["model", "promote", "mine"]);
    let promoted = ["infer", "frame.jsonl", "--model", "position@pad", "--json"];
    let promoted: Value = serde_json::from_str(&run(PALPATE, &folder, &promoted)).unwrap();
    assert_eq!(promoted, answer);
}
