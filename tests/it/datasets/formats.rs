//! The same trials in every format that imports read, through the command, row by row. Without numpy, pandas
//! and scipy the test reports that it was skipped; with `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

use super::filled::Filled;
use crate::support::{self, Folder, PALPATE};

const FILES: [&str; 5] = ["trials.parquet", "trials.csv", "trials.npz", "trials.mat", "packed.mat"];

/// Runs `palpate dataset` in `files`.
async fn dataset(lab: &Filled, files: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(PALPATE);
    command.current_dir(files).arg("dataset").args(arguments).args(["--url", &lab.url("")]);
    support::finished(command).await
}

/// Runs `palpate dataset import` on a file of `files`.
async fn import(lab: &Filled, files: &Path, file: &str, more: &[&str]) -> Output {
    dataset(lab, files, &[&["import", file, "--sensor", "pad.toml"][..], more].concat()).await
}

/// A service, and a folder with the sensor file of a pad 100 mm wide.
async fn with_pad(name: &str, channels: u32, height_mm: u32) -> (Filled, Folder) {
    let (lab, files) = (Filled::open(name).await, Folder::new(name));
    let size = format!("channels = {channels}\nwidth_mm = 100\nheight_mm = {height_mm}\n");
    std::fs::write(files.join("pad.toml"), format!("name = \"pad\"\n{size}")).unwrap();
    (lab, files)
}

/// Writes the files of a script of `python/`; `None` without its modules.
async fn written(script: &str, name: &str) -> Option<Folder> {
    let python = support::python("pandas, numpy, scipy, pyarrow")?;
    let files = Folder::new(name);
    support::printed(python, &format!("datasets/python/{script}"), &[&files]).await;
    Some(files)
}

/// Trials of a run without what differs between two imports of equal trials.
async fn trials(lab: &Filled, run: i64) -> Vec<Value> {
    let mut trials = lab.items(&format!("/api/v1/runs/{run}/trials?voltages=true")).await;
    for trial in &mut trials {
        for key in ["trial_id", "run", "scan_id", "experiment"] {
            trial.as_object_mut().unwrap().remove(key);
        }
    }
    trials
}

#[tokio::test(flavor = "multi_thread")]
async fn every_format_gives_the_same_trials() {
    let Some(files) = written("formats.py", "formats").await else { return };
    let lab = Filled::open("formats").await;
    let mut wanted: Option<Vec<Value>> = None;
    for file in FILES {
        let output = import(&lab, &files, file, &["--name", file, "--json"]).await;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{file}: {errors}");
        let made: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(made["trials"], 5, "{file}");
        assert_eq!(made["columns_left_out"], json!(["weather"]), "{file}");
        let found = trials(&lab, made["run"]["scan_id"].as_i64().unwrap()).await;
        match &wanted {
            Some(wanted) => assert_eq!(&found, wanted, "{file}"),
            None => {
                assert_eq!(found[0]["contacts"][1]["x_mm"], 30.0);
                assert_eq!(found[1]["missing_channels"], 1);
                assert!(found[2]["contacts"].as_array().unwrap().is_empty());
                assert!(found[3]["contacts"][1].get("force_n").is_none());
                for (key, stated, without) in [("split", "test", 4), ("tag", "tip B", 3)] {
                    let key = format!("imported_{key}");
                    assert_eq!(found[2][&key], stated);
                    assert_eq!(found[without].get(&key), None);
                }
                assert_eq!(found[2]["frame_count"], 8);
                wanted = Some(found);
            }
        }
    }
    // A format is recognised by the content: the name does not matter, and HDF5 is named.
    std::fs::write(files.join("new.mat"), b"MATLAB 7.3 MAT-file, and so on").unwrap();
    let output = import(&lab, &files, "new.mat", &[]).await;
    support::not_done(&output, 2, "'-v7'");
    lab.close().await;
}

/// Makes a dataset of all trials of these runs with a split: the status and the answer.
async fn split(lab: &Filled, name: &str, runs: &[&str], split: Value) -> (u16, Value) {
    let definition = json!({ "name": name, "task": "trials", "runs": runs,
        "untouched": "keep", "split": split });
    lab.post("/api/v1/datasets", json!({ "definition": definition })).await
}

/// Part of each row of a dataset, by experiment and configuration.
async fn parts(lab: &Filled, made: &Value) -> Vec<(String, u64, String)> {
    let id = made["id"].as_str().unwrap_or_else(|| panic!("{made}"));
    let path = format!("/api/v1/datasets/{id}/rows?columns=experiment,configuration,split");
    let rows = lab.items(&path).await.into_iter();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    rows.map(|row| {
        (text(&row["experiment"]), row["configuration"].as_u64().unwrap(), text(&row["split"]))
    })
    .collect()
}

/// A CSV file of `trials` trials, each a configuration at another position, with a part if `split` names one.
fn table(trials: u32, split: &str) -> String {
    let mut text = "v0,v1,v2,v3,v4,v5,x_mm,y_mm,force_n,split\n".to_owned();
    for n in 0..trials {
        text += &format!("{n},1,2,3,4,5,{},{},5,{split}\n", n % 100, trials % 90);
    }
    text
}

#[tokio::test(flavor = "multi_thread")]
async fn a_split_of_the_file_and_a_split_by_run_are_obeyed() {
    let (lab, files) = with_pad("imported-splits", 6, 100).await;
    let some = "v0,v1,v2,v3,v4,v5,x_mm,y_mm,split\n0,1,2,3,4,5,1,1,test\n0,1,2,3,4,5,1,1,train\n\
                0,1,2,3,4,5,1,1,\n0,1,2,3,4,5,1,1,validation\n";
    for (name, text) in [("some", some), ("one", &table(40, "")), ("two", &table(30, ""))] {
        std::fs::write(files.join(format!("{name}.csv")), text).unwrap();
        support::succeeded(&import(&lab, &files, &format!("{name}.csv"), &[]).await);
    }
    // Equal positions are in different parts, as the file states.
    let (status, made) = split(&lab, "imported", &["some"], json!({ "by": "imported" })).await;
    let left_out = &made["report"]["left_out"];
    assert_eq!((status, left_out), (200, &json!({ "no imported part": 1 })), "{made}");
    let found: Vec<String> = parts(&lab, &made).await.into_iter().map(|(.., part)| part).collect();
    assert_eq!(found, ["test", "train", "validation"]);
    let (status, refused) = split(&lab, "none", &["one"], json!({ "by": "imported" })).await;
    let detail = refused["detail"].as_str().unwrap();
    assert!(status != 200 && detail.contains("a column split with train"), "{status} {refused}");
    // Leave one batch out: the named run is the test part, and the other is divided.
    let by = |tests: &str| json!({ "by": "run", "ratio": [3, 1, 1], "test_runs": [tests] });
    let (status, made) = split(&lab, "left-out", &["one", "two"], by("two")).await;
    assert_eq!(status, 200, "{made}");
    let found = parts(&lab, &made).await;
    for (run, counts) in [("one", [30, 10, 0]), ("two", [0, 0, 30])] {
        let count = |part: &str| found.iter().filter(|(r, _, p)| r == run && p == part).count();
        assert_eq!(["train", "validation", "test"].map(count), counts, "{run}");
    }
    let unknown = split(&lab, "unknown", &["one"], by("two")).await;
    support::is_refused(unknown, 400, "split.test_runs = two: must be one of");
    let all = split(&lab, "all", &["two"], by("two")).await;
    support::is_refused(all, 400, "must leave at least one");
    // Each of them in turn, by a command.
    let batches = "name = \"without\"\ntask = \"trials\"\nruns = [\"one\", \"two\"]\nuntouched = \"keep\"\n\
                   [split]\nby = \"run\"\nratio = [3, 1, 0]\n";
    std::fs::write(files.join("batches.toml"), batches).unwrap();
    let make = ["make", "batches.toml", "--each-run", "--json"];
    let made = support::done(&dataset(&lab, &files, &make).await);
    for (at, (run, trials)) in [("one", 40), ("two", 30)].into_iter().enumerate() {
        let made = &made["items"][at];
        assert_eq!(made["name"], format!("without-{run}"), "{made}");
        let found = parts(&lab, made).await;
        let tests: Vec<&str> = found
            .iter()
            .filter(|(.., part)| part == "test")
            .map(|(run, ..)| run.as_str())
            .collect();
        assert_eq!(tests, vec![run; trials]);
        assert!(found.iter().any(|(.., part)| part == "train"), "{found:?}");
    }
    // If one cannot be made, those before it are named: `two` is now a run of this name and another one.
    std::fs::write(files.join("three.csv"), table(20, "")).unwrap();
    let more = ["--name", "two", "--json"];
    let third = support::done(&import(&lab, &files, "three.csv", &more).await);
    let scan = third["run"]["scan_id"].to_string();
    let batches = batches.replace("\"one\"", &format!("\"{scan}\""));
    std::fs::write(files.join("all.toml"), batches).unwrap();
    let output = dataset(&lab, &files, &["make", "all.toml", "--each-run"]).await;
    support::not_done(&output, 1, "without-two was not made: ");
    support::not_done(&output, 1, "must leave at least one");
    support::not_done(&output, 1, &format!("made before it: without-{scan} ds-"));
    // Equal tags are in the same part, rows without a tag are excluded, and tags are conditions.
    let mut tagged = "v0,v1,v2,v3,v4,v5,x_mm,y_mm,tag\n".to_owned();
    for n in 0..50 {
        let tag = if n % 10 == 9 { String::new() } else { format!("tip {}", n % 10) };
        tagged += &format!("{n},1,2,3,4,5,{n},{n},{tag}\n");
    }
    std::fs::write(files.join("tagged.csv"), tagged).unwrap();
    support::succeeded(&import(&lab, &files, "tagged.csv", &[]).await);
    let (status, made) = split(&lab, "by-tag", &["tagged"], json!({ "by": "tag" })).await;
    let left_out = &made["report"]["left_out"];
    assert_eq!((status, left_out), (200, &json!({ "no imported tag": 5 })), "{made}");
    let path = "/api/v1/datasets/by-tag/rows?columns=imported_tag,split&limit=100";
    let mut part_of = std::collections::BTreeMap::new();
    for row in lab.items(path).await {
        let part = part_of.entry(row["imported_tag"].to_string()).or_insert(row["split"].clone());
        assert_eq!(*part, row["split"], "{row}");
    }
    let parts: std::collections::BTreeSet<_> = part_of.values().map(Value::to_string).collect();
    assert_eq!((part_of.len(), parts.len()), (9, 3), "{part_of:?}");
    let path = "/api/v1/datasets/by-tag/rows?imported_tag=tip%203&limit=100";
    assert_eq!(lab.get(path).await["items"].as_array().unwrap().len(), 5);
    let (status, refused) = split(&lab, "no-tags", &["one"], json!({ "by": "tag" })).await;
    let detail = refused["detail"].as_str().unwrap();
    assert!(status != 200 && detail.contains("needs a column tag"), "{status} {refused}");
    // A part that is none is refused with its row.
    std::fs::write(files.join("bad.csv"), table(2, "training")).unwrap();
    let output = import(&lab, &files, "bad.csv", &[]).await;
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(errors.contains("split = training: must be train, validation or test"), "{errors}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dry_run_shows_what_was_understood_and_stores_nothing() {
    let (lab, files) = with_pad("dry-run", 3, 100).await;
    let text = "v0,v1,v2,x_mm,y_mm,force_n,weather,split\n0.5,,-1.5,10,20,2.5,rain,train\n1,2,3,,,,sun,test\n";
    std::fs::write(files.join("pad.csv"), text).unwrap();
    let runs = async || lab.get("/api/v1/runs").await["items"].as_array().unwrap().len();
    let before = runs().await;
    let words = support::succeeded(&import(&lab, &files, "pad.csv", &["--dry-run"]).await);
    for wanted in [
        "2 trials",
        "voltages_v, contacts, split",
        "unused columns   weather",
        "3 channels, -1.5 to 3 V, 1 values missing",
        "1 with 0, 1 with 1",
        "x                10 to 10 mm",
        "forces           2.5 to 2.5 N",
        "1 test, 1 train",
        "nothing was stored",
    ] {
        assert!(words.contains(wanted), "{wanted}: {words}");
    }
    assert_eq!(runs().await, before);
    let output = import(&lab, &files, "pad.csv", &[]).await;
    let words = String::from_utf8(output.stdout).unwrap();
    assert!(words.contains("3 channels, -1.5 to 3 V"), "{words}");
    let next = String::from_utf8(output.stderr).unwrap();
    assert!(next.contains("\nnext:\n  palpate dataset show "), "{next}");
    assert_eq!(runs().await, before + 1);
    std::fs::write(files.join("counts.csv"), text.replace("-1.5", "4096")).unwrap();
    let output = import(&lab, &files, "counts.csv", &["--dry-run"]).await;
    support::not_done(&output, 2, "row 0, voltages_v[2] = 4096: must be from -1000 to 1000 V");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn positions_of_a_robot_become_positions_on_the_skin() {
    let (lab, files) = with_pad("coordinates", 3, 80).await;
    // The robot counts in metres from the corner opposite to the skin's.
    let text = "v0,v1,v2,x_mm,y_mm,force_n\n1,2,3,-0.1,-0.08,2\n1,2,3,0,-0.03,2\n";
    std::fs::write(files.join("robot.csv"), text).unwrap();
    let output = import(&lab, &files, "robot.csv", &[]).await;
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(errors.contains("x_mm = -0.1: must be from 0 to 100"), "{errors}");
    let text = "v0,v1,v2,x_mm,y_mm,force_n\n1,2,3,0.05,0.03,2\n1,2,3,0.01,0.07,2\n";
    std::fs::write(files.join("metres.csv"), text).unwrap();
    let shown = support::succeeded(&import(&lab, &files, "metres.csv", &["--dry-run"]).await);
    assert!(shown.contains("are metres, name a map with scale = 1000"), "{shown}");
    std::fs::write(files.join("map.toml"), "scale = 1000\noffset_mm = [100, 80]\n").unwrap();
    let output = import(&lab, &files, "robot.csv", &["--coordinates", "map.toml", "--json"]).await;
    let made: Value = serde_json::from_str(&support::succeeded(&output)).unwrap();
    let found = trials(&lab, made["run"]["scan_id"].as_i64().unwrap()).await;
    let place =
        |n: usize| ["x_mm", "y_mm"].map(|key| found[n]["contacts"][0][key].as_f64().unwrap());
    assert_eq!((place(0), place(1)), ([0.0, 0.0], [100.0, 50.0]));
    let definition = made["run"]["definition"].as_str();
    assert!(definition.is_none_or(|text| text.contains("coordinates")), "{made}");
    std::fs::write(files.join("map.toml"), "rotate_deg = 400\n").unwrap();
    let output = import(&lab, &files, "robot.csv", &["--coordinates", "map.toml"]).await;
    support::not_done(&output, 2, "rotate_deg: must be from -360 to 360");
    lab.close().await;
}
