//! The service of `palpate run` or `train`, where none is running: a separate process, so that the work continues
//! when the command or its terminal is closed.
//! Uses: tokio's processes, `running`. Never: a decision for the run.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use tokio::process::{Child, Command};
use tokio::time::{Instant, sleep, timeout};

use super::bench_args::BenchArgs;
use super::client::{Client, Found};
use super::error::{CliError, CliResult};
use super::files::this_program;
use super::output::Output;
use super::progress::{Working, shown_wait};
use super::running::Running;
use crate::new_file;

/// Name of the log in the data folder.
const LOG: &str = "service.log";
/// Longest wait for the service: the first start of a virtual rig solves the skin's responses.
const SERVER_READY_WAIT: Duration = Duration::from_secs(150);
/// Interval of polling for the service.
const SERVICE_POLL: Duration = Duration::from_millis(50);
/// Longest wait for its end: it raises the tips and closes the database.
const SERVER_END_WAIT: Duration = Duration::from_secs(60);

/// A service that this command started.
pub struct OwnServer {
    /// Client with the address and key of that service.
    pub client: Client,
    child: Child,
    log: PathBuf,
}

impl OwnServer {
    /// Starts a service on a bench, and waits until it answers.
    ///
    /// `sensor`: sensor file of the skin. `output`: only text has progress.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn on_bench(
        bench: &BenchArgs,
        data: &Path,
        sensor: &Path,
        output: Output,
    ) -> CliResult<Self> {
        let mut arguments = bench.arguments();
        arguments.extend(["--sensor".into(), sensor.into()]);
        let words = "starting the service (a new skin's responses are solved once)";
        let shown = (output == Output::Text).then(|| Working::on(words));
        Self::start(&arguments, data, shown).await
    }

    /// Starts a service without a rig, and waits until it answers.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn at_desk(data: &Path) -> CliResult<Self> {
        let arguments: [OsString; 1] = ["--desk".into()];
        let start = Self::start(&arguments, data, None);
        shown_wait("starting the service", start).await
    }

    /// Starts the service on a free port of the loopback, and waits until it answers.
    ///
    /// # Errors
    /// `CliError::Child` with the last lines of its log if it ends, `Late` if it does not answer, `File` if its
    /// log cannot be written.
    async fn start(arguments: &[OsString], data: &Path, shown: Option<Working>) -> CliResult<Self> {
        new_file::make_folder(data).map_err(CliError::file(data))?;
        let log = data.join(LOG);
        let failed = |source| CliError::File { path: log.clone(), source };
        let mut out = OpenOptions::new().create(true).append(true).open(&log).map_err(failed)?;
        let begin = out.seek(SeekFrom::End(0)).map_err(failed)?;
        let errors = out.try_clone().map_err(failed)?;
        let mut command = Command::new(this_program()?);
        command.args(["serve", "--own-session", "--bind", "127.0.0.1:0", "--no-resume", "--data"]);
        command.arg(data).args(arguments);
        command.stdin(Stdio::null()).stdout(out).stderr(errors);
        let child = command.spawn().map_err(|error| ended(&error.to_string(), &log))?;
        let child = Starting(Some(child));
        let ready = answering(child, data, &log, begin).await;
        drop(shown);
        let (client, child) = ready?;
        Ok(Self { client, child, log })
    }

    /// Id of its process.
    pub fn process(&self) -> Option<u32> {
        self.child.id()
    }

    /// Ends the service and waits for it: the tips are raised, an active run is left to be resumed.
    ///
    /// # Errors
    /// `CliError::Late` if it does not end.
    pub async fn end(mut self) -> CliResult<()> {
        terminate(&self.child);
        let end = timeout(SERVER_END_WAIT, self.child.wait());
        match shown_wait("ending the service", end).await {
            Ok(_) => Ok(()),
            Err(_) => {
                let what = format!("the end of the service (its log is {})", self.log.display());
                Err(CliError::Late { what, after_s: SERVER_END_WAIT.as_secs() })
            }
        }
    }
}

/// A service that does not answer yet; it ends if its start is given up.
struct Starting(Option<Child>);

impl Drop for Starting {
    fn drop(&mut self) {
        self.0.iter().for_each(terminate);
    }
}

/// Waits until the service of this data folder answers.
async fn answering(
    mut starting: Starting,
    data: &Path,
    log: &Path,
    begin: u64,
) -> CliResult<(Client, Child)> {
    let process = starting.0.as_ref().and_then(Child::id).map(u32::cast_signed);
    let started = Instant::now();
    while started.elapsed() < SERVER_READY_WAIT {
        if let Some(Ok(Some(_))) = starting.0.as_mut().map(Child::try_wait) {
            let said = said_since(log, begin);
            let said = said.trim();
            let why = if said.is_empty() { "it ended at its start" } else { said };
            return Err(ended(why, log));
        }
        let running = Running::read(data).filter(|found| Some(found.process) == process);
        if let Some(running) = running {
            let client = Client::new(&running.url, None, None)?;
            if client.look().await? == Found::Palpate {
                let child = starting.0.take();
                return child.map(|child| (client, child)).ok_or_else(|| ended("it is gone", log));
            }
        }
        sleep(SERVICE_POLL).await;
    }
    Err(CliError::Late {
        what: "the service's first answer".into(),
        after_s: SERVER_READY_WAIT.as_secs(),
    })
}

fn terminate(child: &Child) {
    if let Some(pid) = child.id().and_then(|id| Pid::from_raw(id.cast_signed())) {
        // It may have ended already.
        let _ = kill_process(pid, Signal::TERM);
    }
}

fn ended(why: &str, log: &Path) -> CliError {
    CliError::Child { name: "service", why: why.into(), log: log.into() }
}

/// Text of a log from a position on.
fn said_since(log: &Path, begin: u64) -> String {
    let mut text = String::new();
    if let Ok(mut file) = File::open(log)
        && file.seek(SeekFrom::Start(begin)).is_ok()
    {
        // What cannot be read is not shown.
        let _ = file.read_to_string(&mut text);
    }
    text
}
