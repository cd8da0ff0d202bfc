//! Folders in which a worker makes chunks; those of a worker that was killed are removed by the next one.
//! Uses: std's files and their locks, `store` for a name. Never: a result, which is in the store; a folder removed that
//! no worker has made.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, SystemTime};

use crate::store::INPUTS;
use crate::{WorkerError, WorkerResult};

/// Prefix of the folder of one worker.
const PREFIX: &str = "palpate-worker-";
/// Random characters after it.
const RANDOM: usize = 6;
/// File in it that its worker keeps locked.
const LOCK: &str = "lock";
/// Name of this file until it is locked.
const NEW_LOCK: &str = "lock.new";
/// Prefix of the folder of one slot in it.
const SLOT: &str = "slot-";
/// Age of a folder without lock file from which on it is neither being made nor being removed.
const UNLOCKED_MAX: Duration = Duration::from_secs(3600);
/// Attempts to remove the folder of this worker, and the pause between two: a write that has begun may still end.
const REMOVALS: (usize, Duration) = (20, Duration::from_millis(50));

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
        sweep(parent, SystemTime::now());
        let failed = || WorkerError::file(parent);
        let mut named = tempfile::Builder::new();
        let folder = named.prefix(PREFIX).rand_bytes(RANDOM).tempdir_in(parent).map_err(failed())?;
        // A lock file under its name is locked from the beginning: no other worker finds it free.
        let new = folder.path().join(NEW_LOCK);
        let lock = File::create(&new).map_err(failed())?;
        lock.lock().map_err(failed())?;
        fs::rename(&new, folder.path().join(LOCK)).map_err(failed())?;
        Ok(Self { folder, _lock: lock })
    }

    /// Path of the folder of one slot, which the slot makes.
    pub fn slot(&self, slot: usize) -> PathBuf {
        self.folder.path().join(format!("{SLOT}{slot}"))
    }

    /// Path of the folder of the inputs, which the first slot that needs it makes.
    pub fn inputs(&self) -> PathBuf {
        self.folder.path().join(INPUTS)
    }

    /// Its random part, by which two workers of a machine differ.
    pub fn name(&self) -> String {
        let name = self.folder.path().file_name().map(|name| name.to_string_lossy().into_owned());
        name.unwrap_or_default().trim_start_matches(PREFIX).to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let (removals, pause) = REMOVALS;
        for _ in 0..removals {
            match fs::remove_dir_all(self.folder.path()) {
                Err(_) if self.folder.path().exists() => sleep(pause),
                Ok(()) | Err(_) => return,
            }
        }
        tracing::warn!(folder = %self.folder.path().display(), "the folder of this worker remains");
    }
}

/// Removes the folders of workers that have ended.
fn sweep(parent: &Path, now: SystemTime) {
    let Ok(entries) = fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let (folder, name) = (entry.path(), entry.file_name());
        let random = name.to_str().and_then(|name| name.strip_prefix(PREFIX));
        if !random.is_some_and(is_random) {
            continue;
        }
        let lock = match File::open(folder.join(LOCK)) {
            Ok(lock) if lock.try_lock().is_ok() => Some(lock),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                if !is_left(&folder, now) {
                    continue;
                }
                None
            }
            Ok(_) | Err(_) => continue,
        };
        if let Err(error) = fs::remove_dir_all(&folder) {
            tracing::warn!(folder = %folder.display(), %error, "a folder of an ended worker remains");
        }
        drop(lock);
    }
}

/// Whether this is the random part of a worker's folder.
fn is_random(text: &str) -> bool {
    text.len() == RANDOM && text.bytes().all(|byte| byte.is_ascii_alphanumeric())
}

/// Whether a folder without a lock file is the remainder of a worker's: it is old, and has nothing but what a worker
/// makes. A program whose worker was killed makes such a folder again if it writes after the removal.
fn is_left(folder: &Path, now: SystemTime) -> bool {
    let Ok(about) = fs::symlink_metadata(folder) else { return false };
    let age = about.modified().ok().and_then(|modified| now.duration_since(modified).ok());
    let is_old = about.is_dir() && age.is_some_and(|age| age > UNLOCKED_MAX);
    let Some(mut entries) = fs::read_dir(folder).ok().filter(|_| is_old) else { return false };
    entries.all(|entry| {
        let Ok(name) = entry.map(|entry| entry.file_name()) else { return false };
        let name = name.to_str().unwrap_or_default();
        let slot = name.strip_prefix(SLOT).unwrap_or_default();
        name == INPUTS || name == NEW_LOCK || slot.parse::<usize>().is_ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Scratch {
        fn path(&self) -> PathBuf {
            self.folder.path().to_owned()
        }
    }

    #[test]
    fn the_folder_of_an_ended_worker_is_removed_and_that_of_a_running_one_kept() {
        let parent = tempfile::tempdir().unwrap();
        let running = Scratch::create(parent.path()).unwrap();
        let ended = parent.path().join(format!("{PREFIX}ended1"));
        // A release that was unpacked may have such a file, too.
        let others = ["other", "palpate-worker-0.1.0"].map(|name| parent.path().join(name));
        for folder in others.iter().chain([&ended]) {
            fs::create_dir(folder).unwrap();
            fs::write(folder.join(LOCK), "").unwrap();
        }
        let next = Scratch::create(parent.path()).unwrap();
        assert!(running.path().exists() && next.path().exists() && !ended.exists());
        assert!(others.iter().all(|other| other.exists()), "{others:?}");
        let path = next.path();
        drop(next);
        assert!(!path.exists());
    }

    #[test]
    fn a_folder_without_lock_is_removed_once_it_is_old_if_a_worker_has_made_it() {
        let parent = tempfile::tempdir().unwrap();
        let make = |name: &str, within: &str| {
            let folder = parent.path().join(name);
            fs::create_dir_all(folder.join(within)).unwrap();
            folder
        };
        let again = make("palpate-worker-a1B2c3", "slot-0/order/results");
        fs::write(again.join("slot-0/order/results/key.parquet"), "late").unwrap();
        let began = make("palpate-worker-d4E5f6", "inputs");
        fs::write(began.join(NEW_LOCK), "").unwrap();
        // A release that was unpacked; a checkout whose name happens to fit; files.
        let others = [
            make("palpate-worker-0.1.0-linux", "slot-0"),
            make("palpate-worker-source", "src"),
            make("palpate-worker-slotty", "slot-machine"),
        ];
        let file = parent.path().join("palpate-worker-g7H8i9");
        fs::write(&file, "").unwrap();
        let now = SystemTime::now();
        sweep(parent.path(), now);
        assert!(again.exists() && began.exists(), "one that is being made is kept");
        sweep(parent.path(), now + UNLOCKED_MAX * 2);
        assert!(!again.exists() && !began.exists());
        assert!(file.exists() && others.iter().all(|other| other.exists()), "{others:?}");
    }

    #[test]
    fn the_folder_is_removed_although_a_write_ends_meanwhile() {
        let parent = tempfile::tempdir().unwrap();
        let scratch = Scratch::create(parent.path()).unwrap();
        let slot = scratch.slot(0);
        fs::create_dir(&slot).unwrap();
        let writer = std::thread::spawn(move || {
            for number in 0..200 {
                if fs::write(slot.join(number.to_string()), "late").is_err() {
                    break;
                }
            }
        });
        drop(scratch);
        writer.join().unwrap();
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
