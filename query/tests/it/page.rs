//! The examples of the manual of SQL.
//! Uses: `common`, `docs/query-sql.md`. Never: an example that is not run.

use crate::common::{BOUNDS, Bounds, Folder, Outcome, Trials, ask, tables};

const DOCUMENT: &str = include_str!("../../../docs/query-sql.md");

/// The lines of the blocks of SQL.
fn examples() -> Vec<&'static str> {
    let mut inside = false;
    let mut found = Vec::new();
    for line in DOCUMENT.lines() {
        if line.starts_with("```") {
            inside = line == "```sql";
        } else if inside {
            found.push(line);
        }
    }
    found
}

#[test]
fn every_example_of_the_page_has_rows() {
    let folder = Folder::new("page");
    let path = folder.file("a.parquet");
    Trials { first: 0, count: 200, channels: 16, without_twin: 10 }.write(&path);
    let known = tables(&[path], "run-3");
    let examples = examples();
    assert!(examples.len() > 50, "{}", examples.len());
    let mut failures = Vec::new();
    // One thread: as the service asks during a run.
    for threads in [2, 1] {
        let bounds = Bounds { threads, ..BOUNDS };
        failures.extend(examples.iter().filter_map(|sql| match ask(sql, &known, bounds) {
            Outcome::Rows(rows) if rows.height() > 0 => None,
            other => Some(format!("{sql}, {threads} threads\n    {other:?}")),
        }));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
