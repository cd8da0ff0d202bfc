//! External programs.
//! Without the program a test reports that it was skipped; with `PALPATE_REQUIRE_TOOLS=1` it fails.

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
