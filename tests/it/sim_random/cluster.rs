//! Sim-Random in chunks, as real processes make them: next to each other, killed, stopped, damaged; gathered to the
//! bytes of one process.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rustix::process::Signal;
use serde_json::{Value, json};

use super::{data, files, folder, made as simulated};
use crate::support::{PALPATE, Process, done, not_done, signal, succeeded, with_extension};

/// Options of 6,000 trials in 20 chunks.
static TRIALS: [&str; 4] = ["--trials", "6000", "--shard-trials", "300"];
/// Options of 24,000 trials in 80 chunks.
static MANY_TRIALS: [&str; 4] = ["--trials", "24000", "--shard-trials", "300"];

/// An order of trials in an empty folder.
fn ordered(name: &str, options: &[&str]) -> PathBuf {
    let folder = folder(name);
    succeeded(&ordering(&folder, options));
    folder
}

fn ordering(folder: &Path, options: &[&str]) -> Output {
    let mut command = Command::new(PALPATE);
    command.args(["cluster", "sbatch", "random", "--json"]).args(options);
    command.arg("--folder").arg(folder).arg("--data").arg(data()).output().unwrap()
}

fn making(folder: &Path, options: &[&str]) -> Command {
    let mut command = Command::new(PALPATE);
    command.args(["cluster", "make", "--json", "--threads", "1"]).arg(folder).args(options);
    command.arg("--data").arg(data()).stdin(Stdio::null());
    command
}

/// Makes chunks; returns the last line, which has the totals.
fn make(folder: &Path, options: &[&str]) -> Value {
    done(&making(folder, options).output().unwrap())
}

fn status(folder: &Path) -> Value {
    let output = Command::new(PALPATE).args(["cluster", "status", "--json"]).arg(folder).output();
    super::last_line(&output.unwrap())
}

fn gather(folder: &Path, out: &Path) -> Output {
    let mut command = Command::new(PALPATE);
    command.args(["cluster", "gather"]).arg(folder).arg("--out").arg(out).output().unwrap()
}

/// The error of a gathering that must fail; exit code 1.
fn not_gathered(folder: &Path, out: &Path) -> String {
    let output = gather(folder, out);
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8(output.stderr).unwrap()
}

/// Row of a chunk and path of its bytes.
fn result(folder: &Path, index: u64) -> (PathBuf, PathBuf) {
    let is_its = |path: &PathBuf| {
        let row: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        row["index"] == index
    };
    let row = with_extension(&folder.join("results"), "json").into_iter().find(is_its).unwrap();
    (row.with_extension("parquet"), row)
}

#[test]
fn chunks_of_killed_and_concurrent_processes_are_those_of_one_process() {
    let (whole, out) = (folder("chunks-whole"), folder("chunks-out"));
    let order = ordered("chunks", &MANY_TRIALS);
    simulated(&whole, &MANY_TRIALS);
    let mut chance = rand_chacha::ChaCha8Rng::seed_from_u64(19);
    let mut done = Vec::new();
    for kill in 0..8 {
        // Two tasks of an array, and a third process that makes the chunks of both.
        let tasks = [["0", "2"], ["1", "2"], ["0", "1"]];
        let mut processes = tasks.map(|[task, tasks]| {
            let mut command = making(&order, &["--task", task, "--tasks", tasks]);
            Process(command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap())
        });
        if kill % 2 > 0 {
            // Into the making of chunks; otherwise anywhere from the start on.
            let output = processes[kill % 3].0.stdout.take().unwrap();
            let mut lines = BufReader::new(output).lines().map(Result::unwrap);
            lines.find(|line| line.contains("\"made\":true"));
        }
        std::thread::sleep(Duration::from_micros(chance.random_range(0..60_000)));
        drop(processes);
        done.push(status(&order)["done"].as_u64().unwrap());
    }
    println!("killed 8 times 3 processes; chunks done of 80 at each: {done:?}");
    assert!(done.windows(2).all(|d| d[0] <= d[1]), "a chunk was lost");
    assert!((1..80).contains(&done[7]), "never killed half way");
    let refused = not_gathered(&order, &out);
    assert!(refused.contains(&format!("{} chunk", 80 - done[7])), "{refused}");
    assert!(!out.exists());
    let last = make(&order, &["--task", "0", "--tasks", "1"]);
    assert_eq!((&last["exit_status"], &last["done"]), (&"success".into(), &80.into()));
    let names = fs::read_dir(order.join("results")).unwrap();
    let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let partial: Vec<String> = names.filter(|name| name.starts_with('_')).collect();
    assert!(partial.is_empty(), "{partial:?}");
    assert!(gather(&order, &out).status.success());
    assert_eq!(files(&whole), files(&out));
    // Again, without copying; and the folder is one that `simulate random` continues.
    assert!(gather(&order, &out).status.success());
    assert_eq!(simulated(&out, &MANY_TRIALS)["trials_made"], 0);
    assert_eq!(files(&whole), files(&out));
}

#[test]
fn a_damaged_chunk_is_found_and_made_again() {
    let (order, out) = (ordered("chunks-damage", &TRIALS), folder("chunks-damage-out"));
    make(&order, &["--task", "0", "--tasks", "1"]);
    let (bytes, row) = result(&order, 3);
    let whole = fs::read(&bytes).unwrap();

    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    fs::write(&bytes, &flipped).unwrap();
    let words = not_gathered(&order, &out);
    assert!(words.contains("chunk 3 is damaged"), "{words}");
    assert!(words.contains("cluster make") && !out.join("shard-00003.parquet").exists());

    fs::write(&bytes, &whole[..1000]).unwrap();
    assert_eq!(status(&order)["damaged"], json!([3]));
    assert_eq!(status(&order)["array"], "3");
    let last = make(&order, &["2", "3"]);
    assert_eq!((&last["done"], &last["made"]), (&2.into(), &1.into()));
    assert_eq!(fs::read(&bytes).unwrap(), whole);

    // The row of another order's chunk, and a result of an order with another seed.
    let other = folder("chunks-damage-other");
    let seed = [&TRIALS[..], &["--seed", "2"]].concat();
    assert!(ordering(&other, &seed).status.success());
    make(&other, &["3"]);
    let (foreign, foreign_row) = result(&other, 3);
    let good_row = fs::read(&row).unwrap();
    fs::copy(&foreign_row, &row).unwrap();
    let words = not_gathered(&order, &out);
    assert!(words.contains("chunk 3 is damaged") && words.contains("with the key"), "{words}");
    fs::write(&row, good_row).unwrap();
    let stray = order.join("results").join(foreign.file_name().unwrap());
    fs::copy(&foreign, &stray).unwrap();
    let words = not_gathered(&order, &out);
    let name = foreign.file_name().unwrap().to_str().unwrap();
    assert!(words.contains(&format!("results/{name} belongs to no chunk")), "{words}");
    fs::remove_file(stray).unwrap();
    assert!(gather(&order, &out).status.success());
}

#[test]
fn lines_are_answered_by_chunks() {
    let order = ordered("chunks-lines", &TRIALS);
    make(&order, &["1"]);
    let mut command = Command::new(PALPATE);
    command.args(["cluster", "make", "--lines", "--threads", "1", "--data"]).arg(data());
    let child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut process = Process(child);
    let mut input = process.0.stdin.take().unwrap();
    let mut answers = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let mut ask = |line: Value| -> Value {
        writeln!(input, "{line}").unwrap();
        serde_json::from_str(&answers.next().unwrap().unwrap()).unwrap()
    };
    for index in [0, 1, 0] {
        let answer = ask(json!({ "folder": order, "index": index }));
        let (bytes, row) = result(&order, index);
        let row: Value = serde_json::from_slice(&fs::read(row).unwrap()).unwrap();
        for key in ["key", "index", "sha256", "bytes", "rows", "wall_ms"] {
            assert_eq!(answer[key], row[key], "{key}");
        }
        assert_eq!(answer["sha256"], palpate::digest::sha256_hex(fs::read(bytes).unwrap()));
        assert_eq!(answer["rows"], 300);
    }
    let answer = ask(json!({ "folder": order, "index": 20 }));
    assert_eq!(answer, json!({ "index": 20, "error": "index = 20: must be from 0 to 19" }));
    let answer = ask(json!({ "folder": order.join("none"), "index": 0 }));
    assert!(answer["error"].as_str().unwrap().contains("has no order.json"), "{answer}");
    assert_eq!(answer["machine"], true, "others may have the folder");
    let answer = ask(json!({ "index": 0 }));
    assert!(answer["error"].as_str().unwrap().contains("folder"), "{answer}");
    drop(input);
    assert_eq!(process.0.wait().unwrap().code(), Some(0));
}

#[test]
fn sigterm_leaves_nothing_half() {
    let order = ordered("chunks-term", &MANY_TRIALS);
    let mut command = making(&order, &["--task", "0", "--tasks", "1"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    output.read_line(&mut line).unwrap();
    signal(&child, Signal::TERM);
    let lines: Vec<String> = output.lines().map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let last: Value = serde_json::from_str(lines.last().unwrap()).unwrap();
    assert_eq!(last["exit_status"], "abort");
    let done = last["done"].as_u64().unwrap();
    assert!((1..80).contains(&done), "{done}");
    assert_eq!(status(&order)["done"], done);
    assert_eq!(fs::read_dir(order.join("results")).unwrap().count() as u64, 2 * done);
}

#[test]
fn orders_and_options_that_are_wrong_are_refused() {
    let order = ordered("chunks-refused", &TRIALS);
    let text = |name: &str| fs::read_to_string(order.join(name)).unwrap();
    let (before, job) = (text("order.json"), text("job.sh"));
    assert_eq!(done(&ordering(&order, &TRIALS))["changed"], false);
    for (options, words) in [
        (&["--seed", "2"][..], "definition.draws.seed = 1, requested 2"),
        (&["--contacts", "1..7"], "contacts = 1..7: must be A..B"),
        (&["--tasks", "0"], "tasks = 0: must be from 1 to"),
        (&["--cpus", "0"], "cpus = 0: must be from 1 to 256"),
        (&["--memory-mib", "0"], "memory-mib = 0: must be from 1 to"),
        (&["--partition", "a b"], "partition = a b: must consist of letters"),
        (&["--account", "a\n#SBATCH"], "account = "),
        (&["--time", "1h"], "time = 1h: must be minutes"),
        (&["--shard-trials", "0"], "shard-trials = 0: must be from 1 to"),
    ] {
        let base: &[&str] = if options[0] == "--shard-trials" { &TRIALS[..2] } else { &TRIALS };
        not_done(&ordering(&order, &[base, options].concat()), 2, words);
    }
    assert_eq!((text("order.json"), text("job.sh")), (before.clone(), job));

    // Other options of the job alone.
    let other = ordering(&order, &[&TRIALS[..], &["--tasks", "4", "--time", "30"]].concat());
    assert_eq!(done(&other)["tasks"], 4);
    assert_eq!(text("order.json"), before);
    let job = text("job.sh");
    assert!(job.contains("#SBATCH --array=0-3\n") && job.contains("#SBATCH --time=30\n"), "{job}");
    assert_eq!(status(&order)["array"], "0-3");

    for (options, words) in [
        (&["20"][..], "index = 20: must be from 0 to 19"),
        (&["--task", "4", "--tasks", "4"], "task = 4: must be from 0 to 3"),
        (&["--task", "0", "--tasks", "0"], "tasks = 0: must be at least 1"),
    ] {
        not_done(&making(&order, options).output().unwrap(), 2, words);
    }
    for (from, to, words) in [
        (concat!(env!("CARGO_PKG_VERSION"), ", chunk 1"), "9.9.9, chunk 1", "code = "),
        ("\"seed\": 1", "\"seed\": 2", "id = "),
    ] {
        assert!(before.contains(from), "{from}");
        fs::write(order.join("order.json"), before.replace(from, to)).unwrap();
        not_done(&making(&order, &["0"]).output().unwrap(), 2, words);
    }
}

#[test]
fn a_disk_that_is_full_is_named() {
    let order = ordered("chunks-full", &TRIALS);
    // A limit of the size of files, smaller than a chunk, as a disk without space.
    let limited = format!(
        "ulimit -f 100; trap '' XFSZ; {PALPATE} cluster make --json {} 0 --data {}",
        order.display(),
        data().display()
    );
    let output = Command::new("bash").args(["-c", &limited]).stdin(Stdio::null()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let lines = String::from_utf8(output.stdout).unwrap();
    let failed: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    let results = order.join("results").display().to_string();
    assert!(failed["error"].as_str().unwrap().contains(&results), "{failed}");
    let after = status(&order);
    assert_eq!((&after["failed"][0]["index"], &after["missing"]), (&0.into(), &19.into()));
    assert_eq!(fs::read_dir(results).unwrap().count(), 0);
    // With space again, it is made, and its failure is forgotten.
    assert_eq!(make(&order, &["0"])["made"], 1);
    assert_eq!(status(&order)["failed"], json!([]));
}
