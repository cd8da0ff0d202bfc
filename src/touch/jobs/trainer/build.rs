//! Builds the trainer when it is first needed, and shows cargo's progress as the job's phase.
//! Uses: cargo as a process. Never: which trainer is built (`program`).

use std::process::Stdio;

use tokio::process::Command;

use super::TrainerError;
use super::lines::{Lines, push_last};
use super::program::{Build, NAME};
use crate::jobs::Watch;

/// Phase of a job while the trainer is built.
const PHASE: &str = "building the trainer: once, some minutes";
/// Interval at which a stop is noticed.
const LOOK: std::time::Duration = std::time::Duration::from_millis(100);

/// Variables that cargo sets for the program that it runs, and that would change a build.
const OF_CARGO: [&str; 5] =
    ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_NAME", "CARGO_PRIMARY_PACKAGE"];

/// Builds the trainer; returns `false` if the job was stopped meanwhile.
///
/// # Errors
/// `TrainerError::Cargo` if cargo cannot be started; `Build` if it fails.
pub async fn build(build: &Build, watch: &Watch) -> Result<bool, TrainerError> {
    watch.phase(PHASE, 0);
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["build", "--bin", NAME, "--profile", &build.profile]);
    command.arg("--target-dir").arg(&build.target).current_dir(&build.source);
    let names = std::env::vars_os().map(|(name, _)| name);
    let foreign = |name: &str| OF_CARGO.iter().any(|start| name.starts_with(start));
    for name in names.filter(|name| name.to_str().is_some_and(foreign)) {
        command.env_remove(name);
    }
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // Cargo builds what is missing, whenever it was ended.
    command.process_group(0).kill_on_drop(true);
    let mut child = command.spawn().map_err(TrainerError::Cargo)?;
    let mut lines = Lines::of(child.stderr.take());
    let mut last = Vec::new();
    let mut look = tokio::time::interval(LOOK);
    loop {
        tokio::select! {
            line = lines.next() => {
                let Some(line) = line else { break };
                let line = line.trim();
                if line.starts_with("Compiling") || line.starts_with("Blocking") {
                    watch.phase(&format!("{PHASE}: {line}"), 0);
                }
                push_last(&mut last, line.to_owned());
            }
            _ = look.tick() => {
                if watch.is_stopped() {
                    return Ok(false);
                }
            }
        }
    }
    let status = child.wait().await.map_err(TrainerError::Cargo)?;
    if status.success() { Ok(true) } else { Err(TrainerError::Build(last.join("\n"))) }
}
