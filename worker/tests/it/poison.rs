//! Chunks that cannot be made are set aside with their error, and the others are made.

use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use crate::bench::{Bench, text, until};
use crate::server::PASSWORD;

const SOON: Duration = Duration::from_secs(40);

#[test]
fn a_chunk_that_fails_dies_or_hangs_is_set_aside_with_its_error() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(8, json!({ "seed": 1, "fails": [1], "dies": [4], "hangs": [6] }));
    bench.ok(&["submit", made.path(), "--attempts", "2"]);
    let mut worker = bench.worker(&bench.address, &["--at-once", "2", "--limit-s", "2"]);
    bench.try_run(&["status", &made.order.id, "--wait"]);
    worker.terminate();
    assert!(worker.ended(SOON));
    let status = bench.status(&made);
    assert_eq!(
        (&status["done"], &status["failed"], &status["missing"]),
        (&json!(5), &json!(3), &json!(0))
    );
    let error = |index: u64| -> Value {
        let name = format!("{}.json", made.order.key(index));
        let text = fs::read(bench.store().join(&made.order.id).join("failed").join(name)).unwrap();
        serde_json::from_slice(&text).unwrap()
    };
    for (index, expected) in [
        (1, "index 1 fails by its definition"),
        (4, "index 4 ends the program by its definition"),
        (6, "no answer within 2 s"),
    ] {
        let failed = error(index);
        assert_eq!((&failed["index"], &failed["attempts"]), (&json!(index), &json!(2)));
        assert!(failed["error"].as_str().unwrap().contains(expected), "{failed}");
    }
    assert_eq!(status["errors"].as_array().unwrap().len(), 3);
    // Submitted again they have new attempts, also for `fetch`, which copies the errors.
    let again = bench.ok(&["submit", made.path(), "--attempts", "1"]);
    assert!(again.contains("3 submitted (3 had failed)"), "{again}");
    assert_eq!(bench.status(&made)["errors"], json!([]));
}

#[test]
fn a_chunk_that_takes_its_worker_with_it_is_set_aside() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(1, json!({ "seed": 1, "hangs": [0] }));
    bench.ok(&["submit", made.path(), "--attempts", "2"]);
    for attempt in ["1", "2"] {
        let mut worker = bench.worker(&bench.address, &[]);
        let taken = "SELECT attempts FROM palpate_queue._private_jobs WHERE locked_by IS NOT NULL";
        until("the chunk is made", SOON, || {
            text(&bench.server.psql("owner", "queue", PASSWORD, taken).stdout).trim() == attempt
        });
        worker.process.kill().unwrap();
        worker.process.wait().unwrap();
    }
    let _sweeper = bench.worker(&bench.address, &[]);
    until("the chunk is set aside", SOON, || bench.status(&made)["failed"] == json!(1));
    let error = bench.status(&made)["errors"][0]["error"].to_string();
    assert!(error.contains("the worker ended while it made this chunk"), "{error}");
}

#[test]
fn a_machine_without_the_program_does_not_use_up_the_attempts_of_all_chunks() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(30, json!({ "seed": 1 }));
    bench.ok(&["submit", made.path()]);
    let mut sick = bench.worker(&bench.address, &["--program", "/none/palpate"]);
    std::thread::sleep(Duration::from_secs(3));
    sick.terminate();
    assert!(sick.ended(SOON));
    assert!(sick.log().contains("/none/palpate"), "{}", sick.log());
    let again = bench.status(&made)["again"].as_u64().unwrap();
    assert!((1..8).contains(&again), "{again}");
    assert_eq!(bench.status(&made)["waiting"], json!(30));
}
