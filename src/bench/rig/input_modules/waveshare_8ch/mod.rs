//! Waveshare Modbus RTU Analog Input 8CH (version A): eight 12-bit inputs, used for the load cells.
//! Uses: `codec`, `rig::device`, `rig::station`. Never: register addresses, newtons (the
//! tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "Waveshare 8CH". 9600 8N1 and address 1 from the factory; the
//! jumper is open for volts.

pub mod codec;

use std::sync::Arc;

use async_trait::async_trait;
use parking_lot::Mutex;

use crate::clock::Clock;
use crate::record::ARMS;
use crate::rig::device::{CellsDevice, CellsParts};
use crate::rig::error::RigError;
use crate::rig::repeats::Repeats;
use crate::rig::station::Station;
use crate::rig::traits::{CellVolts, LoadCells};

/// 12 bits: a step is 0.034 N, 55 % of the values: 41 repeats occur once in 6 x 10^10 values, once in
/// 20,000 nights.
const REPEATS_MAX: u32 = 40;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("waveshare_8ch", REPEATS_MAX, |parts| Arc::new(Waveshare8ch::new(parts)));

/// A Waveshare 8CH, version A, with a load cell on each of six channels.
#[derive(Debug)]
pub struct Waveshare8ch {
    station: Station,
    channels: [u8; ARMS],
    full_output_v: f64,
    clock: Clock,
    repeats: Mutex<Repeats>,
}

impl Waveshare8ch {
    /// Creates the driver of the module.
    pub fn new(parts: CellsParts) -> Self {
        let CellsParts { station, channels, update_ms, full_output_v, clock } = parts;
        let repeats = Mutex::new(Repeats::new(update_ms));
        Self { station, channels, full_output_v, clock, repeats }
    }
}

#[async_trait]
impl LoadCells for Waveshare8ch {
    async fn prepare(&self) -> Result<String, RigError> {
        if self.full_output_v > codec::FULL_SCALE_V {
            let found = format!("inputs up to {} V", codec::FULL_SCALE_V);
            let needed = format!("{:.1} V, the cells' full output", self.full_output_v);
            return Err(self.station.wrong(found, needed));
        }
        let version = self.station.read("version", codec::read_version()).await?;
        let modes = self.station.read("channel modes", codec::read_modes()).await?;
        for &channel in &self.channels {
            let mode = modes.get(usize::from(channel)).copied().unwrap_or(u16::MAX);
            if mode != codec::MODE_0_TO_5_V {
                let found = format!("channel {channel} is in mode {mode}");
                return Err(self.station.wrong(found, "mode 0 (0 to 5 V)".into()));
            }
        }
        let version = version.first().copied().unwrap_or(0);
        Ok(format!("Waveshare 8CH, version {}.{:02}, 0 to 5 V", version / 100, version % 100))
    }

    async fn read(&self) -> Result<CellVolts, RigError> {
        let asked_s = self.clock.process_s();
        let words = self.station.read("values", codec::read_values()).await?;
        let at = self.clock.now();
        let mut raw = [0; ARMS];
        for (value, &channel) in raw.iter_mut().zip(&self.channels) {
            let word = words.get(usize::from(channel)).copied();
            *value = word.ok_or_else(|| self.station.garbled("values", "too few".into()))?;
        }
        let mut repeats = self.repeats.lock();
        let repeats = repeats.observe(raw, asked_s, self.clock.process_s_at(at));
        Ok(CellVolts { volts: raw.map(codec::volts), repeats, at })
    }
}
