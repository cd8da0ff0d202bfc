//! Answers of `exact` to the frames of an evaluation, in chunks: two processes next to each other give the bytes of one,
//! and the scores are those of the service. The frames are made up.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use super::chunks::{chunks, task};
use super::commands::{evaluate, palpate, trials};
use crate::datasets::filled::folder;
use crate::support;

/// The evaluation.
const OPTIONS: [&str; 7] = ["exact", "--dataset", "real", "--part", "test", "--scored", "12"];

/// The last line of a command that must succeed.
fn done(data: &Path, arguments: &[&str]) -> Value {
    support::done(&palpate(data, arguments))
}

/// Whether two values are equal; numbers up to what a text of them loses.
fn is_close(one: &Value, two: &Value) -> bool {
    match (one, two) {
        (Value::Number(one), Value::Number(two)) => {
            let (one, two) = (one.as_f64().unwrap(), two.as_f64().unwrap());
            (one - two).abs() <= 1e-6 * one.abs().max(1.0)
        }
        (Value::Array(one), Value::Array(two)) => {
            one.len() == two.len() && one.iter().zip(two).all(|(one, two)| is_close(one, two))
        }
        (Value::Object(one), Value::Object(two)) => {
            one.len() == two.len()
                && one.iter().all(|(key, one)| two.get(key).is_some_and(|two| is_close(one, two)))
        }
        _ => one == two,
    }
}

#[tokio::test]
async fn answers_of_two_processes_are_scored_as_those_of_the_service() {
    let data = folder("evaluate-readings");
    trials(&data).await;
    let order =
        ["cluster", "sbatch", "evaluation", "--json", "--chunk-rows", "5", "--folder", "one"];
    let ordered = done(&data, &[&order[..], &OPTIONS[..]].concat());
    assert_eq!((&ordered["kind"], &ordered["chunks"]), (&json!("readings"), &json!(3)));
    let [one, two] = ["one", "two"].map(|name| data.join(name));
    fs::create_dir(&two).unwrap();
    fs::copy(one.join("order.json"), two.join("order.json")).unwrap();
    // A node has the cache alone.
    let node = folder("evaluate-readings-node");
    support::copy_folder(&data.join("cache"), &node);

    assert!(task(&node, &one, "0", "1").0.wait().unwrap().success());
    for mut process in ["0", "1"].map(|number| task(&node, &two, number, "2")) {
        assert!(process.0.wait().unwrap().success());
    }
    let found = chunks(&one, "jsonl");
    assert_eq!(found.len(), 3);
    assert!(found == chunks(&two, "jsonl"), "other bytes");
    let lines = found.values().map(|bytes| bytes.iter().filter(|byte| **byte == b'\n').count());
    assert_eq!(lines.sum::<usize>(), 12);
    assert!(!node.join("palpate.db").exists(), "a node needs no database");

    assert_eq!(done(&data, &["cluster", "gather", "one", "--out", "scored", "--json"])["rows"], 12);
    let trained = ["--trained", "scored"];
    let of_chunks = evaluate(&data, "method", &[&OPTIONS[..], &trained[..]].concat());
    let mut of_service = evaluate(&data, "method", &OPTIONS);
    let latency = of_service["report"].as_object_mut().unwrap().remove("latency_ms");
    assert!(latency.is_some(), "the service has read the frames: {of_service}");
    assert_eq!(of_chunks["report"]["rows"], 12);
    assert!(is_close(&of_chunks, &of_service), "{of_chunks}\n{of_service}");

    // Missing chunks are no evaluation.
    let order =
        ["cluster", "sbatch", "evaluation", "--json", "--chunk-rows", "6", "--folder", "three"];
    done(&data, &[&order[..], &OPTIONS[..]].concat());
    let refused = palpate(&data, &["cluster", "gather", "three", "--out", "scored-three"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(!data.join("scored-three").exists());

    // A method whose frames are read at once is refused.
    let fast =
        ["cluster", "sbatch", "evaluation", "tikhonov", "--dataset", "real", "--folder", "four"];
    support::not_done(&palpate(&data, &fast), 2, "must be exact");
}
