//! The same trials in every format that imports read, through the command, row by row. Without numpy, pandas
//! and scipy the test says that it was left out; with `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

use super::filled::{Filled, folder};
use crate::support::{self, PALPATE};

const FILES: [&str; 5] = ["trials.parquet", "trials.csv", "trials.npz", "trials.mat", "packed.mat"];

/// Runs `palpate dataset import` on a file of `files`.
async fn import(lab: &Filled, files: &PathBuf, file: &str, more: &[&str]) -> Output {
    let mut command = Command::new(PALPATE);
    command.current_dir(files).args(["dataset", "import", file, "--sensor", "pad.toml"]);
    command.args(more).args(["--url", &lab.url("")]);
    tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

/// Writes the files of a script of `python/`; `None` without its modules.
async fn written(script: &str, name: &str) -> Option<PathBuf> {
    let python = support::python("pandas, numpy, scipy, pyarrow")?;
    let files = folder(name);
    let mut command = Command::new(python);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command.arg(format!("{}/tests/it/datasets/python/{script}", env!("CARGO_MANIFEST_DIR")));
    command.arg(&files);
    let output = tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(files)
}

/// Trials of a run without what differs between two imports of equal trials.
async fn trials(lab: &Filled, run: i64) -> Vec<Value> {
    let page = lab.get(&format!("/api/v1/runs/{run}/trials?voltages=true")).await;
    let mut trials = page["items"].as_array().unwrap().clone();
    for trial in &mut trials {
        for key in ["trial_id", "run", "scan_id", "experiment"] {
            trial.as_object_mut().unwrap().remove(key);
        }
    }
    trials
}

#[tokio::test(flavor = "multi_thread")]
async fn every_format_gives_the_same_trials() {
    let Some(files) = written("formats.py", "formats-files").await else { return };
    let lab = Filled::open("formats").await;
    let mut wanted: Option<Vec<Value>> = None;
    for file in FILES {
        let output = import(&lab, &files, file, &["--name", file, "--json"]).await;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{file}: {errors}");
        let made: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(
            (&made["trials"], &made["columns_left_out"]),
            (&5.into(), &serde_json::json!(["weather"])),
            "{file}"
        );
        let found = trials(&lab, made["run"]["scan_id"].as_i64().unwrap()).await;
        match &wanted {
            Some(wanted) => assert_eq!(&found, wanted, "{file}"),
            None => {
                assert_eq!(found[0]["contacts"][1]["x_mm"], 30.0);
                assert_eq!(found[1]["missing_channels"], 1);
                assert!(found[2]["contacts"].as_array().unwrap().is_empty());
                assert!(found[3]["contacts"][1].get("force_n").is_none());
                wanted = Some(found);
            }
        }
    }
    // A format is recognised by the content: the name does not matter, and HDF5 is named.
    std::fs::write(files.join("new.mat"), b"MATLAB 7.3 MAT-file, and so on").unwrap();
    let output = import(&lab, &files, "new.mat", &[]).await;
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && errors.contains("'-v7'"), "{errors}");
    lab.close().await;
    std::fs::remove_dir_all(files).unwrap();
}
