//! Sim-Random's shards as rows of a dataset: only shards that match their manifest are read.
//! Uses: `simulate::random`'s manifest, parquet, files. Never: a shard with another sha256.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::schema::BATCH_ROWS;
use crate::digest::sha256_hex;
use crate::simulate::random::folder::SHARDS_MANIFEST;
use crate::simulate::random::manifest::{Manifest, ShardRow};

/// Folder in the data folder that holds the folders of shards.
const SHARDS_FOLDER: &str = "sim-random";
/// Name that selects all folders.
const ALL: &str = "*";

/// Why shards cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ShardsError {
    #[error("reading {path}: {source}", path = path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("sim_random = {0}: must be a folder with shards under DATA/sim-random")]
    None(String),
    #[error("{path}: its sha256 differs from the manifest: run `palpate simulate random --verify`", path = path.display())]
    Damaged { path: PathBuf },
    /// The manifest is invalid, or a shard is not a valid Parquet file.
    #[error("{path}: {why}", path = path.display())]
    Invalid { path: PathBuf, why: String },
}

/// A folder of shards.
#[derive(Debug, Clone)]
pub struct ShardFolder {
    /// Name of the folder under `sim-random` in the data folder.
    pub name: String,
    /// Definition of the simulation and list of the finished shards.
    pub manifest: Manifest,
    path: PathBuf,
}

impl ShardFolder {
    /// Number of trials in the finished shards.
    pub fn trials(&self) -> u64 {
        self.manifest.shards.iter().map(|shard| shard.trials).sum()
    }

    /// Reads the rows of a shard, in batches of [`BATCH_ROWS`].
    ///
    /// # Errors
    /// `ShardsError::Read` if the file cannot be read, `Damaged` if its sha256 differs from the
    /// manifest, `Invalid` if it cannot be decoded.
    pub fn read(&self, shard: &ShardRow) -> Result<Vec<RecordBatch>, ShardsError> {
        let path = self.path.join(&shard.file);
        let read = |source| ShardsError::Read { path: path.clone(), source };
        let bytes = Bytes::from(fs::read(&path).map_err(read)?);
        if sha256_hex(&bytes) != shard.sha256 {
            return Err(ShardsError::Damaged { path });
        }
        let parquet = |why: String| ShardsError::Invalid { path: path.clone(), why };
        let reader = ParquetRecordBatchReaderBuilder::try_new(bytes)
            .and_then(|builder| builder.with_batch_size(BATCH_ROWS).build())
            .map_err(|error| parquet(error.to_string()))?;
        reader.map(|batch| batch.map_err(|error| parquet(error.to_string()))).collect()
    }
}

/// Returns the folders with the given names, sorted by name; `*` selects all. `data` is the data
/// folder.
///
/// # Errors
/// `ShardsError::None` if a folder does not exist, `Read` or `Invalid` if its manifest cannot be
/// read.
pub fn find(data: &Path, wanted: &[String]) -> Result<Vec<ShardFolder>, ShardsError> {
    let root = data.join(SHARDS_FOLDER);
    let mut names: Vec<String> = Vec::new();
    for name in wanted {
        if name == ALL {
            names.extend(all(&root)?);
        } else {
            names.push(name.clone());
        }
    }
    names.sort();
    names.dedup();
    names.into_iter().map(|name| open(&root, name)).collect()
}

fn all(root: &Path) -> Result<Vec<String>, ShardsError> {
    let read = |source| ShardsError::Read { path: root.to_owned(), source };
    let entries = match fs::read_dir(root) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(read)?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(read)?;
        if entry.path().join(SHARDS_MANIFEST).is_file() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    Ok(names)
}

fn open(root: &Path, name: String) -> Result<ShardFolder, ShardsError> {
    let path = root.join(&name);
    let file = path.join(SHARDS_MANIFEST);
    let text = match fs::read(&file) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(ShardsError::None(name));
        }
        Err(source) => return Err(ShardsError::Read { path: file, source }),
    };
    let manifest = serde_json::from_slice(&text)
        .map_err(|error| ShardsError::Invalid { path: file, why: error.to_string() })?;
    Ok(ShardFolder { name, manifest, path })
}
