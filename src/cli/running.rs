//! What a running service leaves in its data folder, so that commands on the same machine find it, and trust
//! its certificate if it has one.
//! Uses: the file system. Never: a secret.

use std::io;
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use reqwest::Url;
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};
use serde::{Deserialize, Serialize};

use crate::new_file;

/// Name of the file.
const FILE: &str = "server.json";
/// Rights of the group and of others to write.
const OTHERS_WRITE: u32 = 0o022;

/// Address, process and certificate of a running service.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Running {
    /// URL on the loopback.
    pub url: String,
    /// Id of its process.
    pub process: i32,
    /// The certificate that it shows, PEM: its file may be renewed while the service runs. Absent without TLS.
    pub certificate: Option<String>,
}

impl Running {
    /// Writes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, data: &Path) -> io::Result<()> {
        new_file::write(data, FILE, &serde_json::to_string(self)?).map(drop)
    }

    /// Removes the file, if there is one.
    pub fn remove(data: &Path) {
        // A file that remains names a service that does not answer.
        let _ = std::fs::remove_file(data.join(FILE));
    }

    /// Reads the file. A key is sent to its address: so only an address on the loopback is believed,
    /// and only of a file that no other user than root can have written.
    pub fn read(data: &Path) -> Option<Self> {
        let path = data.join(FILE);
        if !is_ours(data) || !is_ours(&path) {
            return None;
        }
        let read: Self = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        (is_loopback(&read.url) && is_alive(read.process)).then_some(read)
    }
}

/// Whether only this user, or root, can change a file or folder.
fn is_ours(path: &Path) -> bool {
    let me = rustix::process::geteuid().as_raw();
    path.metadata()
        .is_ok_and(|found| [me, 0].contains(&found.uid()) && found.mode() & OTHERS_WRITE == 0)
}

/// Whether there is such a process: a service that was killed leaves its file, and another program may listen
/// at its address.
pub fn is_alive(process: i32) -> bool {
    let Some(pid) = Pid::from_raw(process) else { return false };
    // A process of another user is alive, although it must not be signalled.
    !matches!(test_kill_process(pid), Err(Errno::SRCH))
}

/// Whether a URL names a loopback address.
fn is_loopback(url: &str) -> bool {
    let url: Option<Url> = url.parse().ok();
    let host = url.as_ref().and_then(Url::host_str).unwrap_or_default();
    host.trim_matches(['[', ']']).parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn running(url: &str) -> Running {
        let process = std::process::id().cast_signed();
        Running { url: url.into(), process, certificate: Some("PEM".into()) }
    }

    #[test]
    fn only_a_service_on_this_machine_is_found() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path();
        assert_eq!(Running::read(folder), None);
        for (url, found) in [
            ("https://127.0.0.1:8080", true),
            ("https://[::1]:8080", true),
            ("https://127.0.0.1.evil.example:8080", false),
            ("https://127.0.0.1@evil.example", false),
            ("https://10.0.0.5:8080", false),
        ] {
            let running = running(url);
            running.write(folder).unwrap();
            assert_eq!(Running::read(folder), found.then_some(running), "{url}");
        }
        let gone = Running { process: i32::MAX, ..running("https://[::1]:1") };
        gone.write(folder).unwrap();
        assert_eq!(Running::read(folder), None, "its process has ended");
        running("https://[::1]:1").write(folder).unwrap();
        let everybody = std::fs::Permissions::from_mode(0o666);
        std::fs::set_permissions(folder.join(FILE), everybody).unwrap();
        assert_eq!(Running::read(folder), None, "anybody may have written it");
        Running::remove(folder);
        assert_eq!(Running::read(folder), None);
    }
}
