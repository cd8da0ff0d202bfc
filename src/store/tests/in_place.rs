//! A database that is only read, where it is: nothing is written next to it unless another process writes it, and other
//! versions are recognised.
//! Uses: `store`. Never: the permissions of a folder, which root does not have to respect.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::{Folder, execute, fresh, hex_trial, new_run, open, with_run};
use crate::clock::Clock;
use crate::journal::Journal;
use crate::{RunKind, Sharing, Soundness, Store, StoreError, TrialQuery};

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = folder.read_dir().unwrap().map(|entry| entry.unwrap().path());
    paths.map(|path| (path.clone(), std::fs::read(path).unwrap())).collect()
}

#[tokio::test]
async fn a_database_is_read_in_place_and_nothing_is_written() {
    let folder = Folder::new();
    // Letters that have a meaning in the addresses of SQLite.
    let data = folder.0.path().join("100%41 of it? #1&2");
    std::fs::create_dir(&data).unwrap();
    let database = data.join("palpate.db");
    let store = open(&database).await;
    let run = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
    store.trial(run, &hex_trial(0, 0, &[9.0, 7.5])).await.unwrap();
    store.close().await;
    let before = files(&data);
    assert!(Store::is_current(&database, Sharing::Unchanged).await);

    let path = folder.0.path().join("elsewhere.db");
    let store =
        Store::read_in_place(&database, Sharing::Unchanged, &path, Clock::new(1.0)).await.unwrap();
    assert_eq!(store.path(), path);
    let query = TrialQuery { limit: 9, ..TrialQuery::default() };
    assert_eq!(store.trials(&query).await.unwrap().len(), 1);
    assert!(store.run(run).await.unwrap().is_some());
    assert_eq!(store.examine(2000).await.unwrap(), Soundness::Sound);
    let refused = store.set_lock("Ada", "").await;
    assert!(matches!(refused, Err(StoreError::ReadOnly { .. })), "{refused:?}");
    store.close().await;
    assert!(files(&data) == before && !path.exists());
}

#[tokio::test]
async fn a_database_is_read_with_its_log_while_it_is_written() {
    let (folder, store, run) = with_run(RunKind::RealHex).await;
    store.trial(run, &hex_trial(0, 0, &[9.0, 7.5])).await.unwrap();
    let (database, path) = (folder.file(), folder.0.path().join("elsewhere.db"));
    assert!(Store::is_current(&database, Sharing::Written).await);
    let reading =
        Store::read_in_place(&database, Sharing::Written, &path, Clock::new(1.0)).await.unwrap();
    let query = TrialQuery { limit: 9, ..TrialQuery::default() };
    assert_eq!(reading.trials(&query).await.unwrap().len(), 1);
    store.trial(run, &hex_trial(0, 1, &[9.0, 7.5])).await.unwrap();
    assert_eq!(reading.trials(&query).await.unwrap().len(), 2);
    let refused = reading.set_lock("Ada", "").await;
    assert!(matches!(refused, Err(StoreError::ReadOnly { .. })), "{refused:?}");
    // The process that writes ends first, and the next one begins.
    store.close().await;
    let store = open(&database).await;
    store.trial(run, &hex_trial(0, 2, &[9.0, 7.5])).await.unwrap();
    assert_eq!(reading.trials(&query).await.unwrap().len(), 3);
    reading.close().await;
    store.close().await;
}

async fn is_current(folder: &Folder) -> bool {
    Store::is_current(&folder.file(), Sharing::Unchanged).await
}

#[tokio::test]
async fn only_a_database_of_this_version_is_current() {
    let folder = Folder::new();
    assert!(!is_current(&folder).await, "there is none");
    folder.make_before(26, &[]).await;
    let before = files(folder.0.path());
    assert!(!is_current(&folder).await, "it is older");
    assert!(files(folder.0.path()) == before);
    open(&folder.file()).await.close().await;
    assert!(is_current(&folder).await, "it is migrated");

    let (folder, store) = fresh().await;
    execute(
        &store,
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
         VALUES (9999, 'of a newer version', TRUE, x'00', 0)",
    )
    .await;
    store.close().await;
    assert!(!is_current(&folder).await, "it is newer");
}
