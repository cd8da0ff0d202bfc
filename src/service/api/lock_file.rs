//! Lock files: only one process writes into a data folder, only one process uses a rig.
//! Uses: the system's file locks, which a crash releases. Never: a stale file that must be deleted; a
//! file behind a symbolic link.
//!
//! A rig belongs to the machine, not to a user: with a lock file in a folder of each user, two users would
//! drive it at once, and no wire refuses a second process itself (`link::serial_opener`, Modbus TCP). So the
//! lock of a rig is in the machine's folder for locks, `/run/lock`, or else in `/tmp`, where every user may
//! create files and none may replace those of another. Its name can be guessed. So no link is followed,
//! the file must be an ordinary one with one name, it is written only by the holder of the lock, and it is
//! never believed: what is read of it is shown. Any user may hold the lock without a rig; the refusal names
//! process and user, and root may end it.
//!
//! The lock file of a data folder is believed in one point: that its holder has no rig. Other processes may then
//! read the data.

use std::fs::{File, Permissions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use crate::digest::sha256_hex;
use crate::plain::system_words;
use crate::rig::config::{ErtConfig, LineConfig};
use crate::rig::setup::RigSetup;

/// Folders for the lock of a rig, in the order of preference. Not `TMPDIR`: users have different ones.
const SHARED: [&str; 2] = ["/run/lock", "/tmp"];
/// Rights of a folder in which every user may create files and remove only own ones.
const STICKY_FOR_ALL: u32 = 0o1002;
/// Rights of the lock of a rig.
const SHARED_MODE: u32 = 0o666;
/// End of the note of a holder of a data folder that has no rig.
const NO_RIG: &str = " without a rig";
/// Longest note of a holder that is shown, bytes.
const HOLDER_MAX_BYTES: u64 = 60;

/// A lock that is held until this value is dropped.
#[derive(Debug)]
pub struct LockFile {
    file: File,
}

impl Drop for LockFile {
    /// An empty file takes no space: `/run/lock` is small, and a virtual rig has new addresses each time.
    fn drop(&mut self) {
        let _ = self.file.set_len(0);
    }
}

/// Why a lock could not be taken.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LockFileError {
    #[error(
        "{what} is in use by process {holder} (lock file {}): wait until that process ends, or stop it; \
         to run several commands at once, start `palpate serve` first",
        path.display()
    )]
    Held { what: String, holder: String, path: PathBuf },
    #[error("lock file {}: {}", path.display(), system_words(source))]
    File { path: PathBuf, source: io::Error },
}

impl LockFileError {
    /// Whether the holder noted that it has no rig: other processes may read the data meanwhile.
    pub fn is_held_without_rig(&self) -> bool {
        matches!(self, Self::Held { holder, .. } if holder.ends_with(NO_RIG))
    }
}

impl LockFile {
    /// Takes the lock of a data folder.
    ///
    /// # Errors
    /// `LockFileError::Held` if another process holds it, `File` if the lock file cannot be used.
    pub fn of_data(folder: &Path) -> Result<Self, LockFileError> {
        let what = format!("the data folder {}", folder.display());
        Self::take(&folder.join("palpate.lock"), &what, 0o600)
    }

    /// Takes the locks of a rig on this machine, one for each wire: rig files that share a wire exclude one another.
    ///
    /// # Errors
    /// `LockFileError::Held` if another process holds it, `File` if the lock file cannot be used.
    pub fn of_rig(rig: &RigSetup) -> Result<Vec<Self>, LockFileError> {
        let stream = match rig.ert() {
            ErtConfig::Tcp { address, .. } => address,
            ErtConfig::Serial { path, .. } => path,
        };
        let lines =
            rig.bench().into_iter().flat_map(|bench| bench.lines.values().map(LineConfig::port));
        let mut wires: Vec<&str> = lines.chain([stream.as_str()]).collect();
        wires.sort_unstable();
        // Several lines may have one wire.
        wires.dedup();
        let is_shared = |folder: &&str| {
            let found = Path::new(folder).metadata();
            found.is_ok_and(|found| found.mode() & STICKY_FOR_ALL == STICKY_FOR_ALL)
        };
        let folder = SHARED.into_iter().find(is_shared).unwrap_or("/tmp");
        let what = format!("the rig {}", rig.name());
        let of_wire = |wire: &str| {
            let name = format!("palpate-wire-{}.lock", &sha256_hex(wire)[..12]);
            Self::take(&Path::new(folder).join(name), &what, SHARED_MODE)
        };
        wires.into_iter().map(of_wire).collect()
    }

    fn take(path: &Path, what: &str, mode: u32) -> Result<Self, LockFileError> {
        let failed = |source| LockFileError::File { path: path.into(), source };
        let mut file = open(path, mode).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => {
                let holder = holder(&file);
                return Err(LockFileError::Held { what: what.into(), holder, path: path.into() });
            }
            Err(std::fs::TryLockError::Error(source)) => return Err(failed(source)),
        }
        file.set_len(0).map_err(failed)?;
        file.rewind().map_err(failed)?;
        let user = rustix::process::geteuid().as_raw();
        writeln!(file, "{} of user {user}", std::process::id()).map_err(failed)?;
        Ok(Self { file })
    }

    /// Adds to the note that the holder of a data folder has no rig.
    pub(super) fn note_no_rig(&mut self) {
        // Without the note others are refused.
        let _ = writeln!(self.file, "{NO_RIG}");
    }
}

/// Opens a lock file, or creates it with these rights, whatever the umask.
fn open(path: &Path, mode: u32) -> io::Result<File> {
    let mut options = File::options();
    options.read(true).write(true).mode(mode);
    match options.clone().create_new(true).open(path) {
        Ok(file) => {
            file.set_permissions(Permissions::from_mode(mode))?;
            return Ok(file);
        }
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(error),
    }
    // A pipe must not block.
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let file = options.custom_flags(flags).open(path)?;
    let found = file.metadata()?;
    // A copy of a data folder by hard links is legitimate; in a shared folder another name is an attack.
    if !found.is_file() || mode == SHARED_MODE && found.nlink() != 1 {
        return Err(io::Error::other("must be an ordinary file with one name: remove it"));
    }
    Ok(file)
}

/// What the holder wrote. Anybody may have written it: only plain characters of the start are shown.
fn holder(file: &File) -> String {
    let mut text = Vec::new();
    let _ = file.take(HOLDER_MAX_BYTES).read_to_end(&mut text);
    let plain = |c: &char| c.is_ascii_alphanumeric() || *c == ' ';
    text.into_iter().map(char::from).filter(plain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_holder_is_refused_with_the_process_id_of_the_first() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = LockFile::of_data(folder.path()).unwrap();
        let refused = LockFile::of_data(folder.path()).unwrap_err();
        assert!(!refused.is_held_without_rig(), "it may drive one");
        let refused = refused.to_string();
        let user = rustix::process::geteuid().as_raw();
        let holder = format!("by process {} of user {user} (", std::process::id());
        assert!(refused.contains(&holder), "{refused}");
        let start = format!("the data folder {} is in use", folder.path().display());
        assert!(refused.starts_with(&start), "{refused}");
        assert!(refused.contains("wait until that process ends"), "{refused}");
        first.note_no_rig();
        let refused = LockFile::of_data(folder.path()).unwrap_err();
        assert!(refused.is_held_without_rig(), "{refused}");
        assert!(refused.to_string().contains(&format!("{user} without a rig (")), "{refused}");
        drop(first);
        assert_eq!(folder.path().join("palpate.lock").metadata().unwrap().len(), 0);
        LockFile::of_data(folder.path()).unwrap();
    }

    #[test]
    fn rigs_that_share_a_wire_exclude_one_another() {
        let text = include_str!("../../../experiments/rigs/virtual.toml");
        let at = |wire: u8| format!("192.0.2.{wire}:{}", std::process::id() % 60_000 + 1);
        let rig = |stage: u8, cells: u8, stream: u8| {
            let text = text.replace("127.0.0.1:5020", &at(stage));
            let text = text.replace("127.0.0.1:5021", &at(cells));
            let text = text.replace("127.0.0.1:5030", &at(stream));
            RigSetup::from_toml("virtual.toml", &text).unwrap()
        };
        let skin = include_str!("../../../experiments/rigs/skin-only.toml");
        let skin = skin.replace("192.168.0.40:4001", &at(5));
        let skin = RigSetup::from_toml("skin-only.toml", &skin).unwrap();
        let held = LockFile::of_rig(&rig(1, 2, 5)).unwrap();
        for sharing in [rig(3, 2, 6), rig(3, 4, 5), skin] {
            let refused = LockFile::of_rig(&sharing).unwrap_err();
            assert!(matches!(refused, LockFileError::Held { .. }), "{refused:?}");
        }
        let other = LockFile::of_rig(&rig(3, 4, 6)).unwrap();
        drop((held, other));
        LockFile::of_rig(&rig(3, 2, 5)).unwrap();
    }

    #[test]
    fn a_link_is_refused_and_its_target_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("target");
        std::fs::write(&target, "a file of another user").unwrap();
        std::os::unix::fs::symlink(&target, folder.path().join("symbolic")).unwrap();
        std::fs::hard_link(&target, folder.path().join("hard")).unwrap();
        for link in ["symbolic", "hard"] {
            let refused = LockFile::take(&folder.path().join(link), "a rig", 0o666);
            assert!(matches!(refused, Err(LockFileError::File { .. })), "{link}: {refused:?}");
        }
        std::os::unix::fs::symlink(folder.path().join("absent"), folder.path().join("dangling"))
            .unwrap();
        LockFile::take(&folder.path().join("dangling"), "a rig", 0o666).unwrap_err();
        assert!(!folder.path().join("absent").exists());
        assert_eq!(std::fs::read_to_string(&target).unwrap(), "a file of another user");
    }

    #[test]
    fn every_user_can_open_the_lock_of_a_rig_and_one_user_that_of_a_data_folder() {
        let folder = tempfile::tempdir().unwrap();
        for mode in [0o666, 0o600] {
            let path = folder.path().join(format!("{mode:o}"));
            let _held = LockFile::take(&path, "a rig", mode).unwrap();
            assert_eq!(path.metadata().unwrap().mode() & 0o777, mode);
        }
    }

    #[test]
    fn what_another_user_wrote_cannot_reach_the_terminal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        std::fs::write(&path, format!("1\u{1b}[31m{}", "x".repeat(999))).unwrap();
        let shown = holder(&File::open(&path).unwrap());
        assert!(shown.starts_with("131m") && shown.len() < 61, "{shown:?}");
    }
}
