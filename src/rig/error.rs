//! What can go wrong on the wires, and what each failure asks for.
//! Uses: nothing. Never: retries, waits, logging.

/// A failed operation on a device.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// No reply within the deadline.
    #[error("{device}: no reply to {operation} within {timeout_ms} ms")]
    NoReply {
        /// Device name from the rig file.
        device: String,
        /// What was asked.
        operation: String,
        /// The deadline, wall ms.
        timeout_ms: u64,
    },
    /// The wire cannot be opened or broke.
    #[error("{device}: wire lost in {operation}: {cause}")]
    Disconnected {
        /// Device name from the rig file.
        device: String,
        /// What was asked.
        operation: String,
        /// The system's words.
        cause: String,
    },
    /// A reply that is not what was asked for.
    #[error("{device}: garbled reply to {operation}: {cause}")]
    Garbled {
        /// Device name from the rig file.
        device: String,
        /// What was asked.
        operation: String,
        /// What was wrong with it.
        cause: String,
    },
    /// A Modbus exception.
    #[error("{device}: {operation} answered with exception {code}")]
    Exception {
        /// Device name from the rig file.
        device: String,
        /// What was asked.
        operation: String,
        /// Modbus exception code.
        code: u8,
    },
    /// The device is not the one that the rig file names, or is set up otherwise.
    #[error("{device}: {found}, but the rig file needs {needed}")]
    WrongDevice {
        /// Device name from the rig file.
        device: String,
        /// What it says of itself.
        found: String,
        /// What the rig file asks for.
        needed: String,
    },
    /// A commanded position outside the soft limits; nothing was sent.
    #[error("{device}: target {target:.3} is outside its travel [{min:.3}, {max:.3}]")]
    OutsideTravel {
        /// Axis name.
        device: String,
        /// The target asked for.
        target: f64,
        /// Lower soft limit.
        min: f64,
        /// Upper soft limit.
        max: f64,
    },
    /// The stream did not give the frames asked for in time.
    #[error("ert: {wanted} frames wanted, {got} came within {timeout_ms} ms")]
    NoFrames {
        /// Frames asked for.
        wanted: usize,
        /// Frames that came.
        got: usize,
        /// The deadline, wall ms.
        timeout_ms: u64,
    },
    /// The device cannot be used as it stands: alarm, emergency stop, servo off, not prepared.
    #[error("{device}: not ready for {operation}: {why}")]
    NotReady {
        /// Device name from the rig file.
        device: String,
        /// What was asked.
        operation: String,
        /// What stands in the way.
        why: String,
    },
    /// A motion, refused because the emergency stop is latched; nothing was sent.
    #[error("{device}: {operation} refused: the emergency stop is latched")]
    Latched {
        /// Axis name.
        device: String,
        /// What was asked.
        operation: String,
    },
    /// A motion, withdrawn because its axis was told to stop before it was sent.
    #[error("{device}: {operation} withdrawn: the axis was told to stop")]
    Withdrawn {
        /// Axis name.
        device: String,
        /// What was asked.
        operation: String,
    },
    /// The part of the service that reads the stream cannot be started.
    #[error("{device}: cannot start its reader: {cause}")]
    Start {
        /// Device name from the rig file.
        device: String,
        /// The system's words.
        cause: String,
    },
    /// The task that owns a wire has ended.
    #[error("{device}: its wire is closed")]
    Closed {
        /// Device name from the rig file.
        device: String,
    },
}

/// What a failure asks for (`docs/references.md`, "Exceptions and lost replies").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Weather on the wire: the driver has already retried; stop, read again, then trip.
    Transient,
    /// Set up wrongly: no retry helps, refuse the campaign.
    Setup,
    /// The device itself has failed: trip at once.
    Device,
}

impl RigError {
    /// What this failure asks for.
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
