//! The wires of a rig file: the connections to Modbus devices, and that of the voltage stream.
//! PURE. Uses: `problem`. Never: ports, files, what is connected to a wire.

use serde::{Deserialize, Serialize};

use crate::problem::Checks;

/// Longest silence between frames, us: three times that of the standard at 1200 baud. A stop waits for it.
const SILENCE_MAX_US: u64 = 100_000;

/// Connection of one Modbus wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum LineConfig {
    /// Modbus TCP connection.
    ModbusTcp {
        /// `host:port`.
        address: String,
        /// Longest wait for one reply, wall ms.
        #[serde(default = "default_timeout_ms")]
        timeout_ms: u64,
        /// Consecutive failed attempts of a request after which the rig trips, 1 to 10.
        #[serde(default = "default_retries")]
        retries: u32,
    },
    /// Modbus RTU on a serial port, shared by several addresses.
    ModbusRtu {
        /// Path of the serial device.
        path: String,
        /// Baud rate, bits per second.
        baud: u32,
        /// Parity: `none`, `even` or `odd`.
        #[serde(default)]
        parity: Parity,
        /// Silence between a reply and the next request, wall us. Absent: the standard value of 3.5
        /// characters, or 1750 us above 19200 baud.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        silence_us: Option<u64>,
        /// Longest wait for one reply, wall ms.
        #[serde(default = "default_timeout_ms")]
        timeout_ms: u64,
        /// Consecutive failed attempts of a request after which the rig trips, 1 to 10.
        #[serde(default = "default_retries")]
        retries: u32,
    },
}

impl LineConfig {
    /// Longest wait for one reply, wall ms.
    pub fn timeout_ms(&self) -> u64 {
        let (Self::ModbusTcp { timeout_ms, .. } | Self::ModbusRtu { timeout_ms, .. }) = self;
        *timeout_ms
    }

    /// Address, or path of the serial device.
    pub fn port(&self) -> &str {
        let (Self::ModbusTcp { address: port, .. } | Self::ModbusRtu { path: port, .. }) = self;
        port
    }

    /// Checks the values of the wire with this name.
    pub(super) fn check(&self, name: &str, c: &mut Checks<'_>) {
        let key = |k: &str| format!("lines.{name}.{k}");
        let (timeout_ms, retries) = match self {
            Self::ModbusTcp { timeout_ms, retries, .. } => (*timeout_ms, *retries),
            Self::ModbusRtu { baud, timeout_ms, retries, silence_us, .. } => {
                let ok = (1200..=4_000_000).contains(baud);
                c.require(ok, &key("baud"), baud, "must be from 1200 to 4000000");
                let silence_us = silence_us.unwrap_or(0);
                let ok = silence_us <= SILENCE_MAX_US;
                c.require(ok, &key("silence_us"), silence_us, "must be at most 100000");
                (*timeout_ms, *retries)
            }
        };
        let ok = (5..=10_000).contains(&timeout_ms);
        c.require(ok, &key("timeout_ms"), timeout_ms, "must be from 5 to 10000");
        c.require((1..=10).contains(&retries), &key("retries"), retries, "must be 1 to 10");
    }
}

/// Parity of a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    /// No parity, 8N1.
    #[default]
    None,
    /// Even parity, 8E1.
    Even,
    /// Odd parity, 8O1.
    Odd,
}

/// Connection of the voltage stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ErtConfig {
    /// TCP connection to a serial server.
    Tcp {
        /// `host:port`.
        address: String,
        /// Number of electrodes; packets with another number are rejected.
        electrodes: u16,
        /// Frames per process second.
        frame_rate_hz: f64,
    },
    /// Serial port.
    Serial {
        /// Path of the serial device.
        path: String,
        /// Baud rate, bits per second.
        baud: u32,
        /// Number of electrodes; packets with another number are rejected.
        electrodes: u16,
        /// Frames per process second.
        frame_rate_hz: f64,
    },
}

impl ErtConfig {
    /// Number of electrodes; packets with another number are rejected.
    pub fn electrodes(&self) -> u16 {
        let (Self::Tcp { electrodes, .. } | Self::Serial { electrodes, .. }) = self;
        *electrodes
    }

    /// Path of the serial device; none on TCP.
    pub(super) fn serial_path(&self) -> Option<&str> {
        match self {
            Self::Tcp { .. } => None,
            Self::Serial { path, .. } => Some(path.as_str()),
        }
    }

    /// Frames per process second.
    pub fn frame_rate_hz(&self) -> f64 {
        let (Self::Tcp { frame_rate_hz, .. } | Self::Serial { frame_rate_hz, .. }) = self;
        *frame_rate_hz
    }

    /// Checks rate and electrodes.
    pub(super) fn check(&self, c: &mut Checks<'_>) {
        c.within("ert.frame_rate_hz", self.frame_rate_hz(), 0.1..=1000.0);
        let electrodes = self.electrodes();
        let ok = (2..=64).contains(&electrodes);
        c.require(ok, "ert.electrodes", electrodes, "must be 2 to 64");
    }
}

fn default_timeout_ms() -> u64 {
    300
}

fn default_retries() -> u32 {
    3
}
