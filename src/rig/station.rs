//! A device at its address on a line: requests by name, so that an error says which device failed
//! in which operation.
//! Uses: `rig::link`. Never: registers' meanings, retries (those are the line's).

use std::sync::Arc;

use super::error::RigError;
use super::link::{Line, LineError, MotionPermit, Reply, Request};

/// A device at its address on a line.
#[derive(Debug, Clone)]
pub struct Station {
    line: Arc<Line>,
    unit: u8,
    device: String,
}

impl Station {
    /// The device of that name at address `unit` of a line.
    pub fn new(line: Arc<Line>, unit: u8, device: impl Into<String>) -> Self {
        Self { line, unit, device: device.into() }
    }

    /// Name in the rig file.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// The wire it hangs on.
    pub fn line(&self) -> &Arc<Line> {
        &self.line
    }

    /// Reads registers; as many words as were asked for.
    pub async fn read(&self, operation: &str, request: Request) -> Result<Vec<u16>, RigError> {
        match self.line.ask(self.unit, request).await {
            Ok(Reply::Words(words)) => Ok(words),
            Ok(other) => Err(self.garbled(operation, format!("{other:?} to a read"))),
            Err(error) => Err(self.named(operation, error)),
        }
    }

    /// Writes something that moves nothing.
    pub async fn write(&self, operation: &str, request: Request) -> Result<(), RigError> {
        self.done(operation, self.line.ask(self.unit, request).await)
    }

    /// Writes something that moves the device, while its permit holds; attempted once.
    pub async fn write_motion(
        &self,
        operation: &str,
        request: Request,
        permit: &MotionPermit,
    ) -> Result<(), RigError> {
        let answer = self.line.ask_motion(self.unit, request, permit.clone()).await;
        self.done(operation, answer)
    }

    /// Writes ahead of everything that waits.
    pub async fn write_urgent(&self, operation: &str, request: Request) -> Result<(), RigError> {
        self.done(operation, self.line.ask_urgent(self.unit, request).await)
    }

    /// A failure of the line, as this device's.
    pub fn named(&self, operation: &str, error: LineError) -> RigError {
        let (device, operation) = (self.device.clone(), operation.to_owned());
        match error {
            LineError::NoReply { timeout_ms } => {
                RigError::NoReply { device, operation, timeout_ms }
            }
            LineError::Disconnected { cause } => {
                RigError::Disconnected { device, operation, cause }
            }
            LineError::Garbled { cause } => RigError::Garbled { device, operation, cause },
            LineError::Exception { code } => RigError::Exception { device, operation, code },
            LineError::Latched => RigError::Latched { device, operation },
            LineError::Withdrawn => RigError::Withdrawn { device, operation },
            LineError::Closed => RigError::Closed { device },
        }
    }

    /// An answer that makes no sense.
    pub fn garbled(&self, operation: &str, cause: String) -> RigError {
        RigError::Garbled { device: self.device.clone(), operation: operation.into(), cause }
    }

    /// A device that cannot be used as it stands.
    pub fn not_ready(&self, operation: &str, why: String) -> RigError {
        RigError::NotReady { device: self.device.clone(), operation: operation.into(), why }
    }

    /// A device that is not the one that the rig file names.
    pub fn wrong(&self, found: String, needed: String) -> RigError {
        RigError::WrongDevice { device: self.device.clone(), found, needed }
    }

    fn done(&self, operation: &str, answer: Result<Reply, LineError>) -> Result<(), RigError> {
        answer.map(drop).map_err(|e| self.named(operation, e))
    }
}
