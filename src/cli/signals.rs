//! The signals that end or interrupt a command.
//! Uses: tokio's signals. Never: what follows from one.

use tokio::signal::unix::{Signal, SignalKind, signal};

use super::error::{CliError, CliResult};

/// The signals that end a command.
pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Signal,
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
        let one = |kind| {
            signal(kind)
                .map_err(|source| CliError::System { operation: "catching signals", source })
        };
        Ok(Self {
            interrupt: one(SignalKind::interrupt())?,
            terminate: one(SignalKind::terminate())?,
            hang_up: one(SignalKind::hangup())?,
        })
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
