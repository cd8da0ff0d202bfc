//! Files that orders name by their sha256, such as datasets: a worker fetches each once, for all of its slots.
//! Uses: `store`, files of std and tokio. Never: a file that was not compared with its hash.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::fs;
use tokio::sync::Mutex;

use crate::store::{INPUTS, Store};
use crate::{WorkerError, WorkerResult};

/// The inputs that a worker has, in a folder on the file system of its slots.
#[derive(Debug, Clone)]
pub struct Inputs(Arc<Mutex<PathBuf>>);

impl Inputs {
    /// Inputs in a folder, which no other worker uses.
    pub fn new(folder: PathBuf) -> Self {
        Self(Arc::new(Mutex::new(folder)))
    }

    /// Links files into the folder of an order. Those that no slot has are fetched; other slots wait meanwhile.
    ///
    /// # Errors
    /// `WorkerError::Failed` if the store does not have a file, or has other bytes; `Store` if it does not answer; `File`
    /// if the disk fails.
    pub async fn link(&self, store: &Store, files: &[String], order: &Path) -> WorkerResult<()> {
        let into = order.join(INPUTS);
        for sha256 in files {
            let there = into.join(sha256);
            if fs::try_exists(&there).await.map_err(WorkerError::file(&there))? {
                continue;
            }
            let folder = self.0.lock().await;
            let here = folder.join(sha256);
            if !fs::try_exists(&here).await.map_err(WorkerError::file(&here))? {
                // Not by another thread, which could make it again after that of the worker was removed.
                std::fs::create_dir_all(&*folder).map_err(WorkerError::file(&*folder))?;
                let partial = here.with_extension("partial");
                if let Err(error) = store.fetch_input(sha256, &partial).await {
                    // On a full disk, its space is that of the results.
                    drop(fs::remove_file(&partial).await);
                    return Err(error);
                }
                fs::rename(&partial, &here).await.map_err(WorkerError::file(&here))?;
            }
            std::fs::create_dir_all(&into).map_err(WorkerError::file(&into))?;
            fs::hard_link(&here, &there).await.map_err(WorkerError::file(&there))?;
        }
        Ok(())
    }

    /// Removes the files that are linked into no folder of an order.
    pub async fn sweep(&self) {
        let folder = self.0.lock().await;
        let Ok(mut entries) = fs::read_dir(&*folder).await else { return };
        while let Ok(Some(entry)) = entries.next_entry().await {
            if entry.metadata().await.is_ok_and(|about| about.nlink() == 1) {
                drop(fs::remove_file(entry.path()).await);
            }
        }
    }
}
