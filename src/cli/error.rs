//! Why a command cannot do what it was asked, and with which exit code it says so.
//! Uses: `problem`, the errors of `api` and `rig`. Never: printing, HTTP status codes as decisions.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use sim_core::calibration::CalibrationError;

use crate::api::{LockFileError, ServeError};
use crate::calibrate::CalibrateError;
use crate::calibrate::skin::SkinError;
use crate::evaluate::figures::FigureError;
use crate::problem::Problem;
use crate::rig::error::RigError;
use crate::simulate::model::ModelUnavailable;
use crate::simulate::random::error::RandomError;

/// Why a command ended without doing what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Files, options or requests hold values that cannot be used.
    #[error("{}", lines(.0))]
    Problems(Vec<Problem>),
    /// Nobody answers there.
    #[error(
        "no palpate server at {url}; start one with `palpate serve`, or name it with --url or PALPATE_URL"
    )]
    NoServer {
        /// Where it was looked for.
        url: String,
    },
    /// A request had no answer, or one that makes no sense.
    #[error("{operation}: {source}")]
    Http {
        /// What was asked.
        operation: String,
        /// Why it failed.
        source: reqwest::Error,
    },
    /// A stream of messages broke.
    #[error("{operation}: {source}")]
    Socket {
        /// What was asked.
        operation: String,
        /// Why it broke.
        source: Box<tokio_tungstenite::tungstenite::Error>,
    },
    /// The service refuses.
    #[error("{operation}: {detail}")]
    Refused {
        /// What was asked.
        operation: String,
        /// HTTP status.
        status: u16,
        /// The service's words.
        detail: String,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The service could not be started in this process.
    #[error("starting the service: {0}")]
    Serve(#[from] ServeError),
    /// The runtime, the signals or the terminal could not be had.
    #[error("{operation}: {source}")]
    System {
        /// What was wanted.
        operation: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// A child process did not come up.
    #[error("{name}: {why}; its log is {log}", log = log.display())]
    Child {
        /// Which.
        name: &'static str,
        /// In words.
        why: String,
        /// Where it wrote what it said.
        log: PathBuf,
    },
    /// Another process has the rig.
    #[error(transparent)]
    Locked(#[from] LockFileError),
    /// The rig cannot be opened.
    #[error("opening the rig: {0}")]
    Rig(#[from] RigError),
    /// There is no model of the skin.
    #[error(transparent)]
    Model(#[from] ModelUnavailable),
    /// Sim-Random's shards could not be made.
    #[error(transparent)]
    SimRandom(#[from] RandomError),
    /// The rig is tripped.
    #[error("the rig is tripped: {detail}; look at it, then `palpate rig reset`")]
    Tripped {
        /// What tripped it.
        detail: String,
    },
    /// Nothing runs.
    #[error("no run is under way")]
    Idle,
    /// Something did not happen in time.
    #[error("{what} did not happen within {after_s} s")]
    Late {
        /// What was waited for.
        what: String,
        /// The deadline, s.
        after_s: u64,
    },
    /// A real rig moves only after a yes.
    #[error("rig {rig} is real: it moves after a yes at the terminal, or with --yes")]
    NotConfirmed {
        /// Its name.
        rig: String,
    },
    /// A signal came before the run started.
    #[error("interrupted before the run started")]
    Interrupted,
    /// The rig check found something wrong.
    #[error("the rig check found {0} problems")]
    Unsound(usize),
    /// A figure could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// The model cannot be fitted, for another reason than its input.
    #[error(transparent)]
    Calibrate(CalibrateError),
    /// A run gives no calibrated skin.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// A calibration does not fit what it is used with.
    #[error("calibration: {0}")]
    Calibration(#[from] CalibrationError),
    /// A file made by this program could not be written as text.
    #[error("writing TOML: {0}")]
    Toml(#[from] toml::ser::Error),
}

impl CliError {
    /// A problem with one option or argument.
    pub fn argument(key: &str, value: impl std::fmt::Display, limit: impl Into<String>) -> Self {
        Self::Problems(vec![Problem::new("command line", key, value, limit)])
    }

    /// 2 for bad input, 1 for everything else.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            CliError::Problems(_)
            | CliError::NotConfirmed { .. }
            | CliError::SimRandom(RandomError::OtherDefinition { .. })
            | CliError::Refused { status: 400 | 422, .. } => ExitCode::from(2),
            _ => ExitCode::FAILURE,
        }
    }
}

fn lines(problems: &[Problem]) -> String {
    problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n")
}
