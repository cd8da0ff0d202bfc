//! A device at its address on a line: requests with a name, so that an error names the device and
//! the operation.
//! Uses: `rig::link`. Never: meanings of registers, retries (the line has those).

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
    /// Creates the device with this name at address `unit` of a line.
    pub fn new(line: Arc<Line>, unit: u8, device: impl Into<String>) -> Self {
        Self { line, unit, device: device.into() }
    }

    /// Name of the device in the rig file.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Wire of the device.
    pub fn line(&self) -> &Arc<Line> {
        &self.line
    }

    /// Reads registers; returns as many words as were requested.
    ///
    /// # Errors
    /// The error of the line, with device and operation; `RigError::Garbled` for another reply.
    pub async fn read(&self, operation: &str, request: Request) -> Result<Vec<u16>, RigError> {
        match self.line.ask(self.unit, request).await {
            Ok(Reply::Words(words)) => Ok(words),
            Ok(other) => Err(self.garbled(operation, format!("{other} in reply to a read"))),
            Err(error) => Err(self.named(operation, error)),
        }
    }

    /// Writes a register or coil that causes no motion.
    ///
    /// # Errors
    /// The error of the line, with device and operation.
    pub async fn write(&self, operation: &str, request: Request) -> Result<(), RigError> {
        self.done(operation, self.line.ask(self.unit, request).await)
    }

    /// Writes a register or coil that moves the device, while its permit holds; attempted once.
    ///
    /// # Errors
    /// The error of the line, with device and operation.
    pub async fn write_motion(
        &self,
        operation: &str,
        request: Request,
        permit: &MotionPermit,
    ) -> Result<(), RigError> {
        let answer = self.line.ask_motion(self.unit, request, permit.clone()).await;
        self.done(operation, answer)
    }

    /// Writes before all queued requests.
    ///
    /// # Errors
    /// The error of the line, with device and operation.
    pub async fn write_urgent(&self, operation: &str, request: Request) -> Result<(), RigError> {
        self.done(operation, self.line.ask_urgent(self.unit, request).await)
    }

    /// Converts an error of the line to an error of this device.
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

    /// Error for an invalid reply.
    pub fn garbled(&self, operation: &str, cause: String) -> RigError {
        RigError::Garbled { device: self.device.clone(), operation: operation.into(), cause }
    }

    /// Error for a device that cannot be used in its present state.
    pub fn not_ready(&self, operation: &str, why: String) -> RigError {
        RigError::NotReady { device: self.device.clone(), operation: operation.into(), why }
    }

    /// Error for a device that is not the one in the rig file.
    pub fn wrong(&self, found: String, needed: String) -> RigError {
        RigError::WrongDevice { device: self.device.clone(), found, needed }
    }

    fn done(&self, operation: &str, answer: Result<Reply, LineError>) -> Result<(), RigError> {
        answer.map(drop).map_err(|e| self.named(operation, e))
    }
}
