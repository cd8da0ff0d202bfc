//! Files that get their final name only after they are complete and durable.
//! Uses: std's files. Never: other bytes under a name that is in use.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::digest::Hashing;

/// Prefix of temporary names.
const PARTIAL: &str = "_partial-";

/// An unfinished file with the hash and number of its bytes; removed if it is dropped unfinished.
#[derive(Debug)]
pub struct NewFile {
    folder: PathBuf,
    partial: PathBuf,
    file: File,
    sha256: Hashing,
    bytes: u64,
    finished: bool,
}

/// A complete and durable file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finished {
    /// Length, bytes.
    pub bytes: u64,
    /// sha256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

impl NewFile {
    /// Creates a file under a temporary name in `folder`, which is created if needed.
    ///
    /// # Errors
    /// If folder or file cannot be created.
    pub fn create(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let partial = folder.join(format!("{PARTIAL}{}", uuid::Uuid::now_v7()));
        let file = File::create_new(&partial)?;
        let (folder, sha256) = (folder.to_owned(), Hashing::default());
        Ok(Self { folder, partial, file, sha256, bytes: 0, finished: false })
    }

    /// Path under the temporary name.
    pub fn path(&self) -> &Path {
        &self.partial
    }

    /// Makes the file durable and renames it to `name`.
    ///
    /// # Errors
    /// If syncing or renaming fails; a file that could not be renamed is removed.
    pub fn finish(mut self, name: &str) -> io::Result<Finished> {
        self.file.sync_all()?;
        fs::rename(&self.partial, self.folder.join(name))?;
        self.finished = true;
        File::open(&self.folder)?.sync_all()?;
        Ok(Finished { bytes: self.bytes, sha256: std::mem::take(&mut self.sha256).finish() })
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.sha256.update(&bytes[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if !self.finished {
            // A file that cannot be removed now is removed at the next start.
            fs::remove_file(&self.partial).ok();
        }
    }
}

/// Removes the unfinished files in a folder; a missing folder is no error.
///
/// # Errors
/// If the folder cannot be read or a file cannot be removed.
pub fn sweep(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(PARTIAL) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}
