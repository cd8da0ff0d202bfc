//! The file itself: merged migrations that never change, pragmas, readers that cannot write.
//! Uses: `store`. Never: values that depend on the machine.

use sqlx::Row;

use super::{Folder, findings, fresh, is_intact, open};
use crate::core::store::PAGE_BYTES;
use crate::digest::sha256_hex;
use crate::table::{Of, TABLE};

/// `migrations/SHA256SUMS` holds the sha256 of each merged migration. A line is added, never changed:
/// `UPDATE=1` adds the line of a new file.
#[test]
fn migrations_only_grow_and_are_all_in_the_binary() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../migrations");
    let mut files: Vec<(String, String)> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "sql"))
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.starts_with("--"), "{} does not say why", path.display());
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            (name, sha256_hex(&text))
        })
        .collect();
    files.sort();
    let sums = folder.join("SHA256SUMS");
    let mut merged = std::fs::read_to_string(&sums).unwrap();
    if std::env::var_os("UPDATE").is_some() {
        for (name, sum) in &files {
            if !merged.contains(name) {
                merged += &format!("{sum}  {name}\n");
            }
        }
        std::fs::write(&sums, &merged).unwrap();
    }
    let found: String = files.iter().map(|(name, sum)| format!("{sum}  {name}\n")).collect();
    assert_eq!(found, merged, "a new migration: UPDATE=1 cargo test migrations_only_grow");
}

#[tokio::test]
async fn the_writer_is_durable_and_the_file_is_laid_out_as_stated() {
    let (_folder, store) = fresh().await;
    let asked = store
        .write("asking", async |c| {
            let mut answers = Vec::new();
            for pragma in ["page_size", "synchronous", "foreign_keys", "busy_timeout"] {
                let sql = sqlx::AssertSqlSafe(format!("PRAGMA {pragma}"));
                let row = sqlx::query(sql).fetch_one(&mut *c).await.unwrap();
                answers.push(row.get::<i64, _>(0));
            }
            let mode: String =
                sqlx::query_scalar("PRAGMA journal_mode").fetch_one(c).await.unwrap();
            Ok((answers, mode))
        })
        .await
        .unwrap();
    // synchronous 2 is FULL.
    assert_eq!(asked, (vec![i64::from(PAGE_BYTES), 2, 1, 5000], "wal".to_owned()));
}

#[tokio::test]
async fn a_reader_cannot_write() {
    let (_folder, store) = fresh().await;
    let tried = sqlx::query("INSERT INTO operator_lock VALUES (1, 'a', 'b', 'c')")
        .execute(&store.inner.readers)
        .await;
    let error = tried.unwrap_err().to_string();
    assert!(error.contains("readonly"), "{error}");
    assert_eq!(store.lock().await.unwrap(), None);
    let taken = store.set_lock("Ada", "").await.unwrap();
    assert_eq!(store.lock().await.unwrap(), Some(taken));
}

#[tokio::test]
async fn it_opens_again_and_refuses_to_be_used_when_closed() {
    let (folder, store) = fresh().await;
    let kept = store.set_lock("Ada", "kept").await.unwrap();
    store.close().await;
    assert!(store.set_lock("Ada", "lost").await.is_err());
    assert!(store.lock().await.is_err());
    let again = open(&folder.file()).await;
    assert_eq!(again.lock().await.unwrap(), Some(kept));
    is_intact(&again).await;
    assert!(again.free_bytes().await.unwrap() > 0);
}

#[tokio::test]
async fn damage_is_found() {
    let (folder, store) = fresh().await;
    let root: i64 = sqlx::query_scalar("SELECT rootpage FROM sqlite_schema WHERE name = 'events'")
        .fetch_one(&store.inner.readers)
        .await
        .unwrap();
    store.close().await;
    let mut bytes = std::fs::read(folder.file()).unwrap();
    let page = PAGE_BYTES as usize;
    // The type byte and the cell count of the b-tree header of a table's page.
    let at = (root as usize - 1) * page;
    bytes[at..at + 8].fill(0xA5);
    std::fs::write(folder.file(), bytes).unwrap();
    let again = open(&folder.file()).await;
    assert!(!findings(&again).await.is_empty());
}

#[tokio::test]
async fn a_file_that_is_no_database_is_named() {
    let folder = Folder::new();
    std::fs::write(folder.file(), b"this is not a database, not at all, no").unwrap();
    let error = crate::Store::open(&folder.file(), crate::clock::Clock::new(1.0)).await;
    let Err(error) = error else { panic!("it opened") };
    assert!(error.to_string().contains("palpate.sqlite"), "{error}");
}

#[test]
fn its_futures_may_move_between_threads() {
    fn movable<T: Send>(_: T) {}
    let folder = Folder::new();
    let path = folder.file();
    movable(crate::Store::open(&path, crate::clock::Clock::new(1.0)));
    fn methods(store: &crate::Store, query: &crate::TrialQuery) {
        movable(store.trials(query));
        movable(store.set_lock("", ""));
        movable(store.examine(1));
        movable(store.close());
    }
    let _ = methods;
}

/// Conditions and the examination take the bounds of a column by its name.
#[tokio::test]
async fn blocks_bound_every_column_that_conditions_compare() {
    let (_folder, store) = fresh().await;
    let sql = "SELECT name FROM pragma_table_info(?)";
    let columns = async |of: &'static str| -> Vec<String> {
        sqlx::query_scalar(sql).bind(of).fetch_all(&store.inner.readers).await.unwrap()
    };
    let mut names = columns("trial_blocks").await;
    assert_eq!(columns("trial_bounds").await, names, "from which wrong bounds are computed again");
    names.sort();
    let bounded = TABLE.iter().filter(|column| column.has_bounds()).map(|column| column.name);
    let bounds = |name: &str| [format!("{name}_least"), format!("{name}_most")];
    let mut expected: Vec<String> = bounded.chain(["flags"]).flat_map(bounds).collect();
    expected.push("block".into());
    expected.sort();
    assert_eq!(names, expected);
}

/// Other programs read the database by views whose columns are those of the API.
#[tokio::test]
async fn the_views_have_the_columns_of_the_api() {
    let (_folder, store) = fresh().await;
    let columns = async |view: &str| -> Vec<String> {
        let sql = format!("SELECT name FROM pragma_table_info('{view}')");
        let names = sqlx::query_scalar(sqlx::AssertSqlSafe(sql));
        names.fetch_all(&store.inner.readers).await.unwrap()
    };
    let stored: Vec<&str> = TABLE
        .iter()
        .filter(|column| !column.sql.is_empty() || matches!(column.of, Of::Flags))
        .map(|column| column.name)
        .collect();
    assert_eq!(columns("trials_flat").await, stored);
    assert_eq!(columns("runs_flat").await[..3], ["scan_id", "run", "experiment"]);
    for view in ["trials_flat", "runs_flat"] {
        let sql = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {view}"));
        let rows: i64 = sqlx::query_scalar(sql).fetch_one(&store.inner.readers).await.unwrap();
        assert_eq!(rows, 0);
    }
}
