//! Passes its commit to the program; every run stores it, and `--version` prints it. Without git it is not known, and
//! absent.
//! Uses: git, where there is one. Never: a failure of the build.

use std::path::Path;
use std::process::Command;

fn main() {
    // In a linked worktree the log is elsewhere. A path that does not exist would build everything each time.
    let log = said(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| exists(log));
    println!("cargo::rerun-if-changed={}", log.as_deref().unwrap_or("build.rs"));
    let described = said(&["describe", "--always", "--dirty", "--abbrev=40"]);
    if let Some(commit) = &described {
        println!("cargo::rustc-env=PALPATE_COMMIT={commit}");
    }
    // An image is built without git, with the commit of its command line.
    println!("cargo::rerun-if-env-changed=PALPATE_COMMIT");
    let stated = || std::env::var("PALPATE_COMMIT").ok().filter(|commit| !commit.is_empty());
    let commit = described.or_else(stated).map(|commit| format!(" ({commit})"));
    let version = env!("CARGO_PKG_VERSION");
    println!("cargo::rustc-env=PALPATE_VERSION={version}{}", commit.unwrap_or_default());
}

fn exists(path: &str) -> bool {
    Path::new(path).exists()
}

/// What git prints; `None` if there is no git, or it refuses.
fn said(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok().filter(|_| output.status.success())?;
    Some(text.trim().to_owned())
}
