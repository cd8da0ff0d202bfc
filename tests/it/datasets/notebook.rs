//! The tools of a notebook against a service: pandas, polars, DuckDB, pyarrow and numpy, value by value
//! compared with the database. Without them the test reports that it was skipped; with
//! `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::filled::Filled;
use super::imports::import;
use crate::support::{self, Folder};

/// Modules that the scripts import.
const MODULES: &str = "pandas, polars, duckdb, pyarrow, numpy";

#[tokio::test(flavor = "multi_thread")]
async fn every_tool_reads_what_the_database_holds() {
    let Some(python) = support::python(MODULES) else { return };
    let lab = Filled::open("notebook").await;
    let (url, database) = (lab.service.url(), lab.data.join("palpate.db"));
    let arguments = [Path::new(&url), &database];
    println!("{}", support::printed(python, "datasets/python/check.py", &arguments).await);
    lab.close().await;
}

#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Expected {
    Refused { words: Vec<String> },
    Taken { trials: u64, contacts: u64, missing_channels: u64, left_out: Vec<String> },
}

/// Files as pyarrow and pandas write them: those that can be used are, in all their types; each of
/// the others is refused with the reason.
#[tokio::test(flavor = "multi_thread")]
async fn files_written_from_python_are_taken_or_refused() {
    let Some(python) = support::python(MODULES) else { return };
    let files = Folder::new("written-from-python");
    support::printed(python, "datasets/python/import.py", &[&files]).await;
    let read = |name: &str| std::fs::read(files.join(name)).unwrap();
    let expected: BTreeMap<String, Expected> =
        serde_json::from_slice(&read("expected.json")).unwrap();
    let sensor = String::from_utf8(read("pad.toml")).unwrap();
    assert!(expected.len() > 40, "{}", expected.len());
    let lab = Filled::open("from-python").await;
    for (name, expected) in expected {
        match expected {
            Expected::Refused { words } => {
                let file = read(&format!("bad/{name}.parquet"));
                let (status, body) = import(&lab, file, &sensor).await;
                assert_eq!(status, 400, "{name}: {body}");
                let detail = body["detail"].as_str().unwrap();
                let lacks = words.iter().find(|word| !detail.contains(word.as_str()));
                assert_eq!(lacks, None, "{name}: {detail}");
            }
            Expected::Taken { trials, contacts, missing_channels, left_out } => {
                let file = read(&format!("good/{name}.parquet"));
                let (status, made) = import(&lab, file, &sensor).await;
                assert_eq!(status, 201, "{name}: {made}");
                assert_eq!(made["columns_left_out"], Value::from(left_out), "{name}");
                let run = made["run"]["scan_id"].as_i64().unwrap();
                let rows = lab.items(&format!("/api/v1/runs/{run}/trials?limit=10000")).await;
                let sum = |key: &str| rows.iter().map(|r| r[key].as_u64().unwrap()).sum::<u64>();
                let found = (rows.len() as u64, sum("contact_count"), sum("missing_channels"));
                assert_eq!(found, (trials, contacts, missing_channels), "{name}");
            }
        }
    }
    lab.close().await;
}
