//! The data folder: one process writes into it, and other users of the machine see nothing of it.
//! Uses: std's files, `new_file`, `LockFile`. Never: a change to a folder of another user.

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use super::{LockFile, ServeError};
use crate::new_file::make_folder;

/// Rights of the group and of all other users.
const OTHERS: u32 = 0o077;
/// Only the owner of a file may remove it: the folder is shared, as `/tmp` is.
const STICKY: u32 = 0o1000;
/// New files get the group of the folder: it is meant for that group.
const SET_GROUP: u32 = 0o2000;

/// Returns the path of the database in a data folder.
pub fn database(data: &Path) -> PathBuf {
    data.join("palpate.db")
}

/// Creates a data folder, or takes the rights of other users from an existing one, and locks it.
///
/// # Errors
/// `ServeError::Data` if the folder cannot be created or changed, `Locked` if another process uses it.
pub fn open(data: &Path) -> Result<LockFile, ServeError> {
    let was_there = data.is_dir();
    let make = || -> io::Result<()> {
        make_folder(data)?;
        // A folder that holds no database is not a data folder yet: it may be a person's home.
        if was_there && !database(data).exists() { warn_if_open(data) } else { make_private(data) }
    };
    make().map_err(|source| ServeError::Data { path: data.to_owned(), source })?;
    Ok(LockFile::of_data(data)?)
}

/// Removes the rights of other users from the folder, which hides all that it contains, and from the
/// files of the database, which may be links to elsewhere.
fn make_private(data: &Path) -> io::Result<()> {
    let me = rustix::process::geteuid().as_raw();
    let database = database(data);
    let logs = ["wal", "shm"].map(|log| PathBuf::from(format!("{}-{log}", database.display())));
    for path in [data.to_owned(), database].into_iter().chain(logs) {
        let found = match path.metadata() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            found => found?,
        };
        let path = path.as_path();
        match rights(found.mode() & 0o7777, found.uid(), me) {
            Rights::Private => {}
            Rights::Narrow(mode) => {
                std::fs::set_permissions(path, Permissions::from_mode(mode))?;
                tracing::warn!(?path, "other users could read this: their rights were removed");
            }
            Rights::NotOurs => {
                let owner = found.uid();
                let words = "this is of another user, or shared with others, who may read the data";
                tracing::warn!(?path, owner, "{words}: use a data folder of your own");
            }
        }
    }
    Ok(())
}

/// Warns if other users may open the folder.
fn warn_if_open(data: &Path) -> io::Result<()> {
    if data.metadata()?.mode() & OTHERS != 0 {
        tracing::warn!(?data, "other users may open this folder: use one of your own, chmod 700");
    }
    Ok(())
}

/// What to do with the rights of a folder or file.
#[derive(Debug, PartialEq, Eq)]
enum Rights {
    /// Leave them: other users have none.
    Private,
    /// Set this mode.
    Narrow(u32),
    /// Leave them: it belongs to another user, or to all users.
    NotOurs,
}

fn rights(mode: u32, owner: u32, me: u32) -> Rights {
    match mode {
        mode if owner != me || mode & (STICKY | SET_GROUP) != 0 => Rights::NotOurs,
        mode if mode & OTHERS == 0 => Rights::Private,
        mode => Rights::Narrow(mode & !OTHERS),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_folders_are_narrowed() {
        assert_eq!(rights(0o700, 5, 5), Rights::Private);
        assert_eq!(rights(0o755, 5, 5), Rights::Narrow(0o700));
        assert_eq!(rights(0o2770, 5, 5), Rights::NotOurs);
        assert_eq!(rights(0o644, 5, 5), Rights::Narrow(0o600));
        assert_eq!(rights(0o755, 0, 5), Rights::NotOurs);
        assert_eq!(rights(0o1777, 0, 0), Rights::NotOurs, "/tmp, as root");
    }
}
