//! The folder of a work order: `order.json`, and of each chunk its bytes and its row, or its last failure. Any
//! number of processes make chunks in it, on any machine that shares it.
//! Uses: std's files, `new_file`. Never: what a chunk contains.
//!
//! ```text
//! order.json            the work order
//! inputs/SHA256         a file that the order names, such as a dataset
//! results/KEY.parquet   the bytes of a chunk (its ending depends on the kind)
//! results/KEY.json      its row (`ChunkRow`), written when the bytes are durable: a chunk without it is not done
//! failed/KEY.json       its last failure (`FailedChunk`)
//! _lock                 locked, shared, by the processes that make chunks
//! ```
//! Both files of a chunk are new files (`new_file`): two processes that make the same chunk write the same bytes
//! under the same name. What killed processes left unfinished is removed by the next one that has the folder to
//! itself; on a file system without locks it remains.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{ChunkError, Gaps};
use super::order::{ChunkRow, FailedChunk, ORDER_FILE, WorkOrder};
use super::{MakeChunks, Tell};
use crate::commit;
use crate::difference::first_difference;
use crate::digest::sha256_hex;
use crate::new_file::{self, Finished, Look, NewFile};

/// Folder of the files that an order names.
const INPUTS: &str = "inputs";
/// Folder of the bytes and rows of chunks.
const RESULTS: &str = "results";
/// Folder of the last failures.
const FAILED_CHUNKS: &str = "failed";
/// File that the processes at work lock.
const WORK_LOCK: &str = "_lock";
/// Longest wait for a process that removes unfinished files.
const SWEEP_MAX: Duration = Duration::from_secs(30);
/// Interval of the attempts to lock the folder during this wait.
const SWEEP_POLL: Duration = Duration::from_millis(20);

/// The folder of a work order.
#[derive(Debug, Clone)]
pub struct OrderFolder {
    path: PathBuf,
    order: WorkOrder,
}

/// State of a chunk, as the files of the folder show it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ChunkState {
    /// It is done, and its file is whole as far as it was checked.
    Done(ChunkRow),
    /// Its row is invalid, or its file does not match it; with the reason.
    Damaged(String),
    /// It was not made, and the last attempt failed.
    Failed(FailedChunk),
    /// It was not made.
    Missing,
}

/// This process as one that makes chunks; others leave its unfinished files alone until it is dropped.
#[derive(Debug)]
pub struct AtWork {
    /// Owner of the lock; none on a file system without locks.
    _lock: Option<File>,
}

impl OrderFolder {
    /// Writes a work order into a folder, which is created if needed; returns whether it is new there.
    ///
    /// # Errors
    /// `OtherOrder` if the folder contains another one; `Order` if that one cannot be read, or this one would not be
    /// read as it is; `File` if it cannot be written.
    pub fn write(path: &Path, order: WorkOrder) -> Result<(Self, bool), ChunkError> {
        match Self::open(path) {
            Ok(there) => match first_difference(&there.order.identity(), &order.identity()) {
                None => return Ok((there, false)),
                Some(difference) => {
                    return Err(ChunkError::OtherOrder {
                        folder: path.into(),
                        field: difference.field,
                        there: difference.there,
                        here: difference.here,
                    });
                }
            },
            Err(ChunkError::NoOrder { .. }) => {}
            Err(error) => return Err(error),
        }
        let file = path.join(ORDER_FILE);
        let text = order.to_json().map_err(io::Error::from);
        let text = text.map_err(ChunkError::file("writing", &file))?;
        let order =
            WorkOrder::from_json(&text).map_err(|problem| ChunkError::order(path, problem))?;
        let folder = Self { path: path.into(), order };
        folder.make_folders()?;
        new_file::write(path, ORDER_FILE, text).map_err(ChunkError::file("writing", &file))?;
        Ok((folder, true))
    }

    /// Opens the folder of a work order.
    ///
    /// # Errors
    /// `NoOrder` if there is none; `Order` if this program does not make its chunks; `File` if it cannot be read.
    pub fn open(path: &Path) -> Result<Self, ChunkError> {
        let file = path.join(ORDER_FILE);
        let text = match fs::read(&file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(ChunkError::NoOrder { folder: path.into() });
            }
            text => text.map_err(ChunkError::file("reading", file))?,
        };
        let order =
            WorkOrder::from_json(&text).map_err(|problem| ChunkError::order(path, problem))?;
        Ok(Self { path: path.into(), order })
    }

    /// Its path, as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The work order that the folder was opened with.
    pub fn order(&self) -> &WorkOrder {
        &self.order
    }

    /// Path of the bytes of a chunk.
    pub fn result(&self, key: &str) -> PathBuf {
        self.path.join(RESULTS).join(self.order.bytes_name(key))
    }

    /// The bytes of a chunk; none if they do not have the sha256 of its row.
    ///
    /// # Errors
    /// `File` if they cannot be read.
    pub fn bytes(&self, row: &ChunkRow) -> Result<Option<Vec<u8>>, ChunkError> {
        let path = self.result(&row.key);
        let bytes = fs::read(&path).map_err(ChunkError::file("reading", path))?;
        Ok((sha256_hex(&bytes) == row.sha256).then_some(bytes))
    }

    /// Checks that no chunk of those that were gathered is damaged, which are given by their indexes.
    ///
    /// # Errors
    /// `Incomplete` if there are any.
    pub fn all_whole(&self, damaged: Vec<u64>) -> Result<(), ChunkError> {
        if damaged.is_empty() {
            return Ok(());
        }
        let why = |index| (index, "its bytes do not have the sha256 of its row".to_owned());
        let damaged = damaged.into_iter().map(why).collect();
        let gaps = Box::new(Gaps { damaged, ..Gaps::default() });
        Err(ChunkError::Incomplete { folder: self.path.clone(), gaps })
    }

    /// Registers this process as one that makes chunks. If there is no other one, what killed processes left
    /// unfinished is removed first.
    ///
    /// # Errors
    /// `File` if the folder cannot be written, cleaned or locked.
    pub fn at_work(&self) -> Result<AtWork, ChunkError> {
        self.make_folders()?;
        let path = self.path.join(WORK_LOCK);
        let failed = || ChunkError::file("locking", &path);
        let lock = File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let lock = lock.map_err(failed())?;
        match lock.try_lock() {
            Ok(()) => {
                for folder in [RESULTS, FAILED_CHUNKS].map(|name| self.path.join(name)) {
                    let failed = ChunkError::file("removing unfinished files in", &folder);
                    new_file::sweep(&folder).map_err(failed)?;
                }
                lock.unlock().map_err(failed())?;
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(error)) => {
                tracing::debug!(path = %path.display(), %error, "no locks here: nothing is removed");
                return Ok(AtWork { _lock: None });
            }
        }
        let until = Instant::now() + SWEEP_MAX;
        loop {
            match lock.try_lock_shared() {
                Ok(()) => return Ok(AtWork { _lock: Some(lock) }),
                Err(TryLockError::WouldBlock) if Instant::now() < until => {
                    std::thread::sleep(SWEEP_POLL);
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(failed()(io::ErrorKind::ResourceBusy.into()));
                }
                Err(TryLockError::Error(error)) => return Err(failed()(error)),
            }
        }
    }

    /// State of a chunk, its file checked as deeply as `look`.
    ///
    /// # Errors
    /// `Index` if there is no such chunk; `File` if an existing file cannot be read.
    pub fn state(&self, index: u64, look: Look) -> Result<ChunkState, ChunkError> {
        let last = self.order.chunks - 1;
        if index > last {
            return Err(ChunkError::Index { index, last });
        }
        let key = self.order.key(index);
        let (row_name, bytes_name) = (json_name(&key), self.order.bytes_name(&key));
        let row: ChunkRow = match self.read(RESULTS, &row_name)? {
            Some(Ok(row)) => row,
            Some(Err(why)) => {
                return Ok(ChunkState::Damaged(format!("{RESULTS}/{row_name}: {why}")));
            }
            None => {
                return Ok(match self.read(FAILED_CHUNKS, &row_name)? {
                    Some(Ok(failed)) => ChunkState::Failed(failed),
                    _ => ChunkState::Missing,
                });
            }
        };
        if row.key != key || row.index != index {
            let (found, of) = (&row.key, row.index);
            let why = format!("{RESULTS}/{row_name}: is of chunk {of} with the key {found}");
            return Ok(ChunkState::Damaged(why));
        }
        let path = self.result(&key);
        let whole = Finished { bytes: row.bytes, sha256: row.sha256.clone() };
        if whole.is_at(&path, look).map_err(ChunkError::file("reading", path))? {
            return Ok(ChunkState::Done(row));
        }
        let what = match look {
            Look::Length => format!("{} bytes", row.bytes),
            Look::Sha256 => format!("{} bytes of sha256 {}", row.bytes, row.sha256),
        };
        Ok(ChunkState::Damaged(format!("{RESULTS}/{bytes_name}: does not have its {what}")))
    }

    /// Makes a chunk, whether it is done or not; returns its row, or none if `tell` broke off.
    ///
    /// # Errors
    /// `Make` if its bytes cannot be made, `NotReproduced` if they differ from those of its row, `File` if they cannot
    /// be stored. The failure is stored, too, if possible.
    pub fn make(
        &self,
        index: u64,
        maker: &mut dyn MakeChunks,
        tell: &mut Tell<'_>,
    ) -> Result<Option<ChunkRow>, ChunkError> {
        let key = self.order.key(index);
        let made = self.make_bytes(index, &key, maker, tell);
        let stored = match &made {
            Ok(Some(_)) => self.forget_failure(&key),
            Ok(None) => Ok(()),
            Err(error) => self.store_failure(index, &key, error),
        };
        if let Err(error) = stored {
            tracing::warn!(index, %error, "the last failure of a chunk could not be stored or removed");
        }
        made
    }

    /// The rows of all chunks, their files checked by length.
    ///
    /// # Errors
    /// `Incomplete` if a chunk is missing or damaged, or a result belongs to no chunk; `File` if an existing file
    /// cannot be read.
    pub fn rows(&self) -> Result<Vec<ChunkRow>, ChunkError> {
        let mut gaps = Gaps { foreign: self.foreign()?, ..Gaps::default() };
        let mut rows = Vec::new();
        for index in 0..self.order.chunks {
            match self.state(index, Look::Length)? {
                ChunkState::Done(row) => rows.push(row),
                ChunkState::Damaged(why) => gaps.damaged.push((index, why)),
                ChunkState::Failed(_) | ChunkState::Missing => gaps.missing.push(index),
            }
        }
        match gaps.is_empty() {
            true => Ok(rows),
            false => {
                Err(ChunkError::Incomplete { folder: self.path.clone(), gaps: Box::new(gaps) })
            }
        }
    }

    /// Time at which a chunk was done, if it is.
    pub fn done_at(&self, key: &str) -> Option<SystemTime> {
        fs::metadata(self.path.join(RESULTS).join(json_name(key))).ok()?.modified().ok()
    }

    /// Files among the results that belong to no chunk of this order.
    fn foreign(&self) -> Result<Vec<String>, ChunkError> {
        let folder = self.path.join(RESULTS);
        let failed = || ChunkError::file("listing", &folder);
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(failed())?,
        };
        let keys = (0..self.order.chunks).map(|index| self.order.key(index));
        let names: BTreeSet<String> =
            keys.flat_map(|key| [self.order.bytes_name(&key), json_name(&key)]).collect();
        let mut foreign = Vec::new();
        for entry in entries {
            let name = entry.map_err(failed())?.file_name().to_string_lossy().into_owned();
            // Unfinished files, and those that NFS keeps for a process that has them open.
            let is_hidden = name.starts_with(['_', '.']);
            if !is_hidden && !names.contains(&name) {
                foreign.push(format!("{RESULTS}/{name}"));
            }
        }
        foreign.sort();
        Ok(foreign)
    }

    fn make_bytes(
        &self,
        index: u64,
        key: &str,
        maker: &mut dyn MakeChunks,
        tell: &mut Tell<'_>,
    ) -> Result<Option<ChunkRow>, ChunkError> {
        let started = Instant::now();
        let results = self.path.join(RESULTS);
        let out = NewFile::create(&results);
        let out = out.map_err(ChunkError::file("creating a file in", &results))?;
        let made = maker.write(index, out, tell);
        let Some((out, rows)) = made.map_err(|source| ChunkError::Make { index, source })? else {
            return Ok(None);
        };
        // A row that cannot be read has nothing to compare with.
        let before = self.read::<ChunkRow>(RESULTS, &json_name(key))?.and_then(Result::ok);
        let now = out.sha256();
        if let Some(ChunkRow { sha256: before, .. }) = before.filter(|row| row.sha256 != now) {
            let path = results.join(json_name(key));
            return Err(ChunkError::NotReproduced { index, path, before, now });
        }
        let finished = out.finish(&self.order.bytes_name(key));
        let finished = finished.map_err(ChunkError::file("writing", self.result(key)))?;
        let row = ChunkRow {
            key: key.to_owned(),
            index,
            sha256: finished.sha256,
            bytes: finished.bytes,
            rows,
            made_by: host(),
            commit: commit::known().map(str::to_owned),
            wall_ms: started.elapsed().as_millis() as u64,
        };
        self.store(RESULTS, &json_name(key), &row)?;
        Ok(Some(row))
    }

    fn store_failure(&self, index: u64, key: &str, error: &ChunkError) -> Result<(), ChunkError> {
        let before = self.read::<FailedChunk>(FAILED_CHUNKS, &json_name(key))?.and_then(Result::ok);
        let attempts = before.map_or(0, |before| before.attempts) + 1;
        let failed = FailedChunk { key: key.to_owned(), index, attempts, error: error.to_string() };
        self.store(FAILED_CHUNKS, &json_name(key), &failed)
    }

    fn forget_failure(&self, key: &str) -> Result<(), ChunkError> {
        let path = self.path.join(FAILED_CHUNKS).join(json_name(key));
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(ChunkError::file("removing", path)(error))
            }
            _ => Ok(()),
        }
    }

    /// Creates the folders of chunks, as readable as the umask of the process lets them be.
    fn make_folders(&self) -> Result<(), ChunkError> {
        for folder in [RESULTS, FAILED_CHUNKS].map(|name| self.path.join(name)) {
            fs::create_dir_all(&folder).map_err(ChunkError::file("creating", folder))?;
        }
        Ok(())
    }

    /// Reads a file of JSON: none if it does not exist, the reason if it is invalid.
    fn read<T: DeserializeOwned>(
        &self,
        folder: &str,
        name: &str,
    ) -> Result<Option<Result<T, String>>, ChunkError> {
        let path = self.path.join(folder).join(name);
        match fs::read(&path) {
            Ok(text) => Ok(Some(serde_json::from_slice(&text).map_err(|error| error.to_string()))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(ChunkError::file("reading", path)(error)),
        }
    }

    fn store(&self, folder: &str, name: &str, value: &impl Serialize) -> Result<(), ChunkError> {
        let folder = self.path.join(folder);
        let text = serde_json::to_vec(value).map_err(io::Error::from);
        let stored = text.and_then(|text| new_file::write(&folder, name, text));
        stored.map(|_| ()).map_err(ChunkError::file("writing", folder.join(name)))
    }
}

/// Path, in the folder of a work order, of a file that the order names by its sha256.
pub fn input_file(folder: &Path, sha256: &str) -> PathBuf {
    folder.join(INPUTS).join(sha256)
}

/// Name of the file with the row or the failure of a chunk.
fn json_name(key: &str) -> String {
    format!("{key}.json")
}

fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    if name.trim().is_empty() { "unknown".into() } else { name.trim().into() }
}

#[cfg(test)]
mod tests;
