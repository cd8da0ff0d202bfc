//! From a rig file to an open bench: its wires, and the drivers of its devices on them.
//! Uses: `device`, `link`, `ert_stream`. Never: the name of a device; sends a request, moves anything,
//! waits.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use super::config::{AxisDevice, AxisProfile, LineConfig, RigConfig};
use super::device::AxisParts;
use super::error::RigError;
use super::ert_stream::ErtStream;
use super::link::{
    Framing, Line, LinePolicy, MotionGate, SerialSettings, StopLatch, serial_opener, tcp_opener,
};
use super::setup::SkinConfig;
use super::station::Station;
use super::traits::{Bench, SkinReader};
use crate::clock::Clock;

/// Longest time that a stop waits for the reply to a request in flight on TCP.
const STOP_GRACE: Duration = Duration::from_millis(15);
/// Bits of a character on an RTU line: start, eight data, parity or second stop, stop.
const BITS_PER_CHARACTER: f64 = 11.0;
/// Longest reply requested on RTU, characters.
const LONGEST_REPLY: f64 = 40.0;
/// Silence between frames above 19200 baud, us (Modbus over serial line 1.02, 2.5.1.1).
const FAST_SILENCE_US: f64 = 1750.0;

/// An open bench with the owners of its wires.
#[derive(Clone)]
pub struct OpenBench {
    /// Devices that the campaign uses.
    pub bench: Bench,
    /// Wires by their names in the rig file, for their counters.
    pub lines: BTreeMap<String, Arc<Line>>,
    /// Voltage stream, with the functions that `SkinReader` does not have.
    pub stream: Arc<ErtStream>,
}

/// Creates an owner for every wire of a rig file on the current runtime, a driver for every device,
/// and the reader of the stream. Ports are opened by the first request; nothing is sent. While
/// `latch`, the emergency stop of the rig, is latched, no axis accepts a motion.
///
/// # Errors
/// `RigError::Start` if the reader cannot be started, `RigError::WrongDevice` if a device names a
/// wire that is not in `lines`.
///
/// # Panics
/// Outside a tokio runtime.
pub fn open(config: &RigConfig, clock: &Clock, latch: &StopLatch) -> Result<OpenBench, RigError> {
    let lines: BTreeMap<String, Arc<Line>> = config
        .lines
        .iter()
        .map(|(name, line)| (name.clone(), Arc::new(open_line(line, clock))))
        .collect();
    let axis = |name: &'static str, device: AxisDevice, profile: AxisProfile| {
        let station = Station::new(find(&lines, &profile.line, name)?, profile.address, name);
        let (gate, clock) = (MotionGate::new(latch.clone()), clock.clone());
        Ok(device.open(AxisParts { name, station, profile, gate, clock }))
    };
    let axes = &config.axes;
    let frame_age = Duration::from_millis(config.limits.frame_age_ms);
    let stream = Arc::new(ErtStream::open(&config.ert, frame_age, clock.clone())?);
    let cells_line = find(&lines, &config.cells.line, "cells")?;
    let station = Station::new(cells_line, config.cells.unit, "cells");
    let cells = config.cells.device.open(config.cells.parts(station, clock.clone()));
    let bench = Bench {
        x: axis("x", axes.x.device, axes.x.profile())?,
        y: axis("y", axes.y.device, axes.y.profile())?,
        z: axis("z", axes.z.device, axes.z.profile())?,
        radial: axis("radial", axes.radial.device, axes.radial.profile())?,
        cells,
        skin: Arc::clone(&stream) as Arc<dyn SkinReader>,
    };
    Ok(OpenBench { bench, lines, stream })
}

/// Starts the reader of the stream of a skin alone. Its port is opened by the reader; nothing is sent.
///
/// # Errors
/// `RigError::Start` if the reader cannot be started.
pub fn open_skin(config: &SkinConfig, clock: &Clock) -> Result<Arc<ErtStream>, RigError> {
    let frame_age = Duration::from_millis(config.limits.frame_age_ms);
    Ok(Arc::new(ErtStream::open(&config.ert, frame_age, clock.clone())?))
}

fn find(
    lines: &BTreeMap<String, Arc<Line>>,
    name: &str,
    device: &str,
) -> Result<Arc<Line>, RigError> {
    // The check of the rig file ensures it; a config built in code may lack it.
    lines.get(name).cloned().ok_or_else(|| RigError::WrongDevice {
        device: device.into(),
        found: format!("line {name}"),
        needed: "one of [lines]".into(),
    })
}

fn open_line(config: &LineConfig, clock: &Clock) -> Line {
    let (framing, port, opener) = match config {
        LineConfig::ModbusTcp { address, .. } => {
            (Framing::Tcp, address, tcp_opener(address.clone()))
        }
        LineConfig::ModbusRtu { path, baud, parity, .. } => {
            let settings = SerialSettings { path: path.clone(), baud: *baud, parity: *parity };
            (Framing::Rtu, path, serial_opener(settings))
        }
    };
    Line::spawn(framing, port, opener, policy(config), clock.clone())
}

/// Deadlines and limits that follow from the settings of a line.
pub fn policy(config: &LineConfig) -> LinePolicy {
    match config {
        LineConfig::ModbusTcp { timeout_ms, retries, .. } => LinePolicy {
            timeout: Duration::from_millis(*timeout_ms),
            attempts: *retries,
            silence: Duration::ZERO,
            stop_grace: STOP_GRACE,
        },
        LineConfig::ModbusRtu { baud, timeout_ms, retries, silence_us, .. } => {
            let character_us = BITS_PER_CHARACTER * 1e6 / f64::from(*baud);
            let standard_us =
                if *baud > 19_200 { FAST_SILENCE_US } else { (3.5 * character_us).ceil() };
            let reply = Duration::from_micros((LONGEST_REPLY * character_us) as u64);
            LinePolicy {
                timeout: Duration::from_millis(*timeout_ms),
                attempts: *retries,
                silence: Duration::from_micros(silence_us.unwrap_or(standard_us as u64)),
                stop_grace: STOP_GRACE + reply,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_rtu_line_keeps_the_silence_of_the_standard() {
        let line = |baud, silence_us| LineConfig::ModbusRtu {
            path: "p".into(),
            baud,
            parity: crate::rig::config::Parity::None,
            silence_us,
            timeout_ms: 300,
            retries: 3,
        };
        let silence = |baud, us| policy(&line(baud, us)).silence.as_micros();
        assert_eq!(silence(9600, None), 4011);
        assert_eq!(silence(115_200, None), 1750);
        assert_eq!(silence(115_200, Some(0)), 0);
        assert_eq!(policy(&line(9600, None)).stop_grace.as_millis(), 60);
    }
}
