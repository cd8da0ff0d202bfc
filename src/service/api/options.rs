//! What a service is started with, and why it does not start.
//! Uses: the errors of its parts. Never: a service.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use sim_core::calibration::Calibration;
use sim_core::sensor::Sensor;

use super::{LockFileError, Tls, TlsError};
use crate::conductor::AutoResume;
use crate::dataset::error::DatasetError;
use crate::infer::error::InferError;
use crate::journal::error_chain;
use crate::plain::system_words;
use crate::store::{Sharing, StoreError};

/// Options of a service.
#[derive(Debug, Clone)]
pub struct ServeOptions {
    /// Address to listen on; port 0 selects a free port.
    pub bind: SocketAddr,
    /// Data folder.
    pub data: PathBuf,
    /// Database that is only read, where it is, instead of the one in the data folder, and its use by other processes;
    /// its tables are current (`Store::read_in_place`).
    pub in_place: Option<(PathBuf, Sharing)>,
    /// Name of the rig file in messages.
    pub rig_file: String,
    /// Text of the rig file.
    pub rig_text: String,
    /// True: nothing is driven. The rig's lock is not taken, and its wires are not opened.
    pub desk: bool,
    /// True: it answers, and makes nothing by itself: no twins, datasets, exports or jobs that wait. No model or skin is
    /// loaded: a request for answers to frames would wait for it.
    pub idle: bool,
    /// Certificate and key for TLS; `None`: requests and keys travel readable.
    pub tls: Option<Tls>,
    /// True: every request needs a key, on loopback, too, except the e-stop and /health.
    pub require_key: bool,
    /// True: callers without a key, on loopback, may also make and revoke keys.
    pub local_admin: bool,
    /// Whether runs of the previous process resume automatically.
    pub resume: AutoResume,
    /// Number of threads that simulate twins; 0 simulates none.
    pub twin_workers: usize,
    /// Calibration for the twins of runs on its sensor.
    pub calibration: Option<Calibration>,
    /// Sensor of the skin under the rig.
    pub sensor: Sensor,
    /// Text of the sensor file.
    pub sensor_text: String,
}

/// Why a service did not start.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ServeError {
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Rig { problems: Vec<crate::problem::Problem> },
    #[error("{}", data_words(path, source))]
    Data { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Locked(#[from] LockFileError),
    #[error("{}", error_chain(.0))]
    Store(#[from] StoreError),
    #[error("listening at {bind}: {}; choose another address with --bind", system_words(source))]
    Bind { bind: SocketAddr, source: std::io::Error },
    #[error(
        "bind = {0}: must be a loopback address while there is no API key; run `palpate key create NAME`"
    )]
    NoKey(SocketAddr),
    #[error("require-key = true: there is no API key; run `palpate key create NAME --role admin`")]
    NoKeyAtAll,
    #[error("{}", error_chain(.0))]
    Tls(#[from] TlsError),
    #[error(transparent)]
    Datasets(#[from] DatasetError),
    #[error(transparent)]
    Models(#[from] InferError),
    /// The thread of the campaign or of the door cannot be started.
    #[error("starting a thread: {0}")]
    Thread(#[source] std::io::Error),
}

/// Why a data folder cannot be used. For a file in its place, such as the database, its folder is proposed.
fn data_words(path: &Path, error: &std::io::Error) -> String {
    let shown = path.display();
    if !path.is_file() {
        return format!("data folder {shown}: {}", system_words(error));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).display();
    format!("data folder {shown}: is a file, not a folder; did you mean `{folder}`?")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_in_place_of_the_data_folder_names_its_folder() {
        let temporary = tempfile::tempdir().unwrap();
        let data = temporary.path().join("palpate.db");
        std::fs::write(&data, "").unwrap();
        let words = |path: PathBuf| {
            let source = std::io::Error::from(std::io::ErrorKind::AlreadyExists);
            ServeError::Data { path, source }.to_string()
        };
        let (file, folder) = (data.display(), temporary.path().display());
        let wanted =
            format!("data folder {file}: is a file, not a folder; did you mean `{folder}`?");
        assert_eq!(words(data.clone()), wanted);
        let none = words(temporary.path().join("none"));
        assert!(!none.contains("did you mean"), "{none}");
    }
}
