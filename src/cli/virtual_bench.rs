//! The virtual bench as two child processes of this program: the rig and its operator.
//! Uses: tokio's processes, `bench_args`, `files`, `api::LockFile`. Never: the virtual rig's code (only its command line
//! is used), a child that outlives this process: each ends when the pipe to its standard input closes.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use serde::Deserialize;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, ChildStdout, Command};
use tokio::time::timeout;

use super::bench_args::BenchArgs;
use super::error::{CliError, CliResult};
use super::files::{self, DEFAULT_SKIN_SEED, RigFiles, write};
use super::key::KEY_VARIABLE;
use super::progress::Working;
use crate::api::{LockFile, ServeError};
use crate::new_file;
use crate::program::withhold;
use crate::rig::config::RigLabel;

/// Longest wait for the rig: its first start solves the skin's unit responses.
const RIG_READY_WAIT: Duration = Duration::from_secs(120);
/// Longest wait for a child to end after its input is closed.
const CHILD_END_WAIT: Duration = Duration::from_secs(3);
/// Free space below which a disk counts as full, bytes.
const NO_SPACE_BYTES: u64 = 4 << 20;
/// Number of lines of a child's log that are shown when it fails.
const LOG_LINES: usize = 8;

/// A running virtual rig.
pub struct VirtualBench {
    /// Its rig file, with the actual addresses.
    pub rig: RigFiles,
    control: String,
    speed: f64,
    folder: PathBuf,
    child: Child,
    // Kept open, so that the rig can always write.
    _stdout: BufReader<ChildStdout>,
    operator: Option<Child>,
}

/// The line by which the rig reports that it listens.
#[derive(Debug, Deserialize)]
struct Ready {
    control: String,
}

impl VirtualBench {
    /// Writes the files of a bench that simulates `rig`, with a skin of this sensor file, starts it, and waits until it
    /// listens.
    ///
    /// # Errors
    /// `CliError::Locked` if another process uses the data folder; `Child` or `Late` if it does not
    /// start; `Serve` if the data folder cannot be created, `File` if a file cannot be written.
    pub async fn switch_on(
        args: &BenchArgs,
        data: &Path,
        rig: &RigFiles,
        sensor_text: &str,
    ) -> CliResult<Self> {
        let unusable = |source| ServeError::Data { path: data.to_owned(), source };
        new_file::make_folder(data).map_err(unusable)?;
        let folder = data.join("virtual-rig");
        new_file::make_folder(&folder).map_err(CliError::file(&folder))?;
        // The files and the log there may be those of the bench of another service.
        drop(LockFile::of_data(data)?);
        let served = folder.join("served.toml");
        // Data of a virtual rig must not be labelled as measured.
        let mut config = rig.config.clone();
        config.set_label(RigLabel::Virtual);
        let texts = [toml::to_string(&config)?, args.gap_text()?, sensor_text.to_owned()];
        for (name, text) in BENCH_FILES.iter().zip(texts) {
            write(&folder.join(name), &text)?;
        }
        let mut command = rig_command(args, &folder, &served, &data.join("cache"))?;
        let log = folder.join("rig.log");
        let mut child = start("virtual rig", &mut command, &log, Stdio::piped())?;
        let stdout = child.stdout.take().ok_or_else(|| failed("virtual rig", "no pipe", &log))?;
        let mut stdout = BufReader::new(stdout);
        let shown = Working::on("virtual rig: solving the skin's responses (once)");
        let ready = ready_line(&mut stdout, &log).await;
        drop(shown);
        // A child cannot write why it ended on a full disk.
        let control = ready.map_err(|error| disk_full(&folder).unwrap_or(error))?.control;
        let text = std::fs::read_to_string(&served).map_err(CliError::file(&served))?;
        let rig = RigFiles::parse(served.display().to_string(), text)?;
        let speed = args.speed();
        Ok(Self { rig, control, speed, folder, child, _stdout: stdout, operator: None })
    }

    /// Starts the operator as a client of a service, without TLS; with a key if the service needs one.
    ///
    /// # Errors
    /// `CliError::Child` or `System` if it does not start.
    pub fn send_operator(&mut self, url: &str, key: Option<&str>) -> CliResult<()> {
        let mut command = this_program("virtual-operator")?;
        command.args(["--url", url, "--control", &self.control, "--with-parent"]);
        command.arg("--speed").arg(self.speed.to_string());
        // A key is sent only where it is needed, and the service in this process needs no proxy.
        if let Some(key) = key {
            command.env(KEY_VARIABLE, key);
        }
        command.env("NO_PROXY", "*");
        let log = self.folder.join("operator.log");
        self.operator = Some(start("virtual operator", &mut command, &log, Stdio::null())?);
        Ok(())
    }

    /// Ends the operator and the rig; call it once the service has raised the tips.
    pub async fn switch_off(mut self) {
        if let Some(operator) = &mut self.operator {
            end(operator).await;
        }
        end(&mut self.child).await;
    }
}

/// Names of the files of rig, differences of the skin, and skin.
const BENCH_FILES: [&str; 3] = ["rig.toml", "gap.toml", "sensor.toml"];

fn rig_command(args: &BenchArgs, folder: &Path, served: &Path, cache: &Path) -> CliResult<Command> {
    let mut command = this_program("virtual-rig")?;
    for (option, name) in ["--rig", "--gap", "--sensor"].into_iter().zip(BENCH_FILES) {
        command.arg(option).arg(folder.join(name));
    }
    command.arg("--seed").arg(args.skin_seed.unwrap_or(DEFAULT_SKIN_SEED).to_string());
    command.arg("--age-days").arg(args.skin_age_days.unwrap_or(0.0).to_string());
    command.arg("--speed").arg(args.speed().to_string());
    command.arg("--ephemeral").arg("--out-rig").arg(served);
    command.arg("--cache").arg(cache).arg("--with-parent");
    if let Some(fault) = &args.fault {
        command.arg("--fault").arg(files::fault_script(folder, fault)?);
    }
    Ok(command)
}

fn this_program(subcommand: &str) -> CliResult<Command> {
    let mut command = Command::new(files::this_program()?);
    command.arg(subcommand);
    withhold(command.as_std_mut());
    Ok(command)
}

fn start(name: &'static str, command: &mut Command, log: &Path, stdout: Stdio) -> CliResult<Child> {
    let said = File::create(log).map_err(CliError::file(log))?;
    // A separate process group: this program handles Ctrl-C, the rig must keep running.
    command.process_group(0).kill_on_drop(true);
    command.stdin(Stdio::piped()).stdout(stdout).stderr(said);
    command.spawn().map_err(|e| failed(name, &e.to_string(), log))
}

async fn ready_line(stdout: &mut BufReader<ChildStdout>, log: &Path) -> CliResult<Ready> {
    let name = "virtual rig";
    let mut line = String::new();
    match timeout(RIG_READY_WAIT, stdout.read_line(&mut line)).await {
        Err(_) => Err(CliError::Late {
            what: "the virtual rig's start".into(),
            after_s: RIG_READY_WAIT.as_secs(),
        }),
        Ok(Err(e)) => Err(failed(name, &e.to_string(), log)),
        Ok(Ok(0)) => Err(failed(name, &format!("ended at its start{}", tail(log)), log)),
        Ok(Ok(_)) => serde_json::from_str(&line)
            .map_err(|e| failed(name, &format!("printed {}: {e}", line.trim()), log)),
    }
}

/// The error of a folder whose disk has no space left.
fn disk_full(folder: &Path) -> Option<CliError> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    let is_full = disk.f_bavail.saturating_mul(disk.f_frsize) < NO_SPACE_BYTES;
    let source = std::io::ErrorKind::StorageFull.into();
    is_full.then(|| CliError::File { path: folder.into(), source })
}

fn failed(name: &'static str, why: &str, log: &Path) -> CliError {
    CliError::Child { name, why: why.into(), log: log.into() }
}

/// Last lines of a log, for an error.
fn tail(log: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let lines: Vec<&str> = text.lines().collect();
    let last = &lines[lines.len().saturating_sub(LOG_LINES)..];
    if last.is_empty() { String::new() } else { format!(": {}", last.join("; ")) }
}

/// Closes the child's pipe, which ends it; a child that remains is killed.
async fn end(child: &mut Child) {
    drop(child.stdin.take());
    if timeout(CHILD_END_WAIT, child.wait()).await.is_err() {
        tracing::warn!("a child process had to be killed");
        let _ = child.kill().await;
    }
}
