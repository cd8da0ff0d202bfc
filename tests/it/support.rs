//! What several tests need: the sensor, a folder, a process that ends with its test, Python.
//! Never: an assertion about Palpate.

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use palpate::cli::trust;
use sim_core::sensor::Sensor;

/// The program.
pub const PALPATE: &str = env!("CARGO_BIN_EXE_palpate");

/// Text of the sensor file of 28 electrodes.
pub const SENSOR: &str = include_str!("../../experiments/sensors/ert-28.toml");

/// Text of the virtual rig's file.
pub const VIRTUAL_RIG: &str = include_str!("../../experiments/rigs/virtual.toml");

/// The sensor of 28 electrodes.
pub fn sensor() -> Sensor {
    Sensor::from_toml(SENSOR).unwrap()
}

/// A client without TLS.
pub fn http() -> reqwest::Client {
    trust::http(trust::tls("http:", None).unwrap()).unwrap()
}

/// A folder in the system's temporary folder, removed at the end of its test. The name contains the
/// process id; within this binary `name` must be unique.
pub struct Folder(PathBuf);

impl Folder {
    /// Creates the folder, empty.
    pub fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("palpate-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&folder).ok();
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    /// Path of a file in it, as an argument of a command.
    pub fn path(&self, name: &str) -> String {
        self.join(name).display().to_string()
    }
}

impl Deref for Folder {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

/// A process that is killed, at the latest, at the end of its test.
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A Python that can import these modules (`PALPATE_PYTHON`, otherwise `python3`). Without one the test
/// prints `LEFT OUT`.
///
/// # Panics
///
/// If there is none and `PALPATE_REQUIRE_TOOLS` is set.
pub fn python(modules: &str) -> Option<String> {
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&python)
        .args(["-c", &format!("import {modules}")])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if found {
        return Some(python);
    }
    let missing = format!("no Python that has {modules}");
    assert!(std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(), "{missing}");
    println!("LEFT OUT: {missing} (set PALPATE_PYTHON)");
    None
}
