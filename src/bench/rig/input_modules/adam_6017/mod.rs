//! Advantech ADAM-6017: eight 16-bit analog inputs over Modbus TCP, used for the six load cells.
//! Uses: `codec`, `rig::device`, `rig::station`. Never: register addresses, newtons (the
//! tare belongs to the campaign).
//!
//! Source: `docs/references.md`, "ADAM-6017".

pub mod codec;

use std::sync::Arc;
use std::sync::OnceLock;

use async_trait::async_trait;
use parking_lot::Mutex;

use self::codec::Range;
use crate::clock::Clock;
use crate::record::ARMS;
use crate::rig::device::{CellsDevice, CellsParts};
use crate::rig::error::RigError;
use crate::rig::repeats::Repeats;
use crate::rig::station::Station;
use crate::rig::traits::{CellVolts, LoadCells};

/// A step is 0.002 N, which 4 % of the values fall into: 9 repeats occur once in 10^14 values.
const REPEATS_MAX: u32 = 8;

/// The module as rig files name it.
pub const MODULE: CellsDevice =
    CellsDevice::new("adam_6017", REPEATS_MAX, |parts| Arc::new(Adam6017::new(parts)));

/// Change between two readings above which the module is read again, V. Modbus TCP has no checksum,
/// so a flipped bit looks like a force; it does not recur.
const JUMP_V: f64 = 0.4;

/// An ADAM-6017 with a load cell on each of six channels.
#[derive(Debug)]
pub struct Adam6017 {
    station: Station,
    channels: [u8; ARMS],
    full_output_v: f64,
    clock: Clock,
    ranges: OnceLock<[Range; ARMS]>,
    last: Mutex<Option<[f64; ARMS]>>,
    repeats: Mutex<Repeats>,
}

/// One reading of the six inputs, V.
struct Values {
    raw: [u16; ARMS],
    volts: [f64; ARMS],
    /// Time of the request, process s.
    asked_s: f64,
}

impl Adam6017 {
    /// Creates the driver of the module.
    pub fn new(parts: CellsParts) -> Self {
        let CellsParts { station, channels, update_ms, full_output_v, clock } = parts;
        let (ranges, last) = (OnceLock::new(), Mutex::new(None));
        let repeats = Mutex::new(Repeats::new(update_ms));
        Self { station, channels, full_output_v, clock, ranges, last, repeats }
    }

    async fn values(&self) -> Result<Values, RigError> {
        let ranges = self.ranges.get().ok_or_else(|| {
            self.station.not_ready("read", "its ranges have not been read yet".into())
        })?;
        let first = self.channels.iter().min().copied().unwrap_or(0);
        let last = self.channels.iter().max().copied().unwrap_or(0);
        let request = codec::read_values(u16::from(first), u16::from(last - first) + 1);
        let asked_s = self.clock.process_s();
        let words = self.station.read("values", request).await?;
        let mut raw = [0; ARMS];
        for (value, &channel) in raw.iter_mut().zip(&self.channels) {
            let word = words.get(usize::from(channel - first)).copied();
            *value = word.ok_or_else(|| self.station.garbled("values", "too few".into()))?;
        }
        let volts = std::array::from_fn(|arm| ranges[arm].volts(raw[arm]));
        Ok(Values { raw, volts, asked_s })
    }
}

#[async_trait]
impl LoadCells for Adam6017 {
    async fn prepare(&self) -> Result<String, RigError> {
        let model = self.station.read("model", codec::read_model()).await?;
        if model != [codec::MODEL] {
            let found = format!("model {:04X}", model.first().copied().unwrap_or(0));
            return Err(self.station.wrong(found, "an ADAM-6017 (6017)".into()));
        }
        let types = self.station.read("channel types", codec::read_types()).await?;
        let mut ranges = [Range::Volts0To5; ARMS];
        for (range, &channel) in ranges.iter_mut().zip(&self.channels) {
            let code = types.get(usize::from(channel)).copied().unwrap_or(0);
            let known = Range::of_code(code).filter(|r| r.ends_v()[1] >= self.full_output_v);
            *range = known.ok_or_else(|| {
                let found = format!("channel {channel} has type 0x{code:04X}");
                let needed = format!("a voltage range up to {:.1} V at least", self.full_output_v);
                self.station.wrong(found, needed)
            })?;
        }
        // If the setup of the module has changed, a second `prepare` is refused, so that ranges are
        // not mixed.
        let set = *self.ranges.get_or_init(|| ranges);
        if set != ranges {
            let shown = |ranges: [Range; ARMS]| ranges.map(|range| range.to_string()).join(", ");
            let needed = format!("{}, as at the start", shown(set));
            return Err(self.station.wrong(format!("ranges {}", shown(ranges)), needed));
        }
        Ok(format!("ADAM-6017, {}", ranges[0]))
    }

    async fn read(&self) -> Result<CellVolts, RigError> {
        let mut values = self.values().await?;
        let last = *self.last.lock();
        let jumped = |last: [f64; ARMS]| {
            values.volts.iter().zip(&last).any(|(now, before)| (now - before).abs() > JUMP_V)
        };
        if last.is_some_and(jumped) {
            values = self.values().await?;
        }
        let (Values { raw, volts, asked_s }, at) = (values, self.clock.now());
        *self.last.lock() = Some(volts);
        let mut repeats = self.repeats.lock();
        let repeats = repeats.observe(raw, asked_s, self.clock.process_s_at(at));
        Ok(CellVolts { volts, repeats, at })
    }
}
