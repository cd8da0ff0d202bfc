//! The datasets of several rigs in one folder, through the command: ids, bytes, rigs that are down or differ, keys.
//! Without pandas and pyarrow the part that reads with them reports that it was skipped; with
//! `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use arrow_array::cast::AsArray;
use arrow_array::types::UInt32Type;
use palpate::dataset::build::Progress;
use palpate::dataset::federate::{Fetched, Tables, join};
use palpate::dataset::format::Rows;
use palpate::dataset::read::DatasetRows;
use palpate::dataset::select::Wanted;
use palpate::digest::sha256_hex;
use palpate::store::{NewRun, RunKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use super::filled::{Filled, fill, folder, new_run, press_run, store};
use crate::support::{self, SENSOR, command, files, finished, succeeded};

/// Rows of `real` in a filled folder.
const REAL: u64 = 235;
/// Longest duration of a call with a rig that never answers: not that of a connection or a download.
const LIMIT: Duration = Duration::from_secs(60);

/// What a call has printed.
struct Called {
    code: i32,
    answer: Value,
    errors: String,
}

impl Called {
    /// A field of each rig.
    fn each(&self, key: &str) -> Vec<String> {
        let rigs = self.answer["rigs"].as_array().unwrap_or_else(|| panic!("{}", self.errors));
        rigs.iter().map(|rig| rig[key].as_str().unwrap_or("-").to_owned()).collect()
    }

    fn states(&self) -> String {
        self.each("state").join(" ")
    }

    /// The call must have failed with these words.
    fn is_refused(&self, words: &str) {
        assert!(self.code == 2 && self.errors.contains(words), "{words}: {}", self.errors);
    }
}

/// Ends the services, and removes the folder around that of a call.
async fn close(labs: impl IntoIterator<Item = Filled>, out: &Path) {
    for lab in labs {
        lab.close().await;
    }
    std::fs::remove_dir_all(out.parent().unwrap()).unwrap();
}

/// Runs a command of `palpate` without the environment of the tests.
async fn typed(words: &[&str]) -> std::process::Output {
    finished(command(words)).await
}

/// Joins datasets in a folder.
async fn federate(out: &Path, words: &[&str]) -> Called {
    let out = out.display().to_string();
    let words = [&["dataset", "federate", "--json", "--out", &out][..], words].concat();
    let output = typed(&words).await;
    Called {
        code: output.status.code().unwrap(),
        answer: serde_json::from_slice(&output.stdout).unwrap_or_default(),
        errors: String::from_utf8(output.stderr).unwrap(),
    }
}

/// A service with the dataset `real` of runs that no other one has.
async fn rig(name: &str) -> Filled {
    let data = folder(name);
    fill(&data).await;
    let rig = Filled::serve(data).await;
    assert_eq!(rig.make("real").await["rows"], REAL);
    rig
}

/// Adds three trials of another run to a folder.
async fn add_run(data: &Path, run: NewRun) {
    let store = store(data).await;
    press_run(&store, run, 2, 1, 4..7, &mut ChaCha8Rng::seed_from_u64(9)).await;
    store.close().await;
}

fn table(out: &Path, rig: &str) -> PathBuf {
    out.join(format!("trials/{rig}.virtual.parquet"))
}

/// The values of columns of texts and of counts, row by row.
fn rows(file: &Path, texts: [&str; 2], count: &str) -> Vec<(String, String, u32)> {
    let columns = texts.iter().copied().chain([count]).map(str::to_owned).collect();
    let rows = DatasetRows::open(file, &Wanted { columns, ..Wanted::default() }).unwrap();
    let mut found = Vec::new();
    for batch in rows.batches(None).unwrap() {
        let batch = batch.unwrap();
        let text = |column: usize, row: usize| {
            batch.column(column).as_string::<i32>().value(row).to_owned()
        };
        let counts = batch.column(2).as_primitive::<UInt32Type>();
        found.extend((0..batch.num_rows()).map(|at| (text(0, at), text(1, at), counts.value(at))));
    }
    found
}

/// Changes a byte of the rows of a Parquet file.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    bytes[100] ^= 1;
    std::fs::write(path, bytes).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn two_rigs_become_tables_whose_ids_no_two_rows_share() {
    let (a, b) = (rig("federate-a").await, rig("federate-b").await);
    let out = folder("federate-lab").join("lab");
    let words = [format!("a={}", a.url("")), format!("b={}", b.url(""))];
    let first = federate(&out, &[&words[0], &words[1]]).await;
    assert_eq!((first.code, first.states().as_str()), (0, "fetched fetched"));
    assert_eq!(first.answer["rows"], 2 * REAL);
    let mut ids = BTreeSet::new();
    for name in ["a", "b"] {
        for (rig, id, _) in rows(&table(&out, name), ["rig", "trial"], "configuration") {
            assert!(rig == name && id.starts_with(&format!("{name}/")), "{rig} {id}");
            ids.insert(id);
        }
    }
    assert_eq!(ids.len() as u64, 2 * REAL);
    let manifest = std::fs::read(out.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    // Joined again, the rows are counted, and no byte differs.
    let kept = ["a", "b"].map(|name| Fetched::read(&out, name).unwrap().unwrap());
    let (progress, before) = (Progress::default(), files(&out));
    join(&out, "real", &kept, Tables::Joint, &progress).unwrap();
    assert_eq!([&progress.done, &progress.total].map(|rows| rows.load(Relaxed)), [2 * REAL; 2]);
    assert_eq!(files(&out), before);
    let of_a = &manifest["rigs"][0];
    assert_eq!((&of_a["rig"], &of_a["url"]), (&json!("a"), &json!(a.url(""))));
    assert_eq!(of_a["dataset"], a.get("/api/v1/datasets/real").await["id"]);
    assert_eq!(of_a["lineage"]["runs"][0]["trials"], 330);
    assert_eq!(of_a["sensor_sha256"], sha256_hex(SENSOR));
    let kept = std::fs::read(table(&out, "a")).unwrap();
    assert_eq!(of_a["files"][0]["sha256"], sha256_hex(kept));

    // Again, in another order: nothing is fetched, and every byte is the same.
    let before = files(&out);
    let again = federate(&out, &[&words[1], &words[0]]).await;
    assert_eq!((again.code, again.each("state")), (0, vec!["unchanged".to_owned(); 2]));
    assert_eq!(again.each("fetched_at"), first.each("fetched_at"));
    assert!(files(&out) == before);
    if let Some(python) = support::python("pandas, pyarrow") {
        let script = "import pandas, sys; trials = pandas.read_parquet(sys.argv[1])\n\
                      print(len(trials), trials.trial.nunique(), *sorted(set(trials.rig)))";
        let tables = out.join("trials");
        let reading = Command::new(python).args(["-c", script]).arg(tables).output().unwrap();
        let printed = String::from_utf8(reading.stdout).unwrap();
        assert_eq!(printed.trim(), format!("{0} {0} a b", 2 * REAL));
    }

    // Trials were stored at one of them: its dataset is fetched, and its runs keep their configurations apart.
    let data = a.end().await;
    add_run(&data, new_run(RunKind::RealHex, "second")).await;
    let a = Filled::serve(data).await;
    let at_a = format!("a={}", a.url(""));
    let stale = federate(&out, &[&at_a, &words[1]]).await;
    assert_eq!(stale.each("state"), ["unchanged", "unchanged"]);
    assert_eq!(stale.each("note"), ["trials were stored since it was made", "-"]);
    a.make("real").await;
    let newer = federate(&out, &[&at_a, &words[1]]).await;
    assert_eq!((newer.code, newer.states().as_str()), (0, "fetched unchanged"));
    assert_eq!(newer.answer["rows"], 2 * REAL + 3);
    let of_a = rows(&table(&out, "a"), ["run", "trial"], "configuration");
    let (run, id, configuration) = of_a.last().unwrap();
    assert_eq!((id, *configuration), (&format!("a/{run}/0/6"), 30));
    let fetched = std::fs::read_dir(out.join("fetched/a")).unwrap().count();
    assert_eq!(fetched, 3, "the earlier dataset is removed");

    // Each table is an import; a dataset of them may leave a rig out.
    let desk = Filled::serve(folder("federate-desk")).await;
    for name in ["a", "b"] {
        let (file, url) = (table(&out, name).display().to_string(), desk.url(""));
        let sensor = out.join(format!("fetched/{name}/sensor.toml")).display().to_string();
        let words = ["dataset", "import", &file, "--sensor", &sensor, "--label", "virtual"];
        succeeded(&typed(&[&words[..], &["--name", name, "--url", &url]].concat()).await);
    }
    let split = json!({ "by": "run", "test_runs": ["b"] });
    let definition = json!({ "name": "lab", "task": "real", "runs": ["a", "b"], "split": split });
    let made = desk.defined(definition).await;
    assert_eq!(made["rows"], 2 * REAL + 3);
    assert_eq!(made["report"]["parts"]["test"], REAL);
    close([a, b, desk], &out).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rig_that_is_down_is_shown_and_not_waited_for() {
    let (a, b) = (rig("federate-up").await, rig("federate-down").await);
    let out = folder("federate-missed").join("lab");
    let (at_a, at_b) = (format!("a={}", a.url("")), format!("b={}", b.url("")));
    let first = federate(&out, &[&at_a, &at_b]).await;
    assert_eq!(first.code, 0, "{}", first.errors);
    let before = files(&out);
    b.close().await;
    // Connections to one are refused; the other accepts them and never answers.
    let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let at_c = format!("c=http://{}", silent.local_addr().unwrap());
    let words = [at_a.as_str(), "b=http://127.0.0.1:1", &at_c];
    let start = Instant::now();
    let called = federate(&out, &words).await;
    assert!(start.elapsed() < LIMIT, "{:?}", start.elapsed());
    assert_eq!((called.code, called.states().as_str()), (1, "unchanged kept absent"));
    assert_eq!(called.answer["rows"], 2 * REAL);
    assert_eq!(called.each("fetched_at")[..2], first.each("fetched_at"));
    let notes = called.each("note");
    assert_eq!(notes[1], "no service answers at http://127.0.0.1:1");
    assert!(notes[2].contains("did not answer in time"), "{}", notes[2]);
    let missed = "2 of 3 rigs did not answer with a dataset: b, c";
    assert!(called.errors.contains(missed), "{}", called.errors);
    assert!(files(&out) == before);
    // For people: the date of what is used, and what to type next.
    let place = out.display().to_string();
    let shown = typed(&[&["dataset", "federate", "--out", &place][..], &words[..2]].concat()).await;
    let (text, errors) = (shown.stdout, String::from_utf8(shown.stderr).unwrap());
    let text = String::from_utf8(text).unwrap();
    let line = text.lines().find(|line| line.starts_with("b ")).unwrap();
    let fetched_at: jiff::Timestamp = first.each("fetched_at")[1].parse().unwrap();
    let date = fetched_at.to_zoned(jiff::tz::TimeZone::system()).strftime("%Y-%m-%d %H:%M");
    assert!(line.contains(&date.to_string()) && line.contains("kept"), "{text}");
    assert!(errors.contains("the same command later"), "{errors}");
    // Without any dataset there is nothing to join.
    let nothing = federate(&out.with_file_name("none"), &words[1..2]).await;
    assert_eq!((nothing.code, &nothing.answer["rows"]), (1, &Value::Null));
    assert!(!out.with_file_name("none").exists());
    close([a], &out).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dataset_whose_bytes_are_not_those_of_its_sha256_is_refused_by_name() {
    let (a, b) = (rig("federate-whole").await, rig("federate-damaged").await);
    let out = folder("federate-bytes").join("lab");
    let words = [format!("a={}", a.url("")), format!("b={}", b.url(""))];
    let words = [words[0].as_str(), &words[1]];
    let first = federate(&out, &words).await;
    assert_eq!(first.code, 0, "{}", first.errors);
    let before = files(&out.join("trials"));
    let id = first.each("dataset")[1].clone();
    let kept = out.join(format!("fetched/b/{id}.parquet"));
    damage(&kept);
    let refused = federate(&out, &words).await;
    for word in ["rig b: sha256 of ", &id, "and it is fetched again"] {
        refused.is_refused(word);
    }
    assert!(!refused.errors.contains("rig a"), "{}", refused.errors);
    std::fs::remove_file(&kept).unwrap();
    let again = federate(&out, &words).await;
    assert_eq!((again.code, again.states().as_str()), (0, "unchanged fetched"));
    // What the service sends is not what it states.
    damage(&b.data.join(format!("datasets/{id}.parquet")));
    std::fs::remove_file(&kept).unwrap();
    federate(&out, &words).await.is_refused("is not the one that it states");
    assert!(!kept.exists() && files(&out.join("trials")) == before);
    close([a, b], &out).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rigs_that_differ_are_refused_with_the_field_that_differs() {
    let a = rig("federate-short").await;
    let data = folder("federate-tall");
    let taller = SENSOR.replace("height_mm = 560.0", "height_mm = 570.0");
    let run = NewRun { sensor: taller, ..new_run(RunKind::RealHex, "tall") };
    add_run(&data, run).await;
    let tall = Filled::serve(data).await;
    tall.make("real").await;
    let out = folder("federate-differ").join("lab");
    let (at_a, at_tall) = (format!("a={}", a.url("")), format!("tall={}", tall.url("")));
    let refused = federate(&out, &[&at_a, &at_tall]).await;
    refused.is_refused("rigs a and tall: sensor.height_mm = 560.0 and 570.0");
    refused.is_refused("--apart");
    assert!(!out.join("manifest.json").exists() && files(&out.join("trials")).is_empty());
    let apart = federate(&out, &[&at_a, &at_tall, "--apart"]).await;
    assert_eq!((apart.code, &apart.answer["rows"]), (0, &json!(REAL + 3)), "{}", apart.errors);
    // One service under two names would give its trials twice; --apart does not allow it.
    let again = format!("b={}", a.url(""));
    federate(&out, &[&at_a, &again, "--apart"]).await.is_refused("rigs a and b: run = ");
    // The folder belongs to one dataset.
    let refused = federate(&out, &[&at_a, "--dataset", "real-unseen"]).await;
    refused.is_refused("has the dataset real already");
    close([a, tall], &out).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_service_gets_its_own_key_from_a_file() {
    let open = rig("federate-key").await;
    let (_, secret) = open.key("reader", "viewer").await;
    let lab = Filled::serve_keys(open.end().await).await;
    let files = folder("federate-keys");
    let out = files.join("lab");
    let url = lab.url("");
    let without = federate(&out, &[&format!("a={url}")]).await;
    assert_eq!(without.code, 1);
    assert!(without.each("note")[0].contains("key_file"), "{}", without.answer);
    std::fs::write(files.join("a.key"), format!("{secret}\n")).unwrap();
    let rigs = files.join("rigs.toml");
    std::fs::write(&rigs, format!("[a]\nurl = \"{url}\"\nkey_file = \"a.key\"\n")).unwrap();
    let rigs = rigs.display().to_string();
    let with = federate(&out, &["--rigs", &rigs]).await;
    assert_eq!((with.code, with.states().as_str()), (0, "fetched"), "{}", with.errors);
    lab.close().await;
    std::fs::remove_dir_all(files).unwrap();
}
