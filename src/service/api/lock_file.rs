//! Lock files: only one process uses a data folder, only one process uses a rig.
//! Uses: the system's file locks, which a crash releases. Never: a stale file that must be deleted.

use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

use crate::digest::sha256_hex;
use crate::rig::config::{LineConfig, RigConfig};

/// A lock that is held until this value is dropped.
#[derive(Debug)]
pub struct LockFile {
    _file: File,
}

/// Why a lock could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum LockFileError {
    /// Another process holds the lock.
    #[error(
        "{what} is in use by process {holder} (lock file {}): stop that process, or start `palpate serve` \
         first and run commands as its clients",
        path.display()
    )]
    Held {
        /// The locked resource, as text.
        what: String,
        /// Process id of the holder, as written in the lock file.
        holder: String,
        /// Path of the lock file.
        path: PathBuf,
    },
    /// The lock file cannot be opened or written.
    #[error("lock file {}: {source}", path.display())]
    File {
        /// Path of the lock file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
}

impl LockFile {
    /// Takes the lock of a data folder.
    ///
    /// # Errors
    /// `LockFileError::Held` if another process holds it, `File` if the lock file cannot be used.
    pub fn of_data(folder: &Path) -> Result<Self, LockFileError> {
        Self::take(&folder.join("palpate.lock"), &format!("the data folder {}", folder.display()))
    }

    /// Takes the lock of a rig on this machine. Rig files with the same wires have the same lock.
    ///
    /// # Errors
    /// `LockFileError::Held` if another process holds it, `File` if the lock file cannot be used.
    pub fn of_rig(rig: &RigConfig) -> Result<Self, LockFileError> {
        let mut wires: Vec<&str> = rig
            .lines
            .values()
            .map(|line| match line {
                LineConfig::ModbusTcp { address, .. } => address.as_str(),
                LineConfig::ModbusRtu { path, .. } => path.as_str(),
            })
            .collect();
        wires.sort_unstable();
        let digest = sha256_hex(wires.join("\n"));
        let path = std::env::temp_dir().join(format!("palpate-rig-{}.lock", &digest[..12]));
        Self::take(&path, &format!("the rig {}", rig.name))
    }

    fn take(path: &Path, what: &str) -> Result<Self, LockFileError> {
        let failed = |source| LockFileError::File { path: path.into(), source };
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => {
                let mut holder = String::new();
                let _ = file.read_to_string(&mut holder);
                let holder = holder.trim().to_owned();
                return Err(LockFileError::Held { what: what.into(), holder, path: path.into() });
            }
            Err(std::fs::TryLockError::Error(source)) => return Err(failed(source)),
        }
        file.set_len(0).map_err(failed)?;
        file.rewind().map_err(failed)?;
        writeln!(file, "{}", std::process::id()).map_err(failed)?;
        Ok(Self { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_holder_is_refused_with_the_process_id_of_the_first() {
        let folder = std::env::temp_dir().join(format!("palpate-lock-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let first = LockFile::of_data(&folder).unwrap();
        let refused = LockFile::of_data(&folder).unwrap_err().to_string();
        assert!(refused.contains(&std::process::id().to_string()), "{refused}");
        drop(first);
        LockFile::of_data(&folder).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
