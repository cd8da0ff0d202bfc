//! The folder of shards: locked by one process, shards made durable one by one, the manifest
//! replaced as a whole.
//! Uses: std's files, `new_file`. Never: rows, the model.
//!
//! A shard is a new file (`new_file`), and only when it is durable entered in the manifest, which is
//! replaced in the same way. At any instant every row of the manifest therefore refers to a complete
//! file. All names other than those of shards start with `_`, which readers of Parquet folders skip.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use sim_core::sensor::SensorFile;

use super::error::RandomError;
use super::manifest::{Definition, Manifest, Shard, ShardRow};
use crate::difference::first_difference;
use crate::new_file::{self, Finished, Look, NewFile};

/// Name of the manifest.
pub const SHARDS_MANIFEST: &str = "_manifest.json";
/// Suffix of a temporary file's name in earlier versions.
const OLD_PARTIAL: &str = ".partial";

/// A folder that only this process writes to.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    /// Owner of the lock: the folder is locked while it is open.
    _lock: File,
}

impl Folder {
    /// Creates the folder if needed, locks it, and removes incomplete files of a killed process.
    ///
    /// # Errors
    /// `RandomError::Busy` if another process holds it; `File` if it cannot be created or cleaned.
    pub fn take(path: &Path) -> Result<Self, RandomError> {
        fs::create_dir_all(path).map_err(RandomError::file("creating the folder", path))?;
        let lock = File::open(path).map_err(RandomError::file("opening the folder", path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(RandomError::Busy { folder: path.into() }),
            Err(TryLockError::Error(source)) => {
                return Err(RandomError::file("locking the folder", path)(source));
            }
        }
        let folder = Self { path: path.into(), _lock: lock };
        new_file::sweep(path).map_err(RandomError::file("removing incomplete files in", path))?;
        for name in folder.names()? {
            if name.starts_with('_') && name.ends_with(OLD_PARTIAL) {
                let stray = folder.path.join(name);
                fs::remove_file(&stray).map_err(RandomError::file("removing", stray))?;
            }
        }
        Ok(folder)
    }

    /// Takes the folder of a definition, with its manifest.
    ///
    /// # Errors
    /// As [`Self::take`]; `OtherDefinition` or `Foreign` if the folder belongs to something else; `Manifest` if
    /// the manifest cannot be read.
    pub fn take_for(
        path: &Path,
        definition: &Definition,
        sensor: &SensorFile,
    ) -> Result<(Self, Manifest), RandomError> {
        let folder = Self::take(path)?;
        let manifest = folder.manifest(definition, sensor)?;
        Ok((folder, manifest))
    }

    /// Returns the manifest of this definition: the existing one, or a new one, which is then
    /// stored.
    ///
    /// # Errors
    /// `OtherDefinition` or `Foreign` if the folder belongs to something else; `Manifest` or `File`
    /// if the manifest cannot be read or written.
    fn manifest(
        &self,
        definition: &Definition,
        sensor: &SensorFile,
    ) -> Result<Manifest, RandomError> {
        let path = self.path.join(SHARDS_MANIFEST);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                if let Some(file) = self.names()?.into_iter().find(|n| n.ends_with(".parquet")) {
                    return Err(RandomError::Foreign { folder: self.path.clone(), file });
                }
                let (definition, sensor_file) = (definition.clone(), sensor.clone());
                let new = Manifest { definition, sensor_file, shards: Vec::new() };
                self.write_manifest(&new)?;
                return Ok(new);
            }
            Err(error) => return Err(RandomError::file("reading", path)(error)),
        };
        let unreadable = |source| RandomError::Manifest { path: path.clone(), source };
        // Read as a value first: another version's manifest may have other fields.
        let value: serde_json::Value = serde_json::from_slice(&bytes).map_err(unreadable)?;
        let here = serde_json::to_value(definition).map_err(unreadable)?;
        if let Some(difference) = first_difference(&value["definition"], &here) {
            return Err(RandomError::OtherDefinition {
                folder: self.path.clone(),
                field: difference.field,
                there: difference.there,
                here: difference.here,
            });
        }
        serde_json::from_value(value).map_err(unreadable)
    }

    /// Replaces the manifest.
    ///
    /// # Errors
    /// `RandomError::File` if it cannot be written.
    pub fn write_manifest(&self, manifest: &Manifest) -> Result<(), RandomError> {
        let path = self.path.join(SHARDS_MANIFEST);
        let mut text = serde_json::to_vec_pretty(manifest)
            .map_err(|source| RandomError::Manifest { path: path.clone(), source })?;
        text.push(b'\n');
        let written = new_file::write(&self.path, SHARDS_MANIFEST, text).map(|_| ());
        written.map_err(RandomError::file("writing", path))
    }

    /// Whether a shard's file matches its row, checked as deeply as `look`.
    ///
    /// # Errors
    /// `RandomError::File` if an existing file cannot be read.
    pub fn holds(&self, row: &ShardRow, look: Look) -> Result<bool, RandomError> {
        let path = self.path.join(&row.file);
        let whole = Finished { bytes: row.bytes, sha256: row.sha256.clone() };
        whole.is_at(&path, look).map_err(RandomError::file("reading", path))
    }

    /// Starts a shard's file under a temporary name.
    ///
    /// # Errors
    /// `RandomError::File` if it cannot be created.
    pub fn begin(&self) -> Result<NewFile, RandomError> {
        NewFile::create(&self.path).map_err(RandomError::file("creating a file in", &self.path))
    }

    /// Makes a shard's finished file durable under its final name; returns its row in the manifest.
    ///
    /// # Errors
    /// `RandomError::File` if it cannot be synced or renamed.
    pub fn finish(&self, shard: &Shard, out: NewFile) -> Result<ShardRow, RandomError> {
        let file = shard.file_name();
        let failed = RandomError::file("writing", self.path.join(&file));
        let finished = out.finish(&file).map_err(failed)?;
        Ok(ShardRow {
            file,
            first: shard.first,
            trials: shard.trials,
            bytes: finished.bytes,
            sha256: finished.sha256,
            commit: crate::commit::known().map(str::to_owned),
        })
    }

    fn names(&self) -> Result<Vec<String>, RandomError> {
        let listing = || RandomError::file("listing", &self.path);
        let entries = fs::read_dir(&self.path).map_err(listing())?;
        let name = |entry: io::Result<fs::DirEntry>| {
            Ok(entry.map_err(listing())?.file_name().to_string_lossy().into_owned())
        };
        entries.map(name).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_folder_is_one_process_s_and_loses_what_was_half_written() {
        let outer = tempfile::tempdir().unwrap();
        let path = outer.path().join("shards");
        let folder = Folder::take(&path).unwrap();
        assert!(matches!(Folder::take(&path), Err(RandomError::Busy { .. })));
        drop(folder);
        let stray = path.join("_shard-00000.parquet.partial");
        fs::write(&stray, "half").unwrap();
        let half = NewFile::create(&path).unwrap();
        fs::write(path.join("notes.partial"), "mine").unwrap();
        Folder::take(&path).unwrap();
        assert!(!half.path().exists());
        assert!(!stray.exists() && path.join("notes.partial").exists());
    }

    #[test]
    fn a_shard_shows_under_its_name_only_when_whole() {
        let outer = tempfile::tempdir().unwrap();
        let path = outer.path().join("shards");
        let folder = Folder::take(&path).unwrap();
        let shard = Shard { number: 7, first: 70, trials: 10 };
        let mut out = folder.begin().unwrap();
        out.write_all(b"abc").unwrap();
        let named = path.join("shard-00007.parquet");
        assert!(!named.exists());
        let mut row = folder.finish(&shard, out).unwrap();
        assert_eq!(fs::read(&named).unwrap(), b"abc");
        assert_eq!(row.bytes, 3);
        // The sha256 of "abc", as FIPS 180-2 prints it.
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(row.sha256, known);
        assert!(folder.holds(&row, Look::Sha256).unwrap());
        fs::write(&named, "abd").unwrap();
        assert!(folder.holds(&row, Look::Length).unwrap());
        assert!(!folder.holds(&row, Look::Sha256).unwrap());
        row.bytes = 4;
        assert!(!folder.holds(&row, Look::Length).unwrap());
        fs::remove_file(&named).unwrap();
        assert!(!folder.holds(&row, Look::Length).unwrap());
    }
}
