//! Sim-Random's shards as rows of a dataset: only what the manifest vouches for is read.
//! Uses: `simulate::random`'s manifest, parquet, files. Never: a shard whose sha256 is another.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use sha2::{Digest, Sha256};

use super::schema::BATCH_ROWS;
use crate::simulate::random::folder::MANIFEST;
use crate::simulate::random::manifest::{Manifest, ShardRow};

/// Folder of the folders of shards, in the data folder.
pub const SIM_RANDOM: &str = "sim-random";
/// All folders that there are.
const ALL: &str = "*";

/// Why shards cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ShardsError {
    /// A folder or file cannot be read.
    #[error("reading {path}: {source}", path = path.display())]
    Read {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// There is no such folder of shards.
    #[error("sim_random = {0}: there is no folder of that name with shards under DATA/sim-random")]
    None(String),
    /// The manifest cannot be understood.
    #[error("{path}: {why}", path = path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// A shard is not what its manifest says.
    #[error("{path}: its sha256 is not the manifest's: `palpate simulate random --verify` makes it again", path = path.display())]
    Damaged {
        /// The shard.
        path: PathBuf,
    },
    /// A shard is no Parquet file.
    #[error("{path}: {why}", path = path.display())]
    Parquet {
        /// The shard.
        path: PathBuf,
        /// Why.
        why: String,
    },
}

/// A folder of shards.
#[derive(Debug, Clone)]
pub struct ShardFolder {
    /// Its name under the data folder's `sim-random`.
    pub name: String,
    /// What it holds.
    pub manifest: Manifest,
    path: PathBuf,
}

impl ShardFolder {
    /// Trials in its finished shards.
    pub fn trials(&self) -> u64 {
        self.manifest.shards.iter().map(|shard| shard.trials).sum()
    }

    /// The rows of a shard, in batches of [`BATCH_ROWS`].
    pub fn read(&self, shard: &ShardRow) -> Result<Vec<RecordBatch>, ShardsError> {
        let path = self.path.join(&shard.file);
        let read = |source| ShardsError::Read { path: path.clone(), source };
        let bytes = Bytes::from(fs::read(&path).map_err(read)?);
        if hex::encode(Sha256::digest(&bytes)) != shard.sha256 {
            return Err(ShardsError::Damaged { path });
        }
        let parquet = |why: String| ShardsError::Parquet { path: path.clone(), why };
        let reader = ParquetRecordBatchReaderBuilder::try_new(bytes)
            .and_then(|builder| builder.with_batch_size(BATCH_ROWS).build())
            .map_err(|error| parquet(error.to_string()))?;
        reader.map(|batch| batch.map_err(|error| parquet(error.to_string()))).collect()
    }
}

/// The folders of these names in the data folder, by name; `*` is all that there are.
pub fn find(data: &Path, wanted: &[String]) -> Result<Vec<ShardFolder>, ShardsError> {
    let root = data.join(SIM_RANDOM);
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
        if entry.path().join(MANIFEST).is_file() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    Ok(names)
}

fn open(root: &Path, name: String) -> Result<ShardFolder, ShardsError> {
    let path = root.join(&name);
    let file = path.join(MANIFEST);
    let text = match fs::read(&file) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(ShardsError::None(name));
        }
        Err(source) => return Err(ShardsError::Read { path: file, source }),
    };
    let manifest = serde_json::from_slice(&text)
        .map_err(|error| ShardsError::Manifest { path: file, why: error.to_string() })?;
    Ok(ShardFolder { name, manifest, path })
}
