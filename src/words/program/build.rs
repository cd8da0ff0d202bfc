//! Builds a program when it is first needed, and passes on what cargo compiles.
//! Uses: cargo as a process. Never: which program is built (`find`).

use std::process::Stdio;

use tokio::process::Command;

use super::find::Build;
use super::lines::{Lines, push_last};
use super::{Known, ProgramError, STOP_POLL, withhold};

/// Variables that cargo sets for the program that it runs, and that would change a build.
const OF_CARGO: [&str; 5] =
    ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_NAME", "CARGO_PRIMARY_PACKAGE"];

/// Builds a program; returns `false` if `is_stopped` became true meanwhile. `seen` receives what cargo
/// does.
///
/// # Errors
/// `ProgramError::Cargo` if cargo cannot be started; `Build` if it fails.
pub async fn build(
    known: &'static Known,
    build: &Build,
    mut seen: impl FnMut(&str),
    is_stopped: impl Fn() -> bool,
) -> Result<bool, ProgramError> {
    let failed = |source| ProgramError::Cargo { known, source };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["build", "--bin", known.name, "--profile", &build.profile]);
    command.arg("--target-dir").arg(&build.target).current_dir(&build.workspace);
    let names = std::env::vars_os().map(|(name, _)| name);
    let foreign = |name: &str| OF_CARGO.iter().any(|start| name.starts_with(start));
    for name in names.filter(|name| name.to_str().is_some_and(foreign)) {
        command.env_remove(name);
    }
    // Dependencies have programs that are run during a build.
    withhold(command.as_std_mut());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // Cargo builds what is missing, whenever it was ended.
    command.process_group(0).kill_on_drop(true);
    seen("starting cargo");
    let mut child = command.spawn().map_err(failed)?;
    let mut lines = Lines::of(child.stderr.take());
    let mut last = Vec::new();
    let mut look = tokio::time::interval(STOP_POLL);
    loop {
        tokio::select! {
            line = lines.next() => {
                let Some(line) = line else { break };
                let line = line.trim();
                if line.starts_with("Compiling") || line.starts_with("Blocking") {
                    seen(line);
                }
                push_last(&mut last, line.to_owned());
            }
            _ = look.tick() => {
                if is_stopped() {
                    return Ok(false);
                }
            }
        }
    }
    let status = child.wait().await.map_err(failed)?;
    if status.success() {
        return Ok(true);
    }
    Err(ProgramError::Build { known, said: last.join("\n") })
}
