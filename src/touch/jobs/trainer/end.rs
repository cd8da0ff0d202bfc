//! How a trainer ended: from what it reported, and how its process ended.
//! Uses: std, pure functions. Never: a running process.

use std::fmt;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use super::TrainerError;
use crate::learn::order::Event;

/// The signal that nothing can catch.
const KILL: i32 = 9;

/// An end in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The result is in the folder.
    Done,
    /// A request ended it before its result.
    Stopped,
}

/// End of a process without a result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrainerEnd {
    /// Signal that killed it, if any.
    pub signal: Option<i32>,
    /// Its exit status, if it was not killed.
    pub code: Option<i32>,
    /// The last lines of its standard error.
    pub said: String,
}

impl fmt::Display for TrainerEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.signal, self.code) {
            (Some(KILL), _) => write!(
                f,
                "was killed by signal {KILL}, probably out of memory: a smaller training.batch \
                 needs less"
            )?,
            (Some(signal), _) => write!(f, "was killed by signal {signal}")?,
            (None, Some(code)) => write!(f, "ended with exit status {code} without a result")?,
            (None, None) => write!(f, "ended without a result")?,
        }
        if self.signal.is_some() {
            write!(f, "; the same request again resumes from its last checkpoint")?;
        }
        if self.said.is_empty() { Ok(()) } else { write!(f, "; its last lines:\n{}", self.said) }
    }
}

/// The end of a trainer whose process has ended. `reported`: its last event, if it reported an end; `said`: the
/// last lines of its standard error.
///
/// # Errors
/// `TrainerError::Failed` with what it reported; `Ended` if it ended without a report, or stopped
/// without a request.
pub fn end_of(
    reported: Option<Event>,
    status: ExitStatus,
    stop_requested: bool,
    said: String,
) -> Result<Ended, TrainerError> {
    match reported {
        Some(Event::Done) => Ok(Ended::Done),
        Some(Event::Failed { error }) => Err(TrainerError::Failed(error)),
        // Also if it had to be killed: its last checkpoint is not needed.
        _ if stop_requested => Ok(Ended::Stopped),
        _ => {
            let (signal, code) = (status.signal(), status.code());
            Err(TrainerError::Ended(TrainerEnd { signal, code, said }))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `wait` reports a signal in the low bits, a code in the next ones.
    fn killed(signal: i32) -> ExitStatus {
        ExitStatus::from_raw(signal)
    }

    fn ended(code: i32) -> ExitStatus {
        ExitStatus::from_raw(code << 8)
    }

    #[test]
    fn a_reported_end_counts_and_an_unreported_one_names_signal_or_status() {
        let of = |reported, status, stop_requested| {
            end_of(reported, status, stop_requested, "last words".into())
        };
        let text = |event, status| of(event, status, false).unwrap_err().to_string();
        assert_eq!(of(Some(Event::Done), ended(0), false).unwrap(), Ended::Done);
        // The result is whole before it is reported.
        assert_eq!(of(Some(Event::Done), killed(9), true).unwrap(), Ended::Done);
        assert_eq!(of(Some(Event::Stopped), ended(0), true).unwrap(), Ended::Stopped);
        assert_eq!(of(None, killed(9), true).unwrap(), Ended::Stopped);
        let failed = Event::Failed { error: "recipe: epochs".into() };
        assert_eq!(text(Some(failed), ended(1)), "recipe: epochs");
        let out_of_memory = text(None, killed(9));
        assert!(
            out_of_memory.starts_with("the trainer was killed by signal 9, probably out of memory")
        );
        assert!(out_of_memory.ends_with("its last lines:\nlast words"), "{out_of_memory}");
        assert!(text(None, killed(11)).starts_with("the trainer was killed by signal 11;"));
        let panicked = text(None, ended(101));
        assert!(
            panicked.starts_with("the trainer ended with exit status 101 without a result; its")
        );
        assert!(text(Some(Event::Stopped), ended(0)).contains("exit status 0 without a result"));
    }
}
