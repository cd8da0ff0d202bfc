//! Chunks that cannot be made are set aside with their error, and the others are made.

use std::fs;
use std::time::Duration;

use serde_json::{Value, json};

use crate::bench::{Bench, until};

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
    // Submitted again they have new attempts.
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
        until("the chunk is made", SOON, || bench.asked(taken) == attempt);
        worker.process.kill().unwrap();
        worker.process.wait().unwrap();
    }
    // A worker that ends with the last chunk waits for the lease of the lost one.
    let mut sweeper = bench.worker(&bench.address, &["--until-idle"]);
    assert!(sweeper.ended(SOON), "{}", sweeper.log());
    assert_eq!(bench.status(&made)["failed"], json!(1));
    let error = bench.status(&made)["errors"][0]["error"].to_string();
    assert!(error.contains("the worker ended while it made this chunk"), "{error}");
}

#[test]
fn a_machine_that_cannot_make_chunks_does_not_use_up_their_attempts() {
    let Some(bench) = Bench::start() else { return };
    let refused = json!({ "seed": 1, "refuses": true });
    // Without the program; with one that knows no such command; without the kernel; with another store.
    let ways = [
        (json!({ "seed": 1 }), "/none/palpate", "/none/palpate"),
        (json!({ "seed": 2 }), "ls", "exit status: 2"),
        (refused, "", "no kernel of the order"),
        (json!({ "seed": 3 }), "", "not in the store"),
    ];
    for (definition, program, expected) in ways {
        let made = bench.order(30, definition);
        bench.ok(&["submit", made.path()]);
        let stored = bench.store().join(&made.order.id).join("order.json");
        let elsewhere = bench.folder.path().join("elsewhere.json");
        if expected == "not in the store" {
            fs::rename(&stored, &elsewhere).unwrap();
        }
        let options = if program.is_empty() { vec![] } else { vec!["--program", program] };
        let mut sick = bench.worker(&bench.address, &options);
        // It is tried several times, each time with the same chunk, and no attempt counts.
        until("it is tried again", SOON, || sick.log().matches(expected).count() > 1);
        sick.terminate();
        assert!(sick.ended(SOON));
        if !stored.exists() {
            fs::rename(&elsewhere, &stored).unwrap();
        }
        let status = bench.status(&made);
        assert_eq!((&status["waiting"], &status["again"]), (&json!(30), &json!(1)));
        assert!(status["again_error"].as_str().unwrap().contains(expected), "{status}");
        assert_eq!(bench.asked("SELECT max(attempts) FROM palpate_queue._private_jobs"), "0");
        bench.ok(&["cancel", made.path()]);
    }
}

#[test]
fn an_order_that_machines_refuse_blocks_no_other_and_is_set_aside_in_the_end() {
    let Some(bench) = Bench::start() else { return };
    let refused = bench.order(30, json!({ "seed": 1, "refuses": true }));
    let made = bench.order(8, json!({ "seed": 2 }));
    bench.ok(&["submit", refused.path(), "--priority", "high"]);
    bench.ok(&["submit", made.path(), "--priority", "low"]);
    let mut worker = bench.worker(&bench.address, &[]);
    until("the other order is made", SOON, || bench.status(&made)["done"] == json!(8));
    worker.terminate();
    assert!(worker.ended(SOON));
    assert_eq!(bench.status(&refused)["waiting"], json!(30));
    // As after some days.
    bench.asked(
        "UPDATE palpate_queue._private_jobs SET payload = jsonb_set(payload::jsonb, '{refused}', '4999')::json",
    );
    let mut last = bench.worker(&bench.address, &["--until-idle"]);
    assert!(last.ended(SOON), "{}", last.log());
    let status = bench.status(&refused);
    assert_eq!(
        (&status["waiting"], &status["failed"], &status["missing"]),
        (&json!(0), &json!(30), &json!(0))
    );
    let error = status["errors"][0]["error"].as_str().unwrap();
    assert!(
        error.contains("refused 5000 times") && error.contains("no kernel of the order"),
        "{error}"
    );
    let again = bench.ok(&["submit", refused.path()]);
    assert!(again.contains("30 submitted (1 had failed)"), "{again}");
}
