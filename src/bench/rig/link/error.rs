//! Why a request on a wire failed.
//! PURE. Uses: nothing. Never: what follows (`exchange`, and the driver).

/// Error of a request on a line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LineError {
    #[error("no reply within {timeout_ms} ms")]
    NoReply { timeout_ms: u64 },
    /// The wire could not be opened, or the connection was lost.
    #[error("wire lost: {cause}")]
    Disconnected { cause: String },
    /// The reply does not fit the request.
    #[error("garbled reply: {cause}")]
    Garbled { cause: String },
    /// The device replied with a Modbus exception.
    #[error("exception {code}")]
    Exception { code: u8 },
    /// A motion was refused because the emergency stop of the rig is latched.
    #[error("the emergency stop is latched")]
    Latched,
    /// A motion was withdrawn because its axis was commanded to stop before it was sent.
    #[error("withdrawn by a stop")]
    Withdrawn,
    /// The task that owns the wire has ended.
    #[error("the wire is closed")]
    Closed,
}
