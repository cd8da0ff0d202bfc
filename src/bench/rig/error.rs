//! Errors of devices and wires, and the reaction that each requires.
//! Uses: nothing. Never: retries, waits, logging.

/// A failed operation on a device.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum RigError {
    #[error("{device}: no reply to {operation} within {timeout_ms} ms")]
    NoReply { device: String, operation: String, timeout_ms: u64 },
    /// The wire could not be opened, or the connection was lost.
    #[error("{device}: wire lost in {operation}: {cause}")]
    Disconnected { device: String, operation: String, cause: String },
    /// The reply does not fit the request.
    #[error("{device}: garbled reply to {operation}: {cause}")]
    Garbled { device: String, operation: String, cause: String },
    /// The device replied with a Modbus exception.
    #[error("{device}: {operation} answered with exception {code}")]
    Exception { device: String, operation: String, code: u8 },
    /// The device is not the one in the rig file, or has another setup.
    #[error("{device}: {found}, but the rig file needs {needed}")]
    WrongDevice { device: String, found: String, needed: String },
    /// A commanded position is outside the soft limits; nothing was sent.
    #[error("{device}: target {target:.3} is outside its travel [{min:.3}, {max:.3}]")]
    OutsideTravel { device: String, target: f64, min: f64, max: f64 },
    #[error("ert: {got} of {wanted} frames arrived within {timeout_ms} ms")]
    NoFrames { wanted: usize, got: usize, timeout_ms: u64 },
    /// The device cannot be used in its present state: alarm, emergency stop, servo off, not
    /// prepared.
    #[error("{device}: not ready for {operation}: {why}")]
    NotReady { device: String, operation: String, why: String },
    /// A motion was refused because the emergency stop is latched; nothing was sent.
    #[error("{device}: {operation} refused: the emergency stop is latched")]
    Latched { device: String, operation: String },
    /// A motion was withdrawn because its axis was commanded to stop before it was sent.
    #[error("{device}: {operation} withdrawn: the axis was commanded to stop")]
    Withdrawn { device: String, operation: String },
    #[error("{device}: cannot start its reader: {cause}")]
    Start { device: String, cause: String },
    /// The task that owns the wire has ended.
    #[error("{device}: its wire is closed")]
    Closed { device: String },
}

/// Reaction that an error requires (`docs/references.md`, "Exceptions and lost replies").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Transient fault of the wire: the driver has already retried; stop, read again, then trip.
    Transient,
    /// Wrong setup: a retry does not help; refuse the campaign.
    Setup,
    /// The device itself has failed: trip immediately.
    Device,
}

impl RigError {
    /// Returns the reaction that this error requires.
    pub fn severity(&self) -> Severity {
        match self {
            RigError::NoReply { .. }
            | RigError::Disconnected { .. }
            | RigError::Garbled { .. }
            | RigError::NoFrames { .. } => Severity::Transient,
            RigError::Exception { code: 1..=3, .. }
            | RigError::WrongDevice { .. }
            | RigError::OutsideTravel { .. }
            | RigError::Latched { .. }
            | RigError::Withdrawn { .. }
            | RigError::Start { .. } => Severity::Setup,
            RigError::Exception { code: 5 | 6 | 8 | 0x0B, .. } => Severity::Transient,
            RigError::Exception { .. } | RigError::NotReady { .. } | RigError::Closed { .. } => {
                Severity::Device
            }
        }
    }
}
