//! Rows of a foreign file as trials: known columns by their names, each value checked.
//! PURE. Uses: `columns`, arrow, `store`'s imported trial. Never: files; a default for a missing measurement.

use std::collections::HashSet;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Int64Type, TimestampMillisecondType};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::Schema;
use jiff::Timestamp;

use super::columns::{CONTACT_FIELDS, Columns, FRAMES_V, TAG, is_read, known};
use super::coordinates::Coordinates;
use super::sensor::ImportedSensor;
use crate::dataset::schema::{FRAME_COUNT, SPLIT, VOLTAGES_V};
use crate::dataset::split::Part;
use crate::plain::violated;
use crate::problem::Problem;
use crate::record::{Flag, FrameQuality};
use crate::simulate::compare::Compared;
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};
use crate::store::{
    Contact, IMPORTED_CONTACTS_MAX, IMPORTED_FRAMES_MAX, ImportedTrial, TAG_MAX_CHARS,
};
use crate::syntax::PROBLEMS_MAX;

/// Largest valid force of a contact, N.
const IMPORTED_FORCE_MAX_N: f64 = 100_000.0;
/// Largest plausible magnitude of a voltage, V: beyond it the unit is another one, such as mV or counts.
const VOLTAGE_MAX_V: f32 = 1000.0;

/// Names of the columns of a file that an import reads, and of those that it ignores.
pub fn columns(schema: &Schema) -> (Vec<String>, Vec<String>) {
    schema.fields().iter().map(|field| field.name().clone()).partition(|name| is_read(name))
}

/// Converts batches, one after the other, to trials; checks that no key occurs twice.
#[derive(Debug)]
pub struct Reader<'a> {
    file: &'a str,
    sensor: &'a ImportedSensor,
    map: Coordinates,
    keys: HashSet<(u32, u32)>,
    row: u64,
    problems: Vec<Problem>,
}

impl<'a> Reader<'a> {
    /// Starts a reader for trials of a sensor, whose positions `map` converts to skin coordinates; `file` is
    /// the name of the file in messages.
    pub fn new(file: &'a str, sensor: &'a ImportedSensor, map: Coordinates) -> Self {
        Self { file, sensor, map, keys: HashSet::new(), row: 0, problems: Vec::new() }
    }

    /// Checks that the required columns exist.
    ///
    /// # Errors
    /// A problem for each missing column.
    pub fn check(&self, schema: &Schema) -> Result<(), Vec<Problem>> {
        let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
        let wanted = [
            (
                VOLTAGES_V,
                "lists of voltages (CSV: columns v0, v1, ..), or frames_v one of raw frames",
            ),
            (
                CONTACTS,
                "lists of contacts, empty for an untouched skin (CSV: x_mm, y_mm, force_n; NPZ and MAT: \
                 contacts_xy_mm)",
            ),
        ];
        let lacks = |name: &str| schema.index_of(name).is_err();
        let missing = wanted
            .into_iter()
            .filter(|(name, _)| lacks(name) && (*name != VOLTAGES_V || lacks(FRAMES_V)));
        let problems: Vec<Problem> = missing
            .map(|(name, words)| {
                let limit =
                    format!("must be a column of {words}; the file has {}", names.join(", "));
                Problem::new(self.file, name, "absent", limit)
            })
            .collect();
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    /// Converts a batch to trials.
    ///
    /// # Errors
    /// The invalid values by row and column; checking ends after 20.
    pub fn read(&mut self, batch: &RecordBatch) -> Result<Vec<ImportedTrial>, Vec<Problem>> {
        let columns = Columns::of(self.file, batch).map_err(|problem| vec![problem])?;
        let mut trials = Vec::with_capacity(batch.num_rows());
        for at in 0..batch.num_rows() {
            if let Some(trial) = self.trial(&columns, at) {
                trials.push(trial);
            }
            self.row += 1;
            if self.problems.len() >= PROBLEMS_MAX {
                break;
            }
        }
        if self.problems.is_empty() { Ok(trials) } else { Err(std::mem::take(&mut self.problems)) }
    }

    fn wrong(&mut self, column: &str, value: impl std::fmt::Display, limit: impl Into<String>) {
        // A row may have any number of them, such as a million words that are no flags.
        if self.problems.len() >= PROBLEMS_MAX {
            return;
        }
        let key = format!("row {}, {column}", self.row);
        self.problems.push(Problem::new(self.file, &key, value, limit));
    }

    /// A count; `None` if it is out of range, which is a problem.
    fn count(&mut self, column: &str, number: i64) -> Option<u32> {
        let count = u32::try_from(number).ok();
        if count.is_none() {
            self.wrong(column, "out of range", "must be a whole number from 0 to 4294967295");
        }
        count
    }

    fn trial(&mut self, columns: &Columns, at: usize) -> Option<ImportedTrial> {
        let before = self.problems.len();
        let measured = self.measured(columns, at);
        let sim_voltages_v = match columns.sim_voltages_v.as_ref().filter(|v| !v.is_null(at)) {
            Some(frames) => Some(self.frame(&frames.as_list::<i64>().value(at), SIM_VOLTAGES_V)?),
            None => None,
        };
        let contacts = self.contacts(columns, at);
        let whole = |column: &Option<ArrayRef>| -> Option<i64> {
            let column = column.as_ref()?;
            (!column.is_null(at)).then(|| column.as_primitive::<Int64Type>().value(at))
        };
        let configuration = whole(&columns.configuration).unwrap_or(self.row as i64);
        let configuration = self.count("configuration", configuration);
        let depth_index = self.count("depth_index", whole(&columns.depth_index).unwrap_or(0));
        let tips = whole(&columns.tips).map(u8::try_from).transpose();
        if tips.is_err() {
            self.wrong("tips", "out of range", "must be from 0 to 255");
        }
        let stated = self.count(FRAME_COUNT, whole(&columns.frame_count).unwrap_or(0));
        let stated = stated.unwrap_or(0);
        let raw = measured.as_ref().map_or(0, |(_, frames_v)| frames_v.len() as u32);
        if raw > 0 && stated > 0 && raw != stated {
            self.wrong(FRAME_COUNT, stated, format!("must be the {raw} frames of {FRAMES_V}"));
        }
        if let (Some(configuration), Some(depth_index)) = (configuration, depth_index)
            && !self.keys.insert((configuration, depth_index))
        {
            let value = format!("{configuration}, {depth_index}");
            self.wrong("configuration, depth_index", value, "must occur once in a file");
        }
        let flags = self.flags(columns, at);
        let depth_mm = columns.depth_mm.as_ref().and_then(|column| known(column, at));
        if depth_mm.is_some_and(f64::is_infinite) {
            self.wrong("depth_mm", "infinite", "must be finite, or null");
        }
        let started_at = columns.started_at.as_ref().filter(|times| !times.is_null(at));
        let started_at = started_at.and_then(|times| {
            let ms = times.as_primitive::<TimestampMillisecondType>().value(at);
            Timestamp::from_millisecond(ms).ok()
        });
        let text = |column: &Option<ArrayRef>| {
            let texts = column.as_ref().filter(|texts| !texts.is_null(at))?;
            let text = texts.as_string::<i32>().value(at).trim();
            (!text.is_empty()).then(|| text.to_owned())
        };
        let (split, tag) = (text(&columns.split), text(&columns.tag));
        if let Some(tag) = &tag
            && let Some(limit) = violated(tag, TAG_MAX_CHARS)
        {
            self.wrong(TAG, format!("{} characters", tag.chars().count()), limit);
        }
        if let Some(part) = split.as_ref().filter(|part| Part::named(part).is_none()) {
            self.wrong(SPLIT, part, "must be train, validation or test, or null");
        }
        if self.problems.len() > before {
            return None;
        }
        let (voltages_v, frames_v) = measured?;
        let missing = voltages_v.iter().filter(|v| v.is_nan()).count();
        let fit = sim_voltages_v.as_ref().map(|simulated| {
            let pair = Compared { measured_v: &voltages_v, simulated_v: simulated };
            let apart = pair.difference();
            (apart.rmse_v, apart.fvu)
        });
        Some(ImportedTrial {
            configuration: configuration?,
            depth_index: depth_index?,
            depth_mm,
            tips: tips.ok().flatten(),
            contacts,
            sim_voltages_v,
            fit: fit.filter(|(rmse_v, _)| rmse_v.is_finite()),
            flags,
            quality: FrameQuality {
                missing_channels: Some(missing as u32),
                ..FrameQuality::default()
            },
            started_at,
            frame_count: stated.max(raw),
            split,
            tag,
            voltages_v,
            frames_v,
        })
    }

    /// The measured frame of a trial, and its raw frames: their mean, or else the stated one without any.
    fn measured(&mut self, columns: &Columns, at: usize) -> Option<(Vec<f32>, Vec<Vec<f32>>)> {
        let known = |column: &Option<ArrayRef>| {
            column.as_ref().filter(|lists| !lists.is_null(at)).map(|l| l.as_list::<i64>().value(at))
        };
        match (known(&columns.voltages_v), known(&columns.frames_v)) {
            (Some(values), None) => Some((self.frame(&values, VOLTAGES_V)?, Vec::new())),
            (None, Some(frames)) => {
                let frames_v = self.raw_frames(&frames)?;
                Some((mean(&frames_v), frames_v))
            }
            (None, None) => {
                self.wrong(VOLTAGES_V, "null", "must be a list of voltages");
                None
            }
            (Some(_), Some(_)) => {
                let limit = format!("must be null where {FRAMES_V} has frames: it is their mean");
                self.wrong(VOLTAGES_V, "a frame", limit);
                None
            }
        }
    }

    /// The raw frames of a trial, V: complete ones, since they are stored as counts.
    fn raw_frames(&mut self, frames: &ArrayRef) -> Option<Vec<Vec<f32>>> {
        let frames = frames.as_list::<i64>();
        if !(1..=IMPORTED_FRAMES_MAX).contains(&frames.len()) {
            let limit = format!("must have 1 to {IMPORTED_FRAMES_MAX} frames, or be null");
            self.wrong(FRAMES_V, format!("{} frames", frames.len()), limit);
            return None;
        }
        let mut frames_v = Vec::with_capacity(frames.len());
        for n in 0..frames.len() {
            let name = format!("{FRAMES_V}[{n}]");
            if frames.is_null(n) {
                self.wrong(&name, "null", "must be a list of voltages");
                return None;
            }
            let frame = self.frame(&frames.value(n), &name)?;
            if let Some(channel) = frame.iter().position(|v| v.is_nan()) {
                let limit = format!(
                    "must have a value: state the mean as {VOLTAGES_V} instead, which may lack channels"
                );
                self.wrong(&format!("{name}[{channel}]"), "missing", limit);
                return None;
            }
            frames_v.push(frame);
        }
        Some(frames_v)
    }

    /// Checks the voltages of a frame.
    fn frame(&mut self, values: &ArrayRef, column: &str) -> Option<Vec<f32>> {
        let values = values.as_primitive::<Float32Type>();
        let wanted = self.sensor.channels;
        if values.len() != wanted {
            let limit = format!("must have the {wanted} values of sensor {}", self.sensor.name);
            self.wrong(column, format!("{} values", values.len()), limit);
            return None;
        }
        let frame: Vec<f32> =
            values.iter().map(|v| v.filter(|v| !v.is_nan()).unwrap_or(f32::NAN)).collect();
        if frame.iter().any(|v| v.is_infinite()) {
            self.wrong(column, "infinite", "must be finite, V; null or NaN for a missing channel");
            return None;
        }
        let large = |v: &f32| v.abs() > VOLTAGE_MAX_V;
        if let Some((channel, volts)) = frame.iter().enumerate().find(|(_, v)| large(v)) {
            let limit =
                format!("must be from -{VOLTAGE_MAX_V} to {VOLTAGE_MAX_V} V: check the unit");
            self.wrong(&format!("{column}[{channel}]"), volts, limit);
            return None;
        }
        if frame.iter().all(|v| v.is_nan()) {
            self.wrong(column, "no values", "must have at least one channel with a value");
            return None;
        }
        Some(frame)
    }

    fn contacts(&mut self, columns: &Columns, at: usize) -> Vec<Contact> {
        let Some(lists) = &columns.contacts else { return Vec::new() };
        if lists.is_null(at) {
            self.wrong(CONTACTS, "null", "must be a list, empty for an untouched skin");
            return Vec::new();
        }
        let found = lists.as_list::<i64>().value(at);
        let found = found.as_struct();
        if found.len() > IMPORTED_CONTACTS_MAX {
            let limit = format!("must have at most {IMPORTED_CONTACTS_MAX} contacts");
            self.wrong(CONTACTS, found.len(), limit);
            return Vec::new();
        }
        let number = |name: &str, contact: usize| {
            found.column_by_name(name).and_then(|column| known(column, contact))
        };
        let mut contacts = Vec::with_capacity(found.len());
        for contact in 0..found.len() {
            let [mut x_mm, mut y_mm, force_n, diameter_mm] =
                CONTACT_FIELDS.map(|name| number(name, contact));
            if let (Some(x), Some(y)) = (x_mm, y_mm) {
                [x_mm, y_mm] = self.map.apply([x, y]).map(Some);
            }
            let (width_mm, height_mm) = (self.sensor.width_mm, self.sensor.height_mm);
            for (name, value, from, most) in [
                ("x_mm", x_mm, "from", width_mm),
                ("y_mm", y_mm, "from", height_mm),
                ("force_n", force_n, "from", IMPORTED_FORCE_MAX_N),
                ("diameter_mm", diameter_mm, "above", width_mm.max(height_mm)),
            ] {
                if let Some(value) = value
                    && (!(0.0..=most).contains(&value) || from == "above" && value == 0.0)
                {
                    let mut limit = format!("must be {from} 0 to {most}, or null");
                    if name == "force_n" && value < 0.0 {
                        limit += ": a cell that reads less than 0 is not pressed, so there is no contact";
                    }
                    self.wrong(&format!("contacts[{contact}].{name}"), value, limit);
                }
            }
            if x_mm.is_some() != y_mm.is_some() {
                let limit = "must have both x_mm and y_mm, or neither";
                self.wrong(&format!("contacts[{contact}]"), "one coordinate", limit);
            }
            contacts.push(Contact { x_mm, y_mm, force_n, diameter_mm });
        }
        contacts
    }

    fn flags(&mut self, columns: &Columns, at: usize) -> Vec<Flag> {
        let Some(lists) = columns.flags.as_ref().filter(|lists| !lists.is_null(at)) else {
            return Vec::new();
        };
        let words = lists.as_list::<i64>().value(at);
        let mut flags = Vec::new();
        for word in words.as_string::<i32>().iter().flatten() {
            match serde_json::from_value(word.into()) {
                Ok(flag) => flags.push(flag),
                Err(error) => self.wrong("flags", word, error.to_string()),
            }
        }
        flags
    }
}

/// Mean of raw frames of one length, V.
fn mean(frames_v: &[Vec<f32>]) -> Vec<f32> {
    let channels = frames_v.first().map_or(0, Vec::len);
    let sum = |channel: usize| frames_v.iter().map(|frame| f64::from(frame[channel])).sum::<f64>();
    (0..channels).map(|channel| (sum(channel) / frames_v.len() as f64) as f32).collect()
}
