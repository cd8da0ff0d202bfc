//! Folders in which a worker makes chunks; those of a worker that was killed are removed by the next one.
//! Uses: std's files and their locks. Never: a result, which is in the store.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::{WorkerError, WorkerResult};

/// Prefix of the folder of one worker.
const PREFIX: &str = "palpate-worker-";
/// File in it that its worker keeps locked.
const LOCK: &str = "lock";

/// The folder of this worker, removed with it.
#[derive(Debug)]
pub struct Scratch {
    folder: tempfile::TempDir,
    _lock: File,
}

impl Scratch {
    /// Makes a folder in `parent`, and removes those whose worker has ended.
    ///
    /// # Errors
    /// `WorkerError::File` if the folder cannot be made.
    pub fn create(parent: &Path) -> WorkerResult<Self> {
        fs::create_dir_all(parent).map_err(WorkerError::file(parent))?;
        sweep(parent);
        let failed = || WorkerError::file(parent);
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent).map_err(failed())?;
        let lock = File::create(folder.path().join(LOCK)).map_err(failed())?;
        lock.lock().map_err(failed())?;
        Ok(Self { folder, _lock: lock })
    }

    /// Its random part, by which two workers of a machine differ.
    pub fn name(&self) -> String {
        let name = self.folder.path().file_name().map(|name| name.to_string_lossy().into_owned());
        name.unwrap_or_default().trim_start_matches(PREFIX).to_owned()
    }

    /// Path of the folder, which is removed with this value.
    pub fn path(&self) -> PathBuf {
        self.folder.path().to_owned()
    }
}

/// Removes the folders whose lock is free. One without a lock file is being made or removed.
fn sweep(parent: &Path) {
    let Ok(entries) = fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let is_ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(PREFIX));
        let Some(lock) = is_ours.then(|| File::open(entry.path().join(LOCK)).ok()).flatten() else {
            continue;
        };
        if lock.try_lock().is_ok()
            && let Err(error) = fs::remove_dir_all(entry.path())
        {
            tracing::warn!(folder = %entry.path().display(), %error, "a folder of an ended worker remains");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_an_ended_worker_is_removed_and_that_of_a_running_one_kept() {
        let parent = tempfile::tempdir().unwrap();
        let running = Scratch::create(parent.path()).unwrap();
        let ended = parent.path().join(format!("{PREFIX}ended"));
        let other = parent.path().join("other");
        for folder in [&ended, &other] {
            fs::create_dir(folder).unwrap();
            fs::write(folder.join(LOCK), "").unwrap();
        }
        let next = Scratch::create(parent.path()).unwrap();
        assert!(
            running.path().exists() && next.path().exists() && other.exists() && !ended.exists()
        );
        let path = next.path();
        drop(next);
        assert!(!path.exists());
    }
}
