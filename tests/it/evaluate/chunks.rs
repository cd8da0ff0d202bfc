//! Table IV of nets and regressions that were trained and scored in chunks: two processes next to each other make the
//! bytes and the table of one, and the service the same scores.
//! The nets learn almost nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use super::commands::{evaluate, palpate, table_text, trials};
use crate::datasets::filled::folder;
use crate::support::{PALPATE, Process, copy_folder, done, not_done, succeeded, with_extension};

/// Few passes over few rows, and few scored ones.
const TINY: [&str; 6] = ["--epochs", "1", "--rows", "40", "--scored", "20"];

/// Orders the nets of Table IV in a folder of the data.
fn ordered(data: &Path, name: &str) -> Value {
    let options = ["cluster", "sbatch", "table", "maps", "--json", "--folder", name];
    done(&palpate(data, &[&options[..], &TINY[..]].concat()))
}

/// Starts a task of an array, with this data folder.
pub(super) fn task(data: &Path, order: &Path, task: &str, tasks: &str) -> Process {
    let mut command = Command::new(PALPATE);
    command.args(["cluster", "make", "--json", "--task", task, "--tasks", tasks]).arg(order);
    command.arg("--data").arg(data).stdin(Stdio::null()).stdout(Stdio::null());
    Process(command.spawn().unwrap())
}

/// The chunks of an order with this ending: name and bytes.
pub(super) fn chunks(order: &Path, ending: &str) -> BTreeMap<String, Vec<u8>> {
    let chunks = with_extension(&order.join("results"), ending).into_iter();
    let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    chunks.map(|path| (name(&path), fs::read(path).unwrap())).collect()
}

/// The ids in the manifests of gathered nets.
fn ids(folder: &Path) -> BTreeSet<String> {
    let folders = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let manifest = |folder: PathBuf| fs::read_to_string(folder.join("manifest.toml")).unwrap();
    let manifests = folders.map(|folder| manifest(folder).parse::<toml::Table>().unwrap());
    manifests.map(|manifest| manifest["id"].as_str().unwrap().to_owned()).collect()
}

/// The nets and regressions of Table IV with their reports, without times, and the number of reports that state one.
fn table(data: &Path, options: &[&str]) -> (Vec<Value>, usize) {
    let mut table = evaluate(data, "maps", &[&TINY[..], options].concat());
    let (mut nets, mut times) = (Vec::new(), 0);
    for map in table["maps"].as_array_mut().unwrap() {
        nets.append(map["regressions"].as_array_mut().unwrap());
        nets.push(map.take());
    }
    for net in &mut nets {
        let latency = net["report"].as_object_mut().unwrap().remove("latency_ms");
        times += usize::from(latency.is_some_and(|latency| !latency.is_null()));
    }
    (nets, times)
}

#[tokio::test]
async fn a_table_of_two_processes_is_that_of_one() {
    let data = folder("evaluate-chunks");
    trials(&data).await;
    let order = ordered(&data, "one");
    assert_eq!((&order["kind"], &order["chunks"]), (&json!("trainings"), &json!(36)));
    let same = ordered(&data, "two");
    assert_eq!(same["order"], order["order"], "the same work");
    assert_eq!(ordered(&data, "one")["changed"], false);

    // One process, which is killed within a net and starts again.
    let [in_one, in_two] = ["one", "two"].map(|name| data.join(name));
    let mut killed = task(&data, &in_one, "0", "1");
    let unfinished = in_one.join("unfinished");
    while !unfinished.join("3").is_dir() {
        assert!(killed.0.try_wait().unwrap().is_none(), "it made all nets or failed");
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    drop(killed);
    assert!(task(&data, &in_one, "0", "1").0.wait().unwrap().success());
    // Two next to each other.
    let both = ["0", "1"].map(|number| task(&data, &in_two, number, "2"));
    for mut process in both {
        assert!(process.0.wait().unwrap().success());
    }
    let (one, two) = (chunks(&in_one, "net"), chunks(&in_two, "net"));
    assert_eq!(one.len(), 36);
    assert!(one == two, "other bytes: {:?} and {:?}", one.keys(), two.keys());
    let mut left = fs::read_dir(&unfinished).unwrap().map(|entry| entry.unwrap().path());
    assert!(left.all(|path| path.is_file()), "a training is left");

    // A net with other bytes is found, and made again.
    let (name, bytes) = one.first_key_value().unwrap();
    let path = in_one.join("results").join(name);
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    fs::write(&path, damaged).unwrap();
    let refused = palpate(&data, &["cluster", "gather", "one", "--out", "nets-one"]);
    not_done(&refused, 1, "is damaged");
    assert!(task(&data, &in_one, "0", "1").0.wait().unwrap().success());
    assert!(chunks(&in_one, "net") == one, "other bytes the second time");

    // Each table in a separate data folder, so that each adds its own nets.
    let copy = folder("evaluate-chunks-copy");
    copy_folder(&data.join("."), &copy);
    let mut tables = Vec::new();
    for (place, name) in [(&data, "one"), (&copy, "two")] {
        let out = format!("nets-{name}");
        succeeded(&palpate(place, &["cluster", "gather", name, "--out", &out]));
        let (table, times) = table(place, &["--trained", &out]);
        assert_eq!(times, 0, "scores of chunks state no latencies");
        let models: BTreeSet<String> =
            table.iter().map(|net| net["model"].as_str().unwrap().to_owned()).collect();
        assert_eq!(models, ids(&place.join(&out)), "the models of the table are the gathered nets");
        let jobs = succeeded(&palpate(place, &["job", "list", "--json"]));
        assert_eq!(jobs, "", "the service trained or scored a net");
        tables.push((table, table_text(place, "table-iv")));
    }
    assert_eq!(tables[0], tables[1]);

    // The service scores the same nets to the same table.
    let (_, times) = table(&copy, &[]);
    assert_eq!(times, 36, "these are scores of the service");
    assert_eq!(table_text(&copy, "table-iv"), tables[1].1);
}
