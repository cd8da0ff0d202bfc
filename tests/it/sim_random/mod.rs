//! Sim-Random as a person makes it: real processes, killed and resumed, and read by the tools that a
//! notebook uses. Without Python, pandas and pyarrow that test reports that it was skipped;
//! with `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use palpate::digest::sha256_hex;
use palpate::simulate::model::load_or_build;
use rand::{RngExt, SeedableRng};
use rustix::process::Signal;
use serde_json::Value;
use sim_core::forward::{Contact, ForwardModel, Workspace};

use crate::support::{self, PALPATE, Process, files, not_done, sensor, skin_cache, with_responses};

mod cluster;

/// Folder that these tests share.
fn data() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("sim-random")
}

/// The model, with the cache of the folder filled, so that no process solves for itself.
fn model() -> &'static ForwardModel {
    static MODEL: OnceLock<ForwardModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        with_responses(&data());
        load_or_build(sensor(), &skin_cache()).unwrap()
    })
}

/// An empty folder for one test.
fn folder(name: &str) -> PathBuf {
    model();
    let folder = data().join(name);
    std::fs::remove_dir_all(&folder).ok();
    folder
}

/// The command that makes 4,500 trials in shards of 1,500, with more or other options.
fn command(out: &Path, options: &[&str]) -> Command {
    let mut command = Command::new(PALPATE);
    command.args(["simulate", "random", "--json", "--out"]).arg(out).arg("--data").arg(data());
    let given = |name: &str| options.contains(&name);
    for (name, value) in
        [("--trials", "4500"), ("--seed", "1"), ("--shard-trials", "1500"), ("--threads", "2")]
    {
        if !given(name) {
            command.args([name, value]);
        }
    }
    command.args(options).stdin(Stdio::null());
    command
}

fn run(out: &Path, options: &[&str]) -> Output {
    command(out, options).output().unwrap()
}

fn made(out: &Path, options: &[&str]) -> Value {
    support::done(&run(out, options))
}

fn last_line(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

fn manifest(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("_manifest.json")).unwrap()).unwrap()
}

/// Every row of the manifest stands for a file with those bytes.
fn assert_manifest_is_true(folder: &Path) -> usize {
    let manifest = manifest(folder);
    let rows = manifest["shards"].as_array().unwrap();
    for row in rows {
        let bytes = std::fs::read(folder.join(row["file"].as_str().unwrap())).unwrap();
        assert_eq!(row["bytes"], bytes.len());
        assert_eq!(row["sha256"], sha256_hex(&bytes));
    }
    rows.len()
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let (one, four) = (folder("threads-1"), folder("threads-4"));
    let last = made(&one, &["--threads", "1"]);
    assert_eq!((&last["exit_status"], &last["trials_stored"]), (&"success".into(), &4500.into()));
    made(&four, &["--threads", "4"]);
    assert_eq!(files(&one), files(&four));
    assert_eq!(assert_manifest_is_true(&one), 3);
    let other_seed = folder("threads-seed");
    made(&other_seed, &["--seed", "2"]);
    let shard = "shard-00000.parquet";
    assert_ne!(files(&one)[shard], files(&other_seed)[shard]);
}

#[test]
fn killed_at_random_instants_it_goes_on_to_the_same_bytes() {
    let (whole, killed) = (folder("kill-whole"), folder("kill-killed"));
    let small = ["--trials", "12000", "--shard-trials", "300"];
    made(&whole, &small);
    let mut chance = rand_chacha::ChaCha8Rng::seed_from_u64(11);
    let mut done = Vec::new();
    for kill in 0..12 {
        let child = command(&killed, &small).stdout(Stdio::piped()).spawn().unwrap();
        let mut process = Process(child);
        if kill % 3 > 0 {
            // Into the making of shards; otherwise anywhere from the start on.
            let mut line = String::new();
            BufReader::new(process.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
        }
        std::thread::sleep(Duration::from_micros(chance.random_range(0..120_000)));
        drop(process);
        if killed.join("_manifest.json").exists() {
            done.push(assert_manifest_is_true(&killed));
        }
    }
    println!("killed 12 times; shards done of 40 at each: {done:?}");
    assert!(done.windows(2).all(|d| d[0] <= d[1]), "a shard was lost");
    assert!(done.iter().any(|&shards| (1..40).contains(&shards)), "never killed half way");
    made(&killed, &small);
    assert_eq!(files(&whole), files(&killed));
}

#[test]
fn ctrl_c_ends_after_the_shard_and_the_same_command_goes_on() {
    let out = folder("interrupt");
    let small = ["--trials", "20000", "--shard-trials", "250"];
    let mut process =
        command(&out, &small).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while !out.join("shard-00001.parquet").exists() {
        assert!(process.try_wait().unwrap().is_none(), "it has ended before it was interrupted");
        std::thread::sleep(Duration::from_millis(10));
    }
    support::signal(&process, Signal::INT);
    let output = process.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let last = last_line(&output);
    assert_eq!(last["exit_status"], "abort");
    let stored = last["trials_stored"].as_u64().unwrap();
    assert!((500..20_000).contains(&stored), "{stored}");
    assert_eq!(assert_manifest_is_true(&out) as u64 * 250, stored);
    assert!(files(&out).keys().all(|name| !name.starts_with("_partial-")));
}

#[test]
fn a_folder_of_another_definition_is_refused_by_the_field_that_differs() {
    let out = folder("other");
    let few = ["--trials", "30"];
    made(&out, &few);
    let before = files(&out);
    for (option, value, field) in [
        ("--seed", "2", "draws.seed = 1, requested 2"),
        ("--contacts", "1..5", "draws.contacts = [1,6], requested [1,5]"),
        ("--shard-trials", "10", "shard_trials = 1500, requested 10"),
    ] {
        not_done(&run(&out, &[&few[..], &[option, value]].concat()), 2, field);
    }
    assert_eq!(files(&out), before);
}

#[test]
fn bad_options_are_named_with_their_limit() {
    let out = folder("options");
    for (options, words) in [
        (&["--contacts", "1..7"][..], "contacts = 1..7: must be A..B with 0 <= A <= B <= 6"),
        (&["--force-n", "5", "50"], "at most 240 N in sum"),
        (&["--trials", "0"], "trials = 0: must be from 1"),
        (&["--threads", "0"], "threads = 0: must be from 1 to 256"),
    ] {
        not_done(&run(&out, options), 2, words);
    }
    assert!(!out.exists());
}

#[test]
fn damaged_shards_are_found_and_made_again() {
    let out = folder("damage");
    made(&out, &[]);
    let whole = files(&out);
    let shard = out.join("shard-00001.parquet");
    let bytes = std::fs::read(&shard).unwrap();

    std::fs::write(&shard, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(out.join("_shard-00002.parquet.partial"), "half").unwrap();
    assert_eq!(made(&out, &[])["trials_made"], 1500);
    assert_eq!(files(&out), whole);

    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    std::fs::write(&shard, &flipped).unwrap();
    assert_eq!(made(&out, &[])["trials_made"], 0);
    assert_eq!(made(&out, &["--verify"])["trials_made"], 1500);
    assert_eq!(files(&out), whole);
}

#[test]
fn a_notebook_reads_what_was_simulated() {
    let Some(python) = support::python("pandas, pyarrow") else { return };
    let out = folder("notebook");
    made(&out, &[]);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/sim_random/read.py");
    let read = Command::new(python)
        .arg(script)
        .arg(&out)
        .args(["0", "1500", "2718", "4499"])
        .output()
        .unwrap();
    let read: Value = serde_json::from_str(&support::succeeded(&read)).unwrap();
    assert_eq!((&read["rows"], &read["distinct"]), (&4500.into(), &4500.into()));
    assert_eq!((&read["nulls"], &read["index"]), (&0.into(), &serde_json::json!([0, 4499])));
    assert_eq!(read["counts_agree"], true);
    assert_eq!(read["forces_agree"], true);
    let columns = serde_json::json!({
        "seed": ["uint64", false, ""],
        "index": ["uint64", false, ""],
        "experiment": ["string", false, ""],
        "contact_count": ["uint8", false, ""],
        "max_force_n": ["float", true, "N"],
        "sim_voltages_v": ["fixed_size_list<element: float not null>[784]", false, "V"],
    });
    for (name, column) in columns.as_object().unwrap() {
        assert_eq!(&read["columns"][name], column, "{name}");
    }
    assert_eq!(read["voltage"], serde_json::json!(["float", false, "V"]));
    assert_eq!(read["contact"]["x_mm"], serde_json::json!(["double", false, "mm"]));
    assert_eq!(read["contact"]["force_n"], serde_json::json!(["float", false, "N"]));
    assert_eq!(read["definition"], manifest(&out)["definition"]);
    let trials = read["trials"].as_array().unwrap();
    assert_eq!(trials.len(), 4);
    trials.iter().for_each(assert_frame_is_the_models);
}

/// The frame in the file is the exact model's for the contacts in the file.
fn assert_frame_is_the_models(trial: &Value) {
    let number = |value: &Value| value.as_f64().unwrap();
    let contacts: Vec<Contact> = trial["contacts"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| Contact {
            x_mm: number(&c["x_mm"]),
            y_mm: number(&c["y_mm"]),
            force_n: number(&c["force_n"]),
        })
        .collect();
    let mut work = Workspace::default();
    let exact_v = model().voltages(&contacts, &mut work).unwrap();
    let stored_v = trial["voltages_v"].as_array().unwrap();
    assert_eq!(stored_v.len(), exact_v.len());
    let largest_v = exact_v.iter().fold(0f64, |most, v| most.max(v.abs()));
    assert!(largest_v > 0.01, "{largest_v} V is an empty frame");
    let exact_v = exact_v.to_vec();
    let electrodes_v = work.readout().electrodes_v();
    let scale_v = electrodes_v.iter().fold(0f64, |most, v| most.max(v.abs()));
    for (stored_v, exact_v) in stored_v.iter().zip(exact_v) {
        let off = (number(stored_v) - exact_v).abs() / scale_v;
        assert!(off < 2e-6, "{stored_v} V, exactly {exact_v} V");
    }
}

#[test]
fn a_net_learns_from_simulations_alone() {
    let data = folder("alone");
    made(&data.join("sim-random/free"), &[]);
    let mut train = Command::new(PALPATE);
    train.args(["train", "recon-net", "--map", "20x60", "--epochs", "1", "--data"]).arg(&data);
    support::succeeded(&train.stdin(Stdio::null()).output().unwrap());
}
