//! A data folder that cannot be written: a temporary folder with a copy of its database and links to its other
//! files, so that everything that reads or computes works as usual.
//! Uses: std's files. Never: a change to the folder.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};
use uuid::Uuid;

use super::output::{bytes, note};
use super::running::is_alive;
use crate::new_file::make_folder;

/// Begin of the names of the temporary folders, before the id of their process.
const VIEWS: &str = "palpate-view-";

/// Name of the database, and of its log.
const DATABASE: [&str; 2] = ["palpate.db", "palpate.db-wal"];
/// Files that belong to a process, and what a service writes into the folder of the data.
const LEFT_OUT: [&str; 5] =
    ["palpate.db-shm", "palpate.lock", "server.json", "service.log", "cache"];

/// The temporary folder; removed when it is dropped.
#[derive(Debug)]
pub struct View(PathBuf);

impl View {
    /// Whether a folder is there and cannot be written.
    pub fn is_needed(data: &Path) -> bool {
        data.is_dir() && access(data, Access::WRITE_OK).is_err()
    }

    /// Makes the view of a folder that cannot be written; none of any other.
    ///
    /// # Errors
    /// The operating system's if the folder cannot be read, or the copy not written.
    pub fn of(data: &Path) -> io::Result<Option<Self>> {
        Self::is_needed(data).then(|| Self::copy(data)).transpose()
    }

    fn copy(data: &Path) -> io::Result<Self> {
        let folder = std::env::temp_dir();
        sweep(&folder);
        let view = Self(folder.join(format!("{VIEWS}{}-{}", std::process::id(), Uuid::now_v7())));
        make_folder(&view.0)?;
        for entry in data.canonicalize()?.read_dir()? {
            let entry = entry?;
            let name = entry.file_name();
            let is = |names: &[&str]| names.iter().any(|known| name == *known);
            if is(&DATABASE) {
                let size = bytes(entry.metadata()?.len() as f64);
                note(format_args!(
                    "{} cannot be written: reading a copy, {size}, in {}",
                    entry.path().display(),
                    view.0.display()
                ));
                let copy = view.0.join(&name);
                std::fs::copy(entry.path(), &copy)?;
                // The copy has the rights of the original.
                std::fs::set_permissions(&copy, Permissions::from_mode(0o600))?;
            } else if entry.path().is_dir() && !is(&LEFT_OUT) {
                // A folder of links: an export or a dataset that is made next to them does not reach the data.
                let folder = view.0.join(&name);
                make_folder(&folder)?;
                for entry in entry.path().read_dir()? {
                    let entry = entry?;
                    symlink(entry.path(), folder.join(entry.file_name()))?;
                }
            } else if !is(&LEFT_OUT) {
                symlink(entry.path(), view.0.join(&name))?;
            }
        }
        Ok(view)
    }

    /// The temporary folder.
    pub fn folder(&self) -> &Path {
        &self.0
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // Links are removed, not what they lead to.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Removes the views of processes that were killed.
fn sweep(folder: &Path) {
    for entry in folder.read_dir().into_iter().flatten().flatten() {
        let name = entry.file_name().into_string().unwrap_or_default();
        let process =
            name.strip_prefix(VIEWS).and_then(|rest| rest.split('-').next()?.parse().ok());
        if process.is_some_and(|process| !is_alive(process)) {
            // Those of other users stay.
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_view_has_the_database_as_a_copy_and_the_rest_as_links() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path();
        std::fs::create_dir_all(data.join("datasets")).unwrap();
        std::fs::write(data.join("datasets/ds.parquet"), "rows").unwrap();
        std::fs::write(data.join("palpate.db"), "trials").unwrap();
        std::fs::write(data.join("palpate.lock"), "7").unwrap();
        assert!(View::of(data).unwrap().is_none(), "it can be written");

        let view = View::copy(data).unwrap();
        let read = |name: &str| std::fs::read_to_string(view.folder().join(name));
        assert_eq!(read("datasets/ds.parquet").unwrap(), "rows");
        std::fs::write(view.folder().join("palpate.db"), "changed").unwrap();
        std::fs::write(view.folder().join("datasets/made.parquet"), "rows").unwrap();
        assert!(!data.join("datasets/made.parquet").exists());
        assert!(read("palpate.lock").is_err());
        let folder = view.folder().to_owned();
        drop(view);
        assert!(!folder.exists());
        assert_eq!(std::fs::read_to_string(data.join("palpate.db")).unwrap(), "trials");
        assert!(data.join("datasets/ds.parquet").exists());
    }

    #[test]
    fn the_view_of_a_killed_process_is_removed_and_that_of_a_running_one_stays() {
        let folder = tempfile::tempdir().unwrap();
        let view = |process: u32| folder.path().join(format!("{VIEWS}{process}-0192"));
        let (killed, running) = (view(i32::MAX.cast_unsigned()), view(std::process::id()));
        for folder in [&killed, &running] {
            std::fs::create_dir_all(folder).unwrap();
        }
        sweep(folder.path());
        assert!(!killed.exists() && running.exists());
    }
}
