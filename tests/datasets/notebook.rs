//! The tools of a notebook against a service: pandas, polars, DuckDB, pyarrow and numpy, value by value
//! beside the database. Without them the test says that it was left out; with
//! `PALPATE_REQUIRE_TOOLS=1` it fails instead.

use std::process::{Command, Stdio};

use crate::filled::Filled;

/// A Python that has them, if there is one.
fn python() -> Option<String> {
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&python)
        .args(["-c", "import pandas, polars, duckdb, pyarrow, numpy"])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    found.then_some(python)
}

#[tokio::test(flavor = "multi_thread")]
async fn every_tool_reads_what_the_database_holds() {
    let Some(python) = python() else {
        let missing = "pandas, polars, duckdb, pyarrow or numpy is missing";
        assert!(std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(), "{missing}");
        println!("LEFT OUT: {missing} (set PALPATE_PYTHON)");
        return;
    };
    let lab = Filled::open("notebook").await;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/datasets/check.py");
    let (url, database) = (lab.service.url(), lab.data.join("palpate.db"));
    let output = tokio::task::spawn_blocking(move || {
        Command::new(python).arg(script).arg(url).arg(database).output().unwrap()
    });
    let output = output.await.unwrap();
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    lab.close().await;
}
