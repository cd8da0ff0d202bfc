//! What other users of the machine can read of a data folder: nothing.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::filled::{Filled, fill, folder};

fn below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            below(&path, found);
        }
        found.push(path);
    }
}

#[tokio::test]
async fn other_users_can_read_nothing_that_the_service_writes() {
    let data = folder("private");
    std::fs::set_permissions(&data, Permissions::from_mode(0o755)).unwrap();
    fill(&data).await;
    let lab = Filled::serve(data.clone()).await;
    let asked =
        lab.posted("/api/v1/exports", json!({ "dataset": "real", "format": "csv" }), 202).await;
    assert_eq!(lab.over(asked["id"].as_str().unwrap()).await["state"], "done");
    let mut found = vec![data];
    below(&found[0].clone(), &mut found);
    for name in ["palpate.db", "palpate.db-wal", "palpate.db-shm", "palpate.lock", "exports"] {
        assert!(found.iter().any(|path| path.ends_with(name)), "{name} of {found:?}");
    }
    assert!(found.iter().any(|path| path.extension().is_some_and(|e| e == "parquet")));
    for path in found {
        let mode = path.metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{}: {mode:o}", path.display());
    }
    lab.close().await;
}
