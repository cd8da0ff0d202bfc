//! A data folder whose run was killed, and where another run waits: a command that looks at it leaves both to the next
//! service.

use std::path::Path;

use sqlx::Connection;

use crate::datasets::filled::store;
use crate::old_data::copy;
use crate::support::{Folder, command, database, done, execute, finished, succeeded};

/// A folder with a killed run, 2, that may resume automatically, and one that waits, 3.
async fn killed(name: &str) -> Folder {
    let folder = copy(name);
    store(&folder).await.close().await;
    let waits = "UPDATE runs SET waiting_since = '2026-11-20T18:00:00.000Z' WHERE scan_id = 3;";
    execute(&folder, waits).await;
    folder
}

/// The stored state of runs 2 and 3, and whether each waits for its turn.
async fn stored(data: &Path) -> Vec<(String, i64)> {
    let mut file = database(data).await;
    let query =
        "SELECT state, waiting_since IS NOT NULL FROM runs WHERE scan_id > 1 ORDER BY scan_id";
    let found: Vec<(String, i64)> = sqlx::query_as(query).fetch_all(&mut file).await.unwrap();
    file.close().await.unwrap();
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_look_at_the_data_leaves_the_runs_to_the_next_service() {
    let folder = killed("looked-at").await;
    let data = folder.display().to_string();
    let look = async |arguments: &[&str]| {
        let mut look = command(arguments);
        look.args(["--data", &data]);
        finished(look).await
    };
    // What it shows is right: nothing drives the run.
    let listed = done(&look(&["runs", "--state", "interrupted", "--json"]).await);
    assert_eq!(listed["items"].as_array().unwrap().len(), 1, "{listed:#}");
    let shown = succeeded(&look(&["show", "2"]).await);
    assert!(shown.contains("interrupted"), "{shown}");
    let queue = succeeded(&look(&["queue"]).await);
    assert!(queue.contains("next"), "{queue}");
    assert_eq!(stored(&folder).await, [("running".to_owned(), 0), ("queued".to_owned(), 1)]);
}
