//! The connections that read many rows: each read is a view of the file, and ends with its caller.
//! Uses: `core::bulk`, rusqlite. Never: the tables of the store.

use std::sync::mpsc;
use std::time::Duration;

use rusqlite::Connection;
use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use super::Folder;
use crate::core::bulk::{BULK_CONNECTIONS, Bulk, Statement};
use crate::{StoreError, StoreResult};

const COUNTING: &str = "counting numbers";

/// A file in the journal mode of the store with the numbers 1 to 1000, its folder, and connections that read it.
fn numbers() -> (Folder, Connection, Bulk) {
    let folder = Folder::new();
    let writer = Connection::open(folder.file()).unwrap();
    writer.pragma_update(None, "journal_mode", "WAL").unwrap();
    let fill = "CREATE TABLE numbers (n INTEGER PRIMARY KEY, word TEXT, half REAL);
        WITH RECURSIVE up(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM up WHERE n < 1000)
        INSERT INTO numbers SELECT n, 'no ' || n, n / 2.0 FROM up;";
    writer.execute_batch(fill).unwrap();
    let bulk = Bulk::new(&folder.file(), Duration::from_secs(5));
    (folder, writer, bulk)
}

fn count(connection: &Connection) -> StoreResult<i64> {
    let counting = Statement::new("SELECT count(*) AS n FROM numbers");
    let counts: Vec<i64> = counting.rows(connection, COUNTING, |c| c.get("n"))?;
    Ok(counts[0])
}

#[tokio::test]
async fn values_are_read_by_their_names_in_any_order() {
    let (_folder, _writer, bulk) = numbers();
    let mut query = Statement::new("SELECT n, word, half, NULL AS none FROM numbers WHERE n > ");
    query.bind(2_i64).push(" AND word <> ").bind("no 4".to_owned()).push(" ORDER BY n LIMIT 4");
    let read = move |connection: &Connection| {
        query.rows(connection, COUNTING, |c| {
            assert!(c.has("half") && !c.has("third"));
            let (half, n): (f64, i64) = (c.get("half")?, c.get("n")?);
            // The order differs from row to row, and a column is read twice.
            let odd: Option<i64> = if n % 2 == 1 { c.get("n")? } else { c.get("none")? };
            let word: String = c.get("word")?;
            assert_eq!(c.get::<&str>("word")?, word);
            Ok((n, half, word, odd))
        })
    };
    let rows = bulk.read(COUNTING, read).await.unwrap();
    let of = |n: i64| (n, n as f64 / 2.0, format!("no {n}"), (n % 2 == 1).then_some(n));
    assert_eq!(rows, [of(3), of(5), of(6), of(7)]);
}

#[tokio::test]
async fn a_column_that_is_missing_or_of_another_type_is_an_error() {
    let (_folder, _writer, bulk) = numbers();
    for (text, named) in [
        ("SELECT n FROM numbers", "Invalid column name: word"),
        ("SELECT word FROM numbers", "name: word"),
        ("SELECT n AS word FROM absent", "no such table: absent"),
    ] {
        let read = move |connection: &Connection| {
            Statement::new(text).rows(connection, COUNTING, |c| c.get::<i64>("word"))
        };
        let error = bulk.read(COUNTING, read).await.unwrap_err();
        let StoreError::Read { operation: COUNTING, source } = &error else { panic!("{error:?}") };
        assert!(source.to_string().contains(named), "{source}");
    }
    assert_eq!(bulk.read(COUNTING, count).await.unwrap(), 1000);
}

#[tokio::test]
async fn a_read_is_a_view_of_the_file_and_writes_nothing() {
    let (_folder, writer, bulk) = numbers();
    let read = move |connection: &Connection| {
        let before = count(connection)?;
        writer.execute("DELETE FROM numbers WHERE n > 10", []).unwrap();
        let refused = connection.execute("DELETE FROM numbers", []).unwrap_err();
        Ok((before, count(connection)?, refused.to_string()))
    };
    let (before, after, refused) = bulk.read(COUNTING, read).await.unwrap();
    assert_eq!((before, after), (1000, 1000));
    assert!(refused.contains("readonly"), "{refused}");
    assert_eq!(bulk.read(COUNTING, count).await.unwrap(), 10);
}

#[tokio::test]
async fn a_statement_ends_when_its_caller_has_gone() {
    let (_folder, _writer, bulk) = numbers();
    let endless = |connection: &Connection| {
        let up = "WITH RECURSIVE up(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM up)
            SELECT max(n) AS n FROM up";
        Statement::new(up).rows(connection, COUNTING, |c| c.get::<i64>("n"))
    };
    for _ in 0..2 * BULK_CONNECTIONS {
        let reading = bulk.read(COUNTING, endless);
        assert!(timeout(Duration::from_millis(20), reading).await.is_err());
    }
    assert_eq!(bulk.read(COUNTING, count).await.unwrap(), 1000);
}

#[tokio::test]
async fn a_panic_is_that_of_the_caller_and_takes_no_connection() {
    let (_folder, _writer, bulk) = numbers();
    for _ in 0..=BULK_CONNECTIONS {
        let bulk = bulk.clone();
        let panicking = tokio::spawn(async move {
            let work = |_: &Connection| -> StoreResult<()> { panic!("made up") };
            bulk.read(COUNTING, work).await
        });
        assert!(panicking.await.unwrap_err().is_panic());
    }
    assert_eq!(bulk.read(COUNTING, count).await.unwrap(), 1000);
}

/// Starts a read that waits for the returned sender, and waits until it is in progress.
async fn waiting(bulk: &Bulk) -> (mpsc::Sender<()>, tokio::task::JoinHandle<StoreResult<i64>>) {
    let ((end, ended), (started, begun)) = (mpsc::channel(), oneshot::channel());
    let bulk = bulk.clone();
    let reading = tokio::spawn(async move {
        let work = move |connection: &Connection| {
            started.send(()).unwrap();
            ended.recv().unwrap();
            count(connection)
        };
        bulk.read(COUNTING, work).await
    });
    begun.await.unwrap();
    (end, reading)
}

#[tokio::test]
async fn one_read_more_than_connections_waits_and_a_read_apart_does_not() {
    let (_folder, _writer, bulk) = numbers();
    let mut reads = Vec::new();
    for _ in 0..BULK_CONNECTIONS {
        reads.push(waiting(&bulk).await);
    }
    let more = bulk.read(COUNTING, count);
    assert!(timeout(Duration::from_millis(50), more).await.is_err());
    assert_eq!(bulk.read_apart(COUNTING, count).await.unwrap(), 1000);
    let more = tokio::spawn({
        let bulk = bulk.clone();
        async move { bulk.read(COUNTING, count).await }
    });
    for (end, reading) in reads {
        end.send(()).unwrap();
        assert_eq!(reading.await.unwrap().unwrap(), 1000);
    }
    assert_eq!(more.await.unwrap().unwrap(), 1000);
}

#[tokio::test]
async fn closing_waits_for_reads_and_refuses_further_ones() {
    let (_folder, _writer, bulk) = numbers();
    let (end, reading) = waiting(&bulk).await;
    let closing = tokio::spawn({
        let bulk = bulk.clone();
        async move { bulk.close().await }
    });
    sleep(Duration::from_millis(50)).await;
    assert!(!closing.is_finished());
    end.send(()).unwrap();
    assert_eq!(reading.await.unwrap().unwrap(), 1000);
    closing.await.unwrap();
    let closed = [bulk.read(COUNTING, count).await, bulk.read_apart(COUNTING, count).await];
    for refused in closed {
        assert!(matches!(refused, Err(StoreError::Closed { .. })), "{refused:?}");
    }
}
