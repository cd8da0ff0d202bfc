//! The load cells on the register map of an input module, as far as all modules have it in common: which module
//! answers, the ranges of its channels, a second reading after a jump, the count of repeats.
//! Uses: `device`, `repeats`, `station`, `link`. Never: register addresses (each module knows its own),
//! newtons (the tare belongs to the campaign).

use std::fmt;
use std::ops::RangeInclusive;
use std::sync::{Arc, OnceLock};

use async_trait::async_trait;
use parking_lot::Mutex;

use super::device::CellsParts;
use super::error::RigError;
use super::link::Request;
use super::repeats::Repeats;
use super::station::Station;
use super::traits::{CellVolts, LoadCells};
use crate::clock::Clock;
use crate::record::ARMS;

/// Voltage range of an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputRange {
    /// Lower end, V.
    pub low_v: f64,
    /// Upper end, V.
    pub high_v: f64,
}

impl fmt::Display for InputRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {} V", self.low_v, self.high_v)
    }
}

/// Register map of an input module as requests and the meaning of replies. All requests are reads.
///
/// # Errors
/// `identity` returns `RigError::WrongDevice` if the module is a wrong one.
pub trait InputModule: Send + Sync + 'static {
    /// What its document calls the setting of a channel's range.
    const SETTING: &'static str;

    /// Request whose reply states which module answers.
    fn identity_request(&self) -> Request;
    /// Make and version of the module, from this reply.
    fn identity(&self, words: &[u16], station: &Station) -> Result<String, RigError>;
    /// Request for the setting of each channel, from channel 0.
    fn settings_request(&self) -> Request;
    /// Range of a channel with this setting; `None` for currents and unknown settings.
    fn range(&self, setting: u16) -> Option<InputRange>;
    /// Request for the values of at least these channels, and the channel of its first value.
    fn values_request(&self, used: RangeInclusive<u8>) -> (u8, Request);
    /// Voltage of a value in a range, V.
    fn volts(&self, raw: u16, range: InputRange) -> f64;
    /// Change between two readings above which the module is read again, V. Modbus TCP has no checksum, so a
    /// flipped bit looks like a force; it does not recur.
    fn jump_v(&self) -> f64 {
        f64::INFINITY
    }
}

/// The load cells of six channels of an input module.
#[derive(Debug)]
struct ModuleCells<M> {
    module: M,
    station: Station,
    channels: [u8; ARMS],
    full_output_v: f64,
    clock: Clock,
    ranges: OnceLock<[InputRange; ARMS]>,
    last: Mutex<Option<[f64; ARMS]>>,
    repeats: Mutex<Repeats>,
}

/// One reading of the six inputs.
struct Values {
    raw: [u16; ARMS],
    volts: [f64; ARMS],
    /// Time of the request, process s.
    asked_s: f64,
}

impl CellsParts {
    /// The load cells on a module.
    pub fn on<M: InputModule>(self, module: M) -> Arc<dyn LoadCells> {
        let Self { station, channels, update_ms, full_output_v, clock } = self;
        let (ranges, last) = (OnceLock::new(), Mutex::new(None));
        let repeats = Mutex::new(Repeats::new(update_ms));
        Arc::new(ModuleCells {
            module,
            station,
            channels,
            full_output_v,
            clock,
            ranges,
            last,
            repeats,
        })
    }
}

impl<M: InputModule> ModuleCells<M> {
    /// Words of the channels of arms 1 to 6, from a block whose first word is that of channel `first`.
    fn of_arms(&self, operation: &str, words: &[u16], first: u8) -> Result<[u16; ARMS], RigError> {
        let mut of_arms = [0; ARMS];
        for (value, &channel) in of_arms.iter_mut().zip(&self.channels) {
            let word = words.get(usize::from(channel - first)).copied();
            *value = word.ok_or_else(|| self.station.garbled(operation, "too few".into()))?;
        }
        Ok(of_arms)
    }

    async fn values(&self) -> Result<Values, RigError> {
        let ranges = self.ranges.get().ok_or_else(|| {
            self.station.not_ready("read", "its ranges have not been read yet".into())
        })?;
        let lowest = self.channels.iter().min().copied().unwrap_or(0);
        let highest = self.channels.iter().max().copied().unwrap_or(0);
        let (first, request) = self.module.values_request(lowest..=highest);
        let asked_s = self.clock.process_s();
        let words = self.station.read("values", request).await?;
        let raw = self.of_arms("values", &words, first)?;
        let volts = std::array::from_fn(|arm| self.module.volts(raw[arm], ranges[arm]));
        Ok(Values { raw, volts, asked_s })
    }
}

#[async_trait]
impl<M: InputModule> LoadCells for ModuleCells<M> {
    async fn prepare(&self) -> Result<String, RigError> {
        let words = self.station.read("identity", self.module.identity_request()).await?;
        let identity = self.module.identity(&words, &self.station)?;
        let words = self.station.read("channel settings", self.module.settings_request()).await?;
        let settings = self.of_arms("channel settings", &words, 0)?;
        let mut ranges = [InputRange { low_v: 0.0, high_v: 0.0 }; ARMS];
        for ((range, setting), channel) in ranges.iter_mut().zip(settings).zip(self.channels) {
            let known = self.module.range(setting).filter(|r| r.high_v >= self.full_output_v);
            *range = known.ok_or_else(|| {
                let found = format!("channel {channel} has {} 0x{setting:04X}", M::SETTING);
                let needed = format!("a range of 0 to {:.1} V at least", self.full_output_v);
                self.station.wrong(found, needed)
            })?;
        }
        // If the setup of the module has changed, a second `prepare` is refused, so that ranges are
        // not mixed.
        let set = *self.ranges.get_or_init(|| ranges);
        if set != ranges {
            let shown =
                |ranges: [InputRange; ARMS]| ranges.map(|range| range.to_string()).join(", ");
            let needed = format!("{}, as at the start", shown(set));
            return Err(self.station.wrong(format!("ranges {}", shown(ranges)), needed));
        }
        Ok(format!("{identity}, {}", ranges[0]))
    }

    async fn read(&self) -> Result<CellVolts, RigError> {
        let mut values = self.values().await?;
        let last = *self.last.lock();
        let jumped = |last: [f64; ARMS]| {
            let mut changes =
                values.volts.iter().zip(&last).map(|(now, before)| (now - before).abs());
            changes.any(|change| change > self.module.jump_v())
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
