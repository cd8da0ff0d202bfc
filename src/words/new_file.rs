//! New files: written under a temporary name, made durable, and only then renamed to their final name.
//! Uses: std's files, `digest`. Never: an incomplete file under its final name.
//!
//! [`NewFile::finish`] syncs the file (its bytes and length are on the disk), renames it (atomically: the
//! name refers to the earlier file or to the new one, never to a part), and syncs the folder (the name is on
//! the disk). After it has returned, a power failure loses nothing. A power failure before leaves the earlier
//! state or the whole new file, and possibly a file under a temporary name, which [`sweep`] removes. Order
//! between files follows: a file that is written after another has finished is never there without it.
//!
//! Other users of the machine see nothing of the data folder: [`make_folder`] makes a folder that only this
//! user can open, and a [`NewFile`] is no more readable than its folder. The umask of the process stays as it
//! is: files that a person asks for elsewhere (`--out`) follow it.
//!
//! [`NewFile::finish_unsynced`] omits both syncs, for files that are made again and that no later process
//! reads: a sync of one file delays those of all others, such as the commit of a trial. It and
//! [`NewFile::finish_first`] do not replace a file: the query engine may open only the files that existed when it
//! began, and a file that replaces one of them is another file.
//!
//! Not covered: the entry of the folder in its parent if [`NewFile::create`] had to create the folder, and
//! disks that report a sync before they have done it.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, BufReader, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use crate::digest::Hashing;

/// Prefix of temporary names.
const PARTIAL: &str = "_partial-";
/// Number of bytes of a finished file that are read at a time.
const FINISHED_READ_BYTES: usize = 1 << 20;

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
    /// Length of the file, bytes.
    pub bytes: u64,
    /// sha256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

/// Depth of the check of a finished file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Checks the length only.
    Length,
    /// Checks the sha256 of all bytes.
    Sha256,
}

impl Finished {
    /// Whether the file at `path` is this one, checked as deeply as `look`; a missing file is not.
    ///
    /// # Errors
    /// If an existing file cannot be read.
    pub fn is_at(&self, path: &Path, look: Look) -> io::Result<bool> {
        let file = match File::open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            file => file?,
        };
        let length = file.metadata()?.len();
        if length != self.bytes || look == Look::Length {
            return Ok(length == self.bytes);
        }
        let mut hash = Hashing::default();
        io::copy(&mut BufReader::with_capacity(FINISHED_READ_BYTES, file), &mut hash)?;
        Ok(hash.finish() == self.sha256)
    }
}

impl NewFile {
    /// Creates a file under a temporary name in `folder`, which is created if needed.
    ///
    /// # Errors
    /// If folder or file cannot be created.
    pub fn create(folder: &Path) -> io::Result<Self> {
        if !folder.is_dir() {
            make_folder(folder)?;
            if let Some(parent) = folder.parent().filter(|parent| !parent.as_os_str().is_empty()) {
                File::open(parent)?.sync_all()?;
            }
        }
        let partial = folder.join(format!("{PARTIAL}{}", uuid::Uuid::now_v7()));
        let file = as_private_as(folder)?.create_new(true).open(&partial)?;
        let (folder, sha256) = (folder.to_owned(), Hashing::default());
        Ok(Self { folder, partial, file, sha256, bytes: 0, finished: false })
    }

    /// Creates a file under a temporary name in the folder of `path`, which is created if needed.
    ///
    /// # Errors
    /// If folder or file cannot be created, or the path is that of a device, a pipe or a folder: it would be replaced.
    pub fn create_for(path: &Path) -> io::Result<Self> {
        if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            let words = "it exists and is not a regular file";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, words));
        }
        // The folder of a name alone is the present one.
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        Self::create(folder.unwrap_or(Path::new(".")))
    }

    /// sha256 of the bytes that have been written, in hexadecimal digits.
    pub fn sha256(&self) -> String {
        self.sha256.clone().finish()
    }

    /// Path under the temporary name.
    pub fn path(&self) -> &Path {
        &self.partial
    }

    /// Makes the file durable under `name`. An existing file of this name is replaced.
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

    /// Makes the file durable under `name`, unless a file of this name exists: that one stays.
    ///
    /// # Errors
    /// If syncing or linking fails; the file is then removed.
    pub fn finish_first(self, name: &str) -> io::Result<()> {
        self.file.sync_all()?;
        self.link(name)?;
        File::open(&self.folder)?.sync_all()
    }

    /// Gives the file its name, unless a file of this name exists: that one stays. A power failure may leave a part
    /// of it under this name.
    ///
    /// # Errors
    /// If linking fails; the file is then removed.
    pub fn finish_unsynced(self, name: &str) -> io::Result<()> {
        self.link(name)
    }

    /// The temporary name is removed with the value.
    fn link(&self, name: &str) -> io::Result<()> {
        match fs::hard_link(&self.partial, self.folder.join(name)) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
            done => done,
        }
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

/// Writes a durable file with these bytes, named `name`, in `folder`, which is created if needed. An
/// existing file of this name is replaced.
///
/// # Errors
/// If the file cannot be created, written, synced or renamed.
pub fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> io::Result<Finished> {
    let mut file = NewFile::create(folder)?;
    file.write_all(bytes.as_ref())?;
    file.finish(name)
}

/// Makes a folder, and its missing parents, that only this user can open; an existing one stays as it is.
///
/// # Errors
/// If a folder cannot be created.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

/// Returns options that write a new file in `folder`, readable at most by those who can read the folder.
///
/// # Errors
/// If the folder does not exist.
pub fn as_private_as(folder: &Path) -> io::Result<OpenOptions> {
    let mode = fs::metadata(folder)?.permissions().mode();
    let mut options = File::options();
    options.write(true).mode(mode & 0o666);
    Ok(options)
}

/// Removes the unfinished files in a folder; a missing folder is no error. No other process or thread may
/// be writing a [`NewFile`] there.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn empty(name: &str) -> PathBuf {
        let name = format!("palpate-new-file-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        fs::remove_dir_all(&path).ok();
        path
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_device_is_not_replaced() {
        let refused = NewFile::create_for(Path::new("/dev/null")).err().unwrap();
        assert_eq!(refused.to_string(), "it exists and is not a regular file");
        assert!(NewFile::create_for(&std::env::temp_dir()).is_err());
    }

    #[test]
    fn a_file_shows_under_its_name_only_when_whole() {
        let folder = empty("whole");
        let mut file = NewFile::create(&folder).unwrap();
        file.write_all(b"ab").unwrap();
        file.write_all(b"c").unwrap();
        assert!(!folder.join("a.txt").exists());
        assert_eq!(file.sha256(), crate::digest::sha256_hex("abc"));
        let finished = file.finish("a.txt").unwrap();
        assert_eq!((finished.bytes, finished.sha256), (3, crate::digest::sha256_hex("abc")));
        assert_eq!(names(&folder), ["a.txt"]);
        write(&folder, "a.txt", "d").unwrap();
        assert_eq!(fs::read(folder.join("a.txt")).unwrap(), b"d");
        let mut again = NewFile::create(&folder).unwrap();
        again.write_all(b"e").unwrap();
        again.finish_unsynced("a.txt").unwrap();
        NewFile::create(&folder).unwrap().finish_first("a.txt").unwrap();
        assert_eq!(fs::read(folder.join("a.txt")).unwrap(), b"d", "the first one stays");
        NewFile::create(&folder).unwrap().finish_first("b.txt").unwrap();
        assert_eq!(names(&folder), ["a.txt", "b.txt"]);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_is_no_more_readable_than_its_folder() {
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let folder = empty("private");
        write(&folder.join("datasets"), "a.txt", "a").unwrap();
        let made = [folder.clone(), folder.join("datasets"), folder.join("datasets/a.txt")];
        assert_eq!(made.map(|path| mode(&path)), [0o700, 0o700, 0o600]);
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o750)).unwrap();
        write(&folder, "b.txt", "b").unwrap();
        assert_eq!(mode(&folder.join("b.txt")) & 0o007, 0);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn an_unfinished_file_is_removed_at_once_or_at_the_next_start() {
        let folder = empty("unfinished");
        let dropped = NewFile::create(&folder).unwrap();
        let killed = NewFile::create(&folder).unwrap();
        fs::write(folder.join("notes"), "kept").unwrap();
        drop(dropped);
        std::mem::forget(killed);
        assert_eq!(names(&folder).len(), 2);
        sweep(&folder).unwrap();
        assert_eq!(names(&folder), ["notes"]);
        fs::remove_dir_all(&folder).unwrap();
        sweep(&folder).unwrap();
    }
}
