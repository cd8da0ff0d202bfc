//! Faults: which occur, at which device, from when and for how long; written as scripts (`parse`).
//! Uses: serde. Never: clocks, wires; the affected part implements the effect of a fault.
//!
//! ```toml
//! [[fault]]
//! kind = "no_reply"
//! device = "z"
//! at_s = 12.0          # process time; or at_frame, or at_press (nth press into contact)
//! for_s = 0.5          # process time; absent: until the rig ends
//! count = 3            # at most 3 times
//! ```

mod board;
mod parse;

pub use board::{ActiveFault, Board};
pub use parse::{FaultError, from_json, script};

use serde::Deserialize;

use crate::config::AxisName;

/// Part of a reply that is garbled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The transaction number (TCP) or the checksum (RTU): detected by the client.
    Header,
    /// A bit of the data: detected by the checksum on RTU, undetected on TCP.
    Payload,
    /// The last byte is missing.
    Cut,
}

/// Effect of a fault on one request, or on a wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WireFault {
    /// No reply arrives.
    NoReply {
        /// Whether the request is executed.
        executed: bool,
    },
    /// The device replies with a Modbus exception of this code.
    Exception(u8),
    /// The connection is closed; on a serial line no bytes pass.
    Disconnect {
        /// Whether the request in progress is executed.
        executed: bool,
    },
    /// The reply arrives late.
    Late {
        /// Delay, wall ms.
        delay_ms: u64,
    },
    /// The reply arrives damaged.
    Garbled(Part),
}

/// Fault of a load cell, or of the tip on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CellFault {
    /// The cell is disconnected: 0 V.
    Dead,
    /// The cell is saturated.
    Saturated,
    /// The output of the cell does not change.
    Frozen,
    /// The zero of the cell drifts.
    Drifting {
        /// Rate of the drift, N per process second.
        n_per_s: f64,
    },
    /// An external load on the cell, also without a tip.
    Loaded {
        /// Force, N; negative if it pulls.
        n: f64,
    },
    /// The tip is lost: its arm never presses, and its cell stays connected.
    MissingTip,
    /// The cell does not measure the force of its tip, which still presses: it returns zero with
    /// noise.
    Uncoupled,
}

/// Damage of bytes of the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damage {
    /// Bytes are lost.
    Drop,
    /// A bit is flipped.
    Flip,
    /// A byte is doubled.
    Double,
}

/// Kind of a fault, with its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// A request or a wire fails.
    Wire(WireFault),
    /// The motor does not turn.
    StuckAxis {
        /// Time until the drive detects it, process s; absent: never.
        alarm_after_s: Option<f64>,
    },
    /// The drive raises an alarm.
    Alarm {
        /// Alarm code of the drive.
        code: u16,
    },
    /// The drive loses power for a moment.
    PowerLoss,
    /// The drive switches its motor off, without an alarm.
    MotorOff,
    /// Reads return the values from the begin of the fault.
    StaleRegisters,
    /// A cell fails.
    Cell {
        /// Index of its arm, from 0.
        arm: usize,
        /// What happens to it.
        fault: CellFault,
    },
    /// Bytes of the stream are damaged.
    Bytes {
        /// Fraction of the packets affected.
        rate: f64,
        /// What happens to them.
        damage: Damage,
    },
    /// The stream sends no frames.
    StallStream,
}

/// Target device of the fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// The drive of one axis.
    Axis(AxisName),
    /// The module of the load cells.
    Cells,
    /// The voltage stream.
    Ert,
    /// A Modbus wire with all its devices.
    Line(String),
}

/// Start of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// At a process time, s.
    Time(f64),
    /// At a sequence number of the frames.
    Frame(u32),
    /// At the nth press into contact, from 1.
    Press(u64),
    /// When the fault is set.
    Now,
}

/// A checked fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: Kind,
    /// Target device of the fault.
    pub target: Target,
    /// Start of the fault.
    pub start: Start,
    /// Duration, process s; absent: until the rig ends.
    pub for_s: Option<f64>,
    /// Largest number of times that it occurs; absent: unlimited.
    pub count: Option<u32>,
}
