//! From an order to its results: submit, work, status, fetch, cancel, needs, priority, SIGTERM.

use std::fs;
use std::time::Duration;

use serde_json::json;

use crate::bench::{Bench, Made, text, until};

const SOON: Duration = Duration::from_secs(30);

#[test]
fn an_order_is_made_fetched_and_equal_to_that_of_one_process() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(12, json!({ "seed": 7, "scale": 0.1 }));
    assert!(bench.ok(&["submit", made.path()]).contains("12 submitted"));
    assert!(
        bench.ok(&["submit", made.path()]).contains("0 submitted (0 had failed), 12 in the queue")
    );
    let mut worker = bench.worker(&bench.address, &["--until-idle", "--at-once", "2"]);
    assert!(worker.ended(SOON), "{}", worker.log());
    let status = bench.status(&made);
    assert_eq!((&status["done"], &status["missing"]), (&json!(12), &json!(0)));
    assert!(made.stored(&bench) == made.undisturbed());
    // A row states what the program has written, not what the worker knows.
    let row = fs::read(made.row(&bench, 5)).unwrap();
    let row: serde_json::Value = serde_json::from_slice(&row).unwrap();
    assert_eq!((&row["made_by"], &row["commit"]), (&json!("stand-in"), &json!("0000000")));
    // The next submission finds all done.
    assert!(
        bench
            .ok(&["submit", made.path()])
            .contains("0 submitted (0 had failed), 0 in the queue, 12 done")
    );

    let fetched = bench.folder.path().join("fetched");
    let short = &made.order.id[..8];
    let output = bench.ok(&["fetch", short, fetched.to_str().unwrap(), "--json"]);
    assert!(output.contains(r#""fetched":12"#), "{output}");
    // An order is also named by its folder, which may receive its results.
    let output = bench.ok(&["fetch", made.path(), made.path()]);
    assert!(output.contains("12 of 12 results fetched"), "{output}");
    assert!(made.results(&made.folder.join("results")) == made.undisturbed());
    assert!(made.results(&fetched.join("results")) == made.undisturbed());
    // A second call fetches nothing but what was damaged here.
    fs::write(fetched.join("results").join(format!("{}.parquet", made.order.key(3))), "damaged")
        .unwrap();
    let output = bench.ok(&["fetch", short, fetched.to_str().unwrap(), "--json"]);
    assert!(output.contains(r#""fetched":1,"present":11"#), "{output}");
    assert!(made.results(&fetched.join("results")) == made.undisturbed());
}

#[test]
fn files_of_an_order_are_stored_once_fetched_and_compared_with_their_hash() {
    let Some(bench) = Bench::start() else { return };
    // More than one part of an upload, and of a download.
    let large = vec![7_u8; 6 << 20];
    let one = bench.order_on(3, json!({ "seed": 1 }), &[&large[..], b"small"]);
    let other = bench.order_on(3, json!({ "seed": 2 }), &[&b"small"[..]]);
    let name = &other.order.files[0];
    let stored = bench.store().join("inputs").join(name);
    let written = || fs::metadata(&stored).unwrap().modified().unwrap();
    bench.ok(&["submit", one.path()]);
    let before = written();
    bench.ok(&["submit", other.path()]);
    assert_eq!(written(), before);
    let desk = bench.desk(bench.server.port);
    let mut worker = bench.worker(&desk, &["--until-idle", "--at-once", "2"]);
    assert!(worker.ended(SOON), "{}", worker.log());
    for made in [&one, &other] {
        assert!(made.stored(&bench) == made.undisturbed(), "{}", worker.log());
    }
    // A file that is damaged in the store, and then missing there, is named and not used.
    let third = bench.order_on(1, json!({ "seed": 3 }), &[&b"small"[..]]);
    fs::write(&stored, "other").unwrap();
    bench.ok(&["submit", third.path()]);
    let mut worker = bench.worker(&desk, &[]);
    let named = |what: &str| worker.log().contains(&format!("inputs/{name}: {what}"));
    until("the damage is named", SOON, || named("sha256 "));
    fs::remove_file(&stored).unwrap();
    until("the loss is named", SOON, || named("not in the store"));
    assert!(third.stored(&bench)[0].is_none());
    bench.ok(&["submit", third.path()]);
    until("the chunk is made", SOON, || bench.status(&third)["done"] == json!(1));
    worker.terminate();
    assert!(worker.ended(SOON), "{}", worker.log());
    assert!(third.stored(&bench) == third.undisturbed());
    // One that is damaged in the folder of its order is not stored.
    let fourth = bench.order_on(1, json!({ "seed": 4 }), &[&b"own"[..]]);
    fs::write(fourth.folder.join("inputs").join(&fourth.order.files[0]), "other").unwrap();
    let refused = bench.try_run(&["submit", fourth.path()]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert!(!bench.store().join("inputs").join(&fourth.order.files[0]).exists());
}

#[test]
fn a_damaged_result_is_named_discarded_and_made_again() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(3, json!({ "seed": 8 }));
    bench.ok(&["submit", made.path()]);
    assert!(bench.worker(&bench.address, &["--until-idle"]).ended(SOON));
    let key = made.order.key(1);
    let stored = made.stored_in(&bench).join(format!("{key}.parquet"));
    let mut bytes = fs::read(&stored).unwrap();
    bytes[100] ^= 1;
    fs::write(&stored, bytes).unwrap();
    let fetched = bench.folder.path().join("fetched");
    let fetch = ["fetch", &made.order.id, fetched.to_str().unwrap()];
    let output = bench.try_run(&fetch);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains(&key) && text(&output.stdout).contains("2 of 3"),
        "{output:?}"
    );
    assert_eq!(
        bench.try_run(&[&fetch[..], &["--discard-damaged"]].concat()).status.code(),
        Some(1)
    );
    assert!(bench.ok(&["submit", made.path()]).contains("1 submitted"));
    assert!(bench.worker(&bench.address, &["--until-idle"]).ended(SOON));
    bench.ok(&fetch);
    assert!(made.results(&fetched.join("results")) == made.undisturbed());
}

#[test]
fn a_result_that_exists_is_acknowledged_and_not_made() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(4, json!({ "seed": 9 }));
    bench.ok(&["submit", made.path()]);
    assert!(bench.worker(&bench.address, &["--until-idle"]).ended(SOON));
    let written = || fs::metadata(made.row(&bench, 2)).unwrap().modified().unwrap();
    let before = written();
    // The queue delivers a chunk again, as after a lost acknowledgement.
    let payload = json!({ "order": made.order.id, "index": 2 });
    let add = format!("SELECT palpate_queue.add_job('chunk', '{payload}')");
    bench.asked(&add);
    let mut worker = bench.worker(&bench.address, &["--until-idle"]);
    assert!(worker.ended(SOON));
    assert!(worker.log().contains("made=0 existed=1"), "{}", worker.log());
    assert_eq!(written(), before);
}

#[test]
fn a_worker_takes_what_it_can_do_and_high_priority_first() {
    let Some(bench) = Bench::start() else { return };
    let low = bench.order(2, json!({ "seed": 1 }));
    let high = bench.order(2, json!({ "seed": 2 }));
    let gpu = bench.order(2, json!({ "seed": 3, "compute": { "cuda": 0 } }));
    bench.ok(&["submit", low.path(), "--priority", "low"]);
    bench.ok(&["submit", high.path(), "--priority", "high"]);
    // An order that computes on a GPU needs no `--gpu`.
    bench.ok(&["submit", gpu.path(), "--memory-mib", "3000"]);
    for unfit in [&["--memory-mib", "4096"][..], &["--gpu", "--memory-mib", "2047"]] {
        assert!(bench.worker(&bench.address, &[unfit, &["--until-idle"]].concat()).ended(SOON));
        assert_eq!(bench.status(&gpu)["waiting"], json!(2));
    }
    let written =
        |made: &Made, index| fs::metadata(made.row(&bench, index)).unwrap().modified().unwrap();
    let last_high = written(&high, 0).max(written(&high, 1));
    assert!(last_high < written(&low, 0).min(written(&low, 1)));
    assert!(
        bench
            .worker(&bench.address, &["--gpu", "--memory-mib", "3072", "--until-idle"])
            .ended(SOON)
    );
    assert_eq!(bench.status(&gpu)["done"], json!(2));
}

#[test]
fn a_cancelled_order_is_made_no_more() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(5, json!({ "seed": 4 }));
    let other = bench.order(2, json!({ "seed": 5 }));
    bench.ok(&["submit", made.path()]);
    bench.ok(&["submit", other.path()]);
    let orders = || bench.asked("SELECT count(*) FROM palpate_queue._private_tasks");
    assert!(bench.ok(&["cancel", &made.order.id]).contains("5 chunks removed"));
    assert_eq!(orders(), "2");
    assert!(bench.worker(&bench.address, &["--until-idle"]).ended(SOON));
    assert_eq!(
        (&bench.status(&made)["done"], &bench.status(&other)["done"]),
        (&json!(0), &json!(2))
    );
    let output = bench.try_run(&["status", &made.order.id, "--wait"]);
    assert_eq!(output.status.code(), Some(1), "an order that is not complete");
    // A submission forgets the orders of which nothing is left to make.
    bench.ok(&["submit", made.path()]);
    assert_eq!(orders(), "1");
    assert!(bench.worker(&bench.address, &["--until-idle"]).ended(SOON));
    assert_eq!(bench.status(&made)["done"], json!(5));
}

#[test]
fn after_sigterm_the_present_chunk_is_completed_and_no_other_taken() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(6, json!({ "seed": 6, "ms": 1500 }));
    bench.ok(&["submit", made.path()]);
    let mut worker = bench.worker(&bench.address, &[]);
    until("a chunk is made", SOON, || bench.status(&made)["running"] == json!(1));
    worker.terminate();
    assert!(worker.ended(SOON), "{}", worker.log());
    let status = bench.status(&made);
    assert_eq!(
        (&status["done"], &status["running"], &status["waiting"]),
        (&json!(1), &json!(0), &json!(5))
    );
    let workers: serde_json::Value =
        serde_json::from_str(&bench.ok(&["status", "--json"])).unwrap();
    assert_eq!(workers["workers"], json!([]));
    // A closed terminal is a request to end, also if shell and kernel both report it.
    let mut worker = bench.worker(&bench.address, &[]);
    until("a chunk is made", SOON, || bench.status(&made)["running"] == json!(1));
    worker.hang_up();
    std::thread::sleep(Duration::from_millis(200));
    worker.hang_up();
    assert!(worker.ended(SOON), "{}", worker.log());
    assert_eq!(bench.status(&made)["done"], json!(2));
    // A second signal does not wait for the chunk, which is returned when the lease ends: the worker fails.
    let mut worker = bench.worker(&bench.address, &[]);
    until("a chunk is made", SOON, || bench.status(&made)["running"] == json!(1));
    worker.terminate();
    std::thread::sleep(Duration::from_millis(200));
    worker.terminate();
    assert!(!worker.ended(SOON));
    let scratch = bench.folder.path().join("scratch");
    let is_empty = || fs::read_dir(&scratch).unwrap().next().is_none();
    assert!(is_empty(), "its program has ended, and its folder is removed");
    let mut next = bench.worker(&bench.address, &[]);
    let all_done = || bench.status(&made)["done"] == json!(6);
    until("all are done", SOON, all_done);
    next.terminate();
    assert!(next.ended(SOON));
    assert!(made.stored(&bench) == made.undisturbed());
    assert!(is_empty(), "no program has made a folder again");
}

#[test]
fn a_chunk_whose_delivery_was_lost_is_returned_by_its_living_worker() {
    let Some(bench) = Bench::start() else { return };
    let made = bench.order(1, json!({ "seed": 11 }));
    bench.ok(&["submit", made.path(), "--gpu"]);
    let _worker = bench.worker(&bench.desk(bench.server.port), &[]);
    let worker = || bench.asked("SELECT id FROM palpate_queue._private_workers");
    until("the worker is there", SOON, || !worker().is_empty());
    // As if the worker had taken it a minute ago, and its answer had not arrived.
    bench.asked(&format!(
        "UPDATE palpate_queue._private_jobs SET flags = NULL, attempts = 8, locked_by = '{}', \
         locked_at = now() - interval '1 minute'",
        worker()
    ));
    until("the chunk is made", SOON, || bench.status(&made)["done"] == json!(1));
    until("it is acknowledged", SOON, || bench.status(&made)["running"] == json!(0));
}
