//! What a running service with TLS leaves in its data folder, so that commands on the same machine find it
//! and trust its certificate.
//! Uses: the file system. Never: a secret.

use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use reqwest::Url;
use serde::{Deserialize, Serialize};

/// Name of the file.
const FILE: &str = "server.json";

/// Address and certificate of a running service.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Running {
    /// URL on the loopback.
    pub url: String,
    /// Path of its certificate, absolute.
    pub certificate: PathBuf,
}

impl Running {
    /// Writes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, data: &Path) -> io::Result<()> {
        std::fs::write(data.join(FILE), serde_json::to_vec(self)?)
    }

    /// Removes the file, if there is one.
    pub fn remove(data: &Path) {
        // A file that remains names a server that does not answer.
        let _ = std::fs::remove_file(data.join(FILE));
    }

    /// Reads the file. Only an address on the loopback is believed: a key is sent to it.
    pub fn read(data: &Path) -> Option<Self> {
        let read: Self = serde_json::from_slice(&std::fs::read(data.join(FILE)).ok()?).ok()?;
        is_loopback(&read.url).then_some(read)
    }
}

/// Whether a URL names a loopback address.
fn is_loopback(url: &str) -> bool {
    let url: Option<Url> = url.parse().ok();
    let host = url.as_ref().and_then(Url::host_str).unwrap_or_default();
    host.trim_matches(['[', ']']).parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_service_on_this_machine_is_found() {
        let folder = std::env::temp_dir().join(format!("palpate-running-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        assert_eq!(Running::read(&folder), None);
        for (url, found) in [
            ("https://127.0.0.1:8080", true),
            ("https://[::1]:8080", true),
            ("https://127.0.0.1.evil.example:8080", false),
            ("https://127.0.0.1@evil.example", false),
            ("https://10.0.0.5:8080", false),
        ] {
            let running = Running { url: url.into(), certificate: "/c.pem".into() };
            running.write(&folder).unwrap();
            assert_eq!(Running::read(&folder), found.then_some(running), "{url}");
        }
        Running::remove(&folder);
        assert_eq!(Running::read(&folder), None);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
