//! A service that takes a data folder over while its database refuses writes, as on a full disk.

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::Duration;

use crate::datasets::filled::store;
use crate::old_data::copy;
use crate::support::{answered, command, execute, http, served, until};

/// Longest wait for the mark of a run.
const LIMIT: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_is_taken_over_although_its_database_refuses_writes_at_first() {
    let folder = copy("no-writes");
    store(&folder).await.close().await;
    // A killed run, one that waits, and what an import has left.
    execute(
        &folder,
        "UPDATE runs SET waiting_since = '2026-11-20T18:00:00.000Z' WHERE scan_id = 3;
         UPDATE runs SET kind = 'imported', state = 'removed', exit_status = NULL WHERE scan_id = 1;
         CREATE TRIGGER no_mark BEFORE UPDATE OF state ON runs BEGIN
             SELECT RAISE(ABORT, 'no room'); END;
         CREATE TRIGGER no_drop BEFORE UPDATE OF waiting_since ON runs BEGIN
             SELECT RAISE(ABORT, 'no room'); END;
         CREATE TRIGGER no_sweep BEFORE DELETE ON trials BEGIN
             SELECT RAISE(ABORT, 'no room'); END;",
    )
    .await;
    let data = folder.display().to_string();
    let mut serve = command(&["serve", "--desk", "--no-resume", "--twin-workers", "0"]);
    serve.args(["--bind", "127.0.0.1:0", "--data", &data]).stderr(Stdio::piped());
    let (mut service, url) = served(&mut serve);
    let mut log = BufReader::new(service.0.stderr.take().unwrap()).lines().map(Result::unwrap);
    let mut logged = |one: &str, other: &str| {
        let found = log.find(|line| line.contains(one) || line.contains(other)).unwrap();
        assert!(found.contains(one), "{found}");
    };
    logged(
        "what an import has left is removed at the next start",
        "the earlier runs are not taken over yet",
    );
    let (not_yet, in_memory) =
        ("the earlier runs are not taken over yet", "a waiting run is dropped in memory only");
    logged(not_yet, in_memory);
    execute(&folder, "DROP TRIGGER no_mark;").await;
    logged(not_yet, in_memory);
    let client = http();
    let run =
        async |scan_id: u32| answered(client.get(format!("{url}/api/v1/runs/{scan_id}"))).await.1;
    // The next process must find why the other run does not begin.
    assert_eq!(run(2).await["state"], "running");
    execute(&folder, "DROP TRIGGER no_drop;").await;
    until("the mark", LIMIT, async || run(2).await, |run| run["state"] == "interrupted").await;
    assert!(run(3).await["waiting_since"].is_null());
}
