//! Errors of commands, with their exit codes.
//! Uses: `problem`, the errors of `api` and `rig`. Never: printing (`drawn` does it), the method or path of
//! a request in a message: a person asked for a command (`PALPATE_LOG=debug` shows the requests).

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use sim_core::calibration::CalibrationError;

use crate::api::{LockFileError, ServeError};
use crate::calibrate::CalibrateError;
use crate::calibrate::skin::SkinError;
use crate::chunk::error::ChunkError;
use crate::dataset::error::DatasetError;
use crate::evaluate::figures::FigureError;
use crate::journal::error_chain;
use crate::plain::system_words;
use crate::problem::Problem;
use crate::program::ProgramError;
use crate::rig::error::RigError;
use crate::simulate::model::ModelUnavailable;
use crate::simulate::random::error::RandomError;
use crate::store::StoreError;

/// Result of a command or of a part of it.
pub type CliResult<T> = Result<T, CliError>;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum CliError {
    /// Values in files, options or requests are invalid.
    #[error("{}", lines(.0))]
    Problems(Vec<Problem>),
    #[error(
        "no palpate service at {url}; start one with `palpate serve`, or name it with --url or \
         PALPATE_URL"
    )]
    NoServer { url: String },
    /// No service answers `palpate status`, and none was named.
    #[error("{0}; `palpate runs` reads a data folder without a service")]
    NoStatus(Box<CliError>),
    #[error(
        "something else than palpate answers at {url}; name the address of palpate with --url or \
         PALPATE_URL"
    )]
    Stranger { url: String },
    /// An emergency stop has not reached a rig.
    #[error(
        "NOTHING WAS STOPPED: {0}\nUSE THE EMERGENCY STOP ON THE RIG, or cut the power of its drives."
    )]
    NotStopped(Box<CliError>),
    /// An emergency stop was sent, and nothing answered.
    #[error(
        "THE STOP IS NOT CONFIRMED: {0}\nUSE THE EMERGENCY STOP ON THE RIG, or cut the power of its drives."
    )]
    StopUnanswered(Box<CliError>),
    #[error(
        "the certificate of {url} is not trusted: {why}; name its file, or that of its authority, with \
         --ca or PALPATE_CA"
    )]
    Untrusted { url: String, why: String },
    /// TLS is not available.
    #[error("TLS: {0}; name the certificate of the service with --ca or PALPATE_CA")]
    Tls(#[from] rustls::Error),
    /// A request had no answer, or an invalid one.
    #[error("{}", unanswered(.0))]
    Http(#[from] reqwest::Error),
    #[error(
        "the recording was cut before its {frames} frames were there, and no file was written: the rig sent no frame \
         for 10 s, or the service ended"
    )]
    Cut { frames: u64 },
    #[error("the connection to the service failed: {0}")]
    Socket(#[source] Box<tokio_tungstenite::tungstenite::Error>),
    /// The service refused the request.
    #[error("{detail}")]
    Refused {
        /// HTTP status code.
        status: u16,
        /// Reason, as stated by the service.
        detail: String,
        /// Whether the same request may succeed later, as the service stated (`Retry-After`).
        again: bool,
    },
    /// A file could not be read or written.
    #[error("{path}: {}", io_words(source), path = path.display())]
    File { path: PathBuf, source: io::Error },
    /// Another program listens at the address of a service that starts.
    #[error(
        "{bind} is in use by {by}: choose another port with --bind, such as --bind {free} for a free one"
    )]
    PortTaken { bind: SocketAddr, by: String, free: SocketAddr },
    /// The service could not be started in this process.
    #[error("starting the service: {0}")]
    Serve(#[from] ServeError),
    /// The database of the data folder failed, or refused a value.
    #[error("{}", error_chain(.0))]
    Store(#[from] StoreError),
    /// The runtime, the signals or the terminal are not available.
    #[error("{operation}: {source}")]
    System { operation: &'static str, source: io::Error },
    /// A child process did not start.
    #[error("{name}: {why} (log: {log})", log = log.display())]
    Child { name: &'static str, why: String, log: PathBuf },
    /// Another process holds the rig.
    #[error(transparent)]
    Locked(#[from] LockFileError),
    /// The rig cannot be opened.
    #[error("opening the rig: {0}")]
    Rig(#[from] RigError),
    /// No program converts a figure.
    #[error(
        "{path}: was not written: PNG and PDF need rsvg-convert or Chromium, and none of them is in \
         PATH; install `librsvg2-bin` or `chromium`, or name a file that ends in .svg",
        path = path.display()
    )]
    NoConverter { path: PathBuf },
    /// The program that converts a figure failed.
    #[error("{path}: was not written: {why}; name a file that ends in .svg", path = path.display())]
    NotConverted { path: PathBuf, why: String },
    /// The model of the skin is not available.
    #[error(transparent)]
    Model(#[from] ModelUnavailable),
    /// Sim-Random's shards could not be made.
    #[error(transparent)]
    SimRandom(#[from] RandomError),
    /// One of several datasets could not be made, after others.
    #[error("{name} was not made: {error}\nmade before it: {}", made.join(", "))]
    NotAllMade { name: String, made: Vec<String>, error: Box<CliError> },
    #[error("{} of {all} rigs did not answer with a dataset: {}", missed.len(), missed.join(", "))]
    Missed { missed: Vec<String>, all: usize },
    /// The folder of a work order could not be used, or chunks could not be made or gathered.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// A program that this one starts is missing, or cannot be built.
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error("the rig is tripped: {detail}; check the rig, then run `palpate rig reset`")]
    Tripped { detail: String },
    /// What a person named does not exist.
    #[error("{0}")]
    NoSuch(String),
    #[error("no run is active")]
    Idle,
    #[error(
        "no run is paused, stopped or interrupted; one that was aborted or has failed is resumed by its \
         number: palpate resume RUN"
    )]
    NothingToResume,
    #[error("{what}: the motion was ended early: {by}; palpate status shows the rig")]
    MotionEnded { what: String, by: String },
    #[error("{what} did not happen within {after_s} s")]
    Late { what: String, after_s: u64 },
    #[error("rig {rig} is real: confirm its motion at the terminal or with --yes")]
    NotConfirmed { rig: String },
    #[error(
        "rig {rig}: its motion was confirmed {after_s:.0} s after the question, limit {limit_s} s: nothing moves; \
         check the rig, then run the command again"
    )]
    ConfirmedLate { rig: String, after_s: f64, limit_s: u64 },
    #[error(
        "standard output: {}; the command was carried out, but its answer is incomplete", io_words(.0)
    )]
    Unsaid(io::Error),
    #[error("interrupted before it was done")]
    Interrupted,
    #[error("ended by a signal: the next service resumes the training from its checkpoint")]
    Terminated,
    #[error("the rig check found {0} problems")]
    Unsound(usize),
    /// A figure could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The fit failed for another reason than its input.
    #[error(transparent)]
    Calibrate(CalibrateError),
    /// The trials of a run do not yield a calibrated skin.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// A calibration does not match its use.
    #[error("calibration: {0}")]
    Calibration(#[from] CalibrationError),
    /// A file made by this program could not be written as text.
    #[error("writing TOML: {0}")]
    Toml(#[from] toml::ser::Error),
}

impl CliError {
    /// Error for one option or argument.
    pub fn argument(key: &str, value: impl std::fmt::Display, limit: impl Into<String>) -> Self {
        Problem::new("command line", key, value, limit).into()
    }

    /// Error for a file as a whole.
    pub fn in_file(path: &Path, limit: impl Into<String>) -> Self {
        Problem::whole(&path.display().to_string(), limit).into()
    }

    /// Conversion of an error of the operating system at a file.
    pub fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::File { path: path.into(), source }
    }

    /// Conversion of an error of the operating system in an operation without a file.
    pub fn system(operation: &'static str) -> impl Fn(io::Error) -> Self {
        move |source| Self::System { operation, source }
    }

    /// Conversion of an error of the operating system at a file that is read because a person named it.
    pub fn input(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::in_file(path, io_words(&error))
    }

    /// Exit code: 2 for bad input, 1 for everything else.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.code())
    }

    /// The exit code as a number.
    pub fn code(&self) -> u8 {
        match self {
            CliError::Problems(_)
            | CliError::NotConfirmed { .. }
            | CliError::Store(StoreError::Refused { .. })
            | CliError::Serve(
                ServeError::Rig { .. }
                | ServeError::NoKey(_)
                | ServeError::NoKeyAtAll
                | ServeError::Tls(_),
            )
            | CliError::SimRandom(RandomError::OtherDefinition { .. })
            | CliError::Chunk(
                ChunkError::NoOrder { .. }
                | ChunkError::Order { .. }
                | ChunkError::OtherOrder { .. }
                | ChunkError::Index { .. },
            )
            | CliError::Refused { status: 400 | 422, .. } => 2,
            _ => 1,
        }
    }
}

impl From<Problem> for CliError {
    fn from(problem: Problem) -> Self {
        Self::Problems(vec![problem])
    }
}

impl From<Vec<Problem>> for CliError {
    fn from(problems: Vec<Problem>) -> Self {
        Self::Problems(problems)
    }
}

/// Error of work on files of datasets in this process.
impl From<DatasetError> for CliError {
    fn from(error: DatasetError) -> Self {
        match error {
            DatasetError::Problems(problems) => Self::Problems(problems),
            DatasetError::File { path, source, .. } => Self::File { path, source },
            error => Self::Refused { status: 400, detail: error.to_string(), again: false },
        }
    }
}

/// Cause of a failed read or write of a file.
pub fn io_words(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::InvalidData => "is not text (UTF-8)".into(),
        _ => system_words(error),
    }
}

/// Why a request has no usable answer.
fn unanswered(error: &reqwest::Error) -> String {
    let host = error.url().map_or_else(
        || "the service".into(),
        |url| {
            let port = url.port().map_or_else(String::new, |port| format!(":{port}"));
            format!("the service at {}{port}", url.host_str().unwrap_or("?"))
        },
    );
    let mut causes = std::iter::successors(Some(error as &dyn std::error::Error), |e| e.source());
    let cause = causes.by_ref().last().map(ToString::to_string).unwrap_or_default();
    let cause = cause.split(" (os error").next().unwrap_or_default();
    match () {
        () if error.is_timeout() => format!("{host} did not answer in time"),
        () if error.is_decode() => {
            format!(
                "{host} does not answer as palpate does: it is another program, or another version"
            )
        }
        () => format!("{host} did not answer: {cause}"),
    }
}

fn lines(problems: &[Problem]) -> String {
    problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n")
}
