//! External programs, and folders for their files.
//! Without the program a test reports that it was skipped; with `PALPATE_REQUIRE_TOOLS=1` it fails.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Whether a program can be started; reports if not.
pub fn available(program: &str) -> bool {
    let quiet =
        Command::new(program).arg("-v").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if quiet.is_ok() {
        return true;
    }
    let required = std::env::var_os("PALPATE_REQUIRE_TOOLS").is_some();
    assert!(!required, "{program} is missing, and PALPATE_REQUIRE_TOOLS is set");
    println!("LEFT OUT: {program} is not installed");
    false
}

/// A folder that is removed when it is dropped.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("palpate-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("the temporary folder takes another one");
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}
