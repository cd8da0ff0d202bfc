//! The signals that end or interrupt a command.
//! Uses: tokio's signals. Never: what follows from one, except for work that must be done before it can be left.

use tokio::signal::unix::{Signal, SignalKind, signal};

use super::error::{CliError, CliResult};

/// The signals that end a command.
pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Signal,
    hung_up: bool,
}

/// Signal that ends or interrupts a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asked {
    /// A person pressed Ctrl-C.
    Interrupt,
    /// The system requests the end of the process.
    Terminate,
    /// The terminal was closed.
    HangUp,
}

impl Signals {
    /// Starts to catch the signals.
    ///
    /// # Errors
    /// `CliError::System` if a handler cannot be installed.
    pub fn catch() -> CliResult<Self> {
        let one = |kind| signal(kind).map_err(CliError::system("catching signals"));
        Ok(Self {
            interrupt: one(SignalKind::interrupt())?,
            terminate: one(SignalKind::terminate())?,
            hang_up: one(SignalKind::hangup())?,
            hung_up: false,
        })
    }

    /// Carries out what a closed terminal does not end: a start, after which the service can be left.
    ///
    /// # Errors
    /// `CliError::Interrupted` after another signal, or the error of `work`.
    pub async fn during<T>(&mut self, work: impl Future<Output = CliResult<T>>) -> CliResult<T> {
        let mut work = std::pin::pin!(work);
        loop {
            tokio::select! {
                done = &mut work => return done,
                asked = self.next() => match asked {
                    Asked::HangUp => self.hung_up = true,
                    Asked::Interrupt | Asked::Terminate => return Err(CliError::Interrupted),
                },
            }
        }
    }

    /// Whether the terminal was closed during such work.
    pub fn hung_up(&self) -> bool {
        self.hung_up
    }

    /// Waits for the next signal.
    pub async fn next(&mut self) -> Asked {
        tokio::select! {
            _ = self.interrupt.recv() => Asked::Interrupt,
            _ = self.terminate.recv() => Asked::Terminate,
            _ = self.hang_up.recv() => Asked::HangUp,
        }
    }
}
