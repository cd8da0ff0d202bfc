//! A data folder that cannot be written, or that another process uses: a temporary folder with links to its files, so that
//! everything that reads or computes works as usual. Its database is read in place, or copied if that is not safe.
//! Uses: std's files, `store` (whether a database is current). Never: a change to the folder.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustix::fs::{Access, access};
use uuid::Uuid;

use super::output::{bytes, note};
use super::running::is_alive;
use crate::new_file::make_folder;
use crate::store::{Sharing, Store};

/// Begin of the names of the temporary folders, before the id of their process.
const VIEWS: &str = "palpate-view-";

/// Name of the database, and of its logs: the second one is of another program that wrote into it.
const DATABASE: [&str; 3] = ["palpate.db", "palpate.db-wal", "palpate.db-journal"];
/// Files that belong to a process, and what a service writes into the folder of the data.
const LEFT_OUT: [&str; 5] =
    ["palpate.db-shm", "palpate.lock", "server.json", "service.log", "cache"];

/// The temporary folder; removed when it is dropped.
#[derive(Debug)]
pub struct View {
    folder: PathBuf,
    /// The database that is read in place; `None` if the folder has a copy.
    in_place: Option<InPlace>,
}

/// A database that is read in place.
#[derive(Debug)]
struct InPlace {
    database: PathBuf,
    /// As it was before; `None` if another process writes it.
    before: Option<Before>,
}

/// What changes when a process opens or writes a database.
#[derive(Debug, PartialEq, Eq)]
struct Before {
    bytes: u64,
    written_at: Option<SystemTime>,
    has_log: bool,
}

impl Before {
    fn of(database: &Path) -> Self {
        let is_there = |ending: &str| {
            let mut log = database.as_os_str().to_owned();
            log.push(ending);
            Path::new(&log).exists()
        };
        let found = database.metadata().ok();
        Self {
            bytes: found.as_ref().map_or(0, std::fs::Metadata::len),
            written_at: found.and_then(|found| found.modified().ok()),
            has_log: is_there("-wal") || is_there("-journal"),
        }
    }
}

impl View {
    /// Whether a folder is there and cannot be written.
    pub fn is_needed(data: &Path) -> bool {
        data.is_dir() && access(data, Access::WRITE_OK).is_err()
    }

    /// Makes the view of a folder. `only_reads`: the command stores nothing.
    ///
    /// The database is copied if the command stores what it computes, or if there is a log: it belongs to a process that
    /// may write, or holds what a killed one left, which SQLite cannot read in a folder that cannot be written. Tables
    /// of another version are migrated, or refused, in the copy.
    ///
    /// # Errors
    /// The operating system's if the folder cannot be read, or the view not written.
    pub async fn of(data: &Path, only_reads: bool) -> io::Result<Self> {
        let database = database(data)?;
        let before = Before::of(&database);
        let is_in_place =
            only_reads && !before.has_log && Store::is_current(&database, Sharing::Unchanged).await;
        Self::make(data, is_in_place.then_some(InPlace { database, before: Some(before) }))
    }

    /// Makes the view of a folder that another process uses, for a command that stores nothing. `None` if its database
    /// cannot be read meanwhile: it is not there yet, or has the tables of another version.
    ///
    /// # Errors
    /// The operating system's if the folder cannot be read, or the view not written.
    pub async fn beside(data: &Path) -> io::Result<Option<Self>> {
        let database = database(data)?;
        if !Store::is_current(&database, Sharing::Written).await {
            return Ok(None);
        }
        Self::make(data, Some(InPlace { database, before: None })).map(Some)
    }

    fn make(data: &Path, in_place: Option<InPlace>) -> io::Result<Self> {
        let folder = std::env::temp_dir();
        sweep(&folder);
        let folder = folder.join(format!("{VIEWS}{}-{}", std::process::id(), Uuid::now_v7()));
        let view = Self { folder, in_place };
        make_folder(&view.folder)?;
        for entry in data.canonicalize()?.read_dir()? {
            let entry = entry?;
            let name = entry.file_name();
            let is = |names: &[&str]| names.iter().any(|known| name == *known);
            if view.in_place.is_some() && is(&DATABASE) {
                continue;
            }
            if is(&DATABASE) {
                let size = bytes(entry.metadata()?.len() as f64);
                note(format_args!(
                    "{} cannot be written: reading a copy, {size}, in {}",
                    entry.path().display(),
                    view.folder.display()
                ));
                let copy = view.folder.join(&name);
                std::fs::copy(entry.path(), &copy)?;
                // The copy has the rights of the original.
                std::fs::set_permissions(&copy, Permissions::from_mode(0o600))?;
            } else if entry.path().is_dir() && !is(&LEFT_OUT) {
                let inside = match entry.path().read_dir() {
                    // The process that uses the folder has removed it.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                    inside => inside?,
                };
                // A folder of links: an export or a dataset that is made next to them does not reach the data.
                let folder = view.folder.join(&name);
                make_folder(&folder)?;
                for entry in inside {
                    let entry = entry?;
                    symlink(entry.path(), folder.join(entry.file_name()))?;
                }
            } else if !is(&LEFT_OUT) {
                symlink(entry.path(), view.folder.join(&name))?;
            }
        }
        Ok(view)
    }

    /// The temporary folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The database that is read in place, and its use by other processes; `None` if the folder has a copy.
    pub fn in_place(&self) -> Option<(PathBuf, Sharing)> {
        let it = self.in_place.as_ref()?;
        let sharing = if it.before.is_some() { Sharing::Unchanged } else { Sharing::Written };
        Some((it.database.clone(), sharing))
    }

    /// The database that is read in place as one that does not change, if another process has opened or written it since
    /// the view was made: what was read may be a mixture.
    pub fn changed(&self) -> Option<PathBuf> {
        let it = self.in_place.as_ref()?;
        let before = it.before.as_ref()?;
        (Before::of(&it.database) != *before).then(|| it.database.clone())
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // Links are removed, not what they lead to.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The database of a data folder. The log is next to the target of a link.
fn database(data: &Path) -> io::Result<PathBuf> {
    let database = data.canonicalize()?.join(DATABASE[0]);
    Ok(database.canonicalize().unwrap_or(database))
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
    fn the_view_has_no_copy_of_a_database_that_is_read_in_place_and_notices_its_change() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("palpate.db");
        std::fs::write(&database, "trials").unwrap();
        std::fs::write(folder.path().join("notes.txt"), "a note").unwrap();
        let view = || {
            let (database, before) = (database.clone(), Some(Before::of(&database)));
            View::make(folder.path(), Some(InPlace { database, before })).unwrap()
        };
        let opened = view();
        assert_eq!(opened.in_place(), Some((database.clone(), Sharing::Unchanged)));
        assert!(opened.folder().join("notes.txt").exists());
        assert!(!opened.folder().join("palpate.db").exists());
        assert_eq!(opened.changed(), None);
        for log in ["palpate.db-wal", "palpate.db-journal"] {
            let log = folder.path().join(log);
            std::fs::write(&log, "").unwrap();
            assert_eq!(opened.changed().as_ref(), Some(&database), "a process opened it");
            std::fs::remove_file(&log).unwrap();
        }
        let written = view();
        std::fs::write(&database, "more trials").unwrap();
        assert_eq!(written.changed(), Some(database));
    }

    #[tokio::test]
    async fn the_view_has_the_database_as_a_copy_and_the_rest_as_links() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path();
        std::fs::create_dir_all(data.join("datasets")).unwrap();
        std::fs::write(data.join("datasets/ds.parquet"), "rows").unwrap();
        std::fs::write(data.join("palpate.db"), "trials").unwrap();
        std::fs::write(data.join("palpate.lock"), "7").unwrap();
        assert!(!View::is_needed(data), "it can be written");

        // Its tables are not those of this version.
        let view = View::of(data, true).await.unwrap();
        assert_eq!((view.in_place(), view.changed()), (None, None));
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
