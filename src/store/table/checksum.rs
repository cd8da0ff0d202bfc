//! Checksums of measured values: computed when they are stored, compared at every read.
//! PURE. Uses: crc32fast, `record`, `core::{columns, error}`. Never: a statement, a correction of a
//! damaged value.
//!
//! SQLite stores no checksums: a bit that flips on the disk is read as another number. Rows from before
//! migration 6 have no checksum and are not compared.

use std::borrow::Cow;

use super::trial_row::{Contact, TrialRow};
use crate::core::columns::{Columns, counts_blob, row, time_text};
use crate::core::{StoreError, StoreResult};
use crate::ids::TrialKey;
use crate::record::{ArmReading, Flag, FrameQuality, FrameRecord, Pose, TrialRecord, TrialScalars};

/// Returns the CRC-32 of a frame: of its counts as they are stored, then sequence, device time and
/// scale, little-endian.
pub(crate) fn of_frame(frame: &FrameRecord) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    sum.update(&counts_blob(&frame.counts));
    sum.update(&frame.sequence.to_le_bytes());
    sum.update(&frame.device_time_us.to_le_bytes());
    sum.update(&frame.volts_per_count.to_le_bytes());
    sum.finalize()
}

/// Returns the CRC-32 of voltages as they are stored.
pub(crate) fn of_volts(volts: &[u8]) -> u32 {
    crc32fast::hash(volts)
}

/// Compares a checksum with the stored one, if any; `what` names the value in the error.
///
/// # Errors
/// `Damaged` if they differ.
pub(crate) fn compare(
    stored: Option<u32>,
    found: u32,
    what: impl FnOnce() -> String,
) -> StoreResult<()> {
    match stored {
        Some(stored) if stored != found => Err(StoreError::damaged(format!(
            "{} was changed after it was stored (CRC-32 {found:08x}, stored {stored:08x})",
            what()
        ))),
        _ => Ok(()),
    }
}

/// Returns a frame from its columns, after comparison with its `crc32`; `of` names its owner.
///
/// # Errors
/// `Damaged` if they differ; `Sql` or `Unreadable` if a column cannot be decoded.
pub(crate) fn frame(c: &Columns<'_>, of: impl FnOnce() -> String) -> StoreResult<FrameRecord> {
    let device_time_us = c.get::<i64>("device_time_us")?.cast_unsigned();
    let frame = row!(c, FrameRecord { device_time_us },
        whole: sequence; get: volts_per_count; counts: counts);
    compare(c.whole_or_none("crc32")?, of_frame(&frame), || format!("a frame of {}", of()))?;
    Ok(frame)
}

/// Returns voltages, V, after comparison with the checksum in column `sum`; `None` for NULL. `of` names
/// their owner.
///
/// # Errors
/// `Damaged` if they differ; `Sql` or `Unreadable` if a column cannot be decoded.
pub(crate) fn volts(
    c: &Columns<'_>,
    column: &'static str,
    sum: &'static str,
    of: impl FnOnce() -> String,
) -> StoreResult<Option<Vec<f32>>> {
    let Some(bytes) = c.get::<Option<&[u8]>>(column)? else { return Ok(None) };
    let what = || format!("{column} of {}", of());
    compare(c.whole_or_none(sum)?, of_volts(bytes), what)?;
    c.volts(column, bytes).map(Some)
}

/// Usual number of bytes of the values that the checksum of a trial covers.
const SUMMED_BYTES: usize = 512;

/// Values of a trial that its checksum covers: its row, tips and placed contacts.
pub(crate) struct Numbers<'a> {
    pub key: TrialKey,
    pub attempt: u32,
    pub tips: u8,
    pub depth_mm: Option<f64>,
    pub poses: [Option<Pose>; 2],
    pub arms: &'a [ArmReading],
    pub placed: &'a [Contact],
    pub placed_by: Option<&'a str>,
    pub flags: &'a [Flag],
    pub quality: FrameQuality,
    pub settle_ms: Option<f64>,
    pub scalars: TrialScalars,
    pub contact_count: u8,
    pub max_force_n: Option<f64>,
    pub frame_count: u32,
    /// Start and measurement, as they are stored.
    pub times: [Option<Cow<'a, str>>; 2],
    pub imported_split: Option<&'a str>,
    pub imported_tag: Option<&'a str>,
}

impl<'a> Numbers<'a> {
    /// Returns the values of a trial that is to be stored.
    pub(crate) fn of_record(
        record: &'a TrialRecord,
        placed: &'a [Contact],
        contact_count: u8,
        max_force_n: Option<f64>,
    ) -> Self {
        Self {
            key: record.key,
            attempt: record.attempt,
            tips: record.tips,
            depth_mm: record.depth_mm,
            poses: [record.target, record.reached],
            arms: &record.arms,
            placed,
            placed_by: record.placed_by.as_deref(),
            flags: &record.flags,
            quality: record.quality,
            settle_ms: Some(record.settle_ms),
            scalars: record.scalars,
            contact_count,
            max_force_n,
            frame_count: record.frames.len() as u32,
            times: [record.started_at, record.measured_at].map(|at| Some(time_text(at).into())),
            imported_split: None,
            imported_tag: None,
        }
    }

    /// Returns the values of a trial that was read; `placed` are its placed contacts and `times` its start
    /// and measurement as they are stored.
    pub(crate) fn of_row(
        row: &'a TrialRow,
        placed: &'a [Contact],
        times: [Option<&'a str>; 2],
    ) -> Self {
        Self {
            key: TrialKey { configuration: row.configuration, depth_index: row.depth_index },
            attempt: row.attempt,
            tips: row.tips,
            depth_mm: row.depth_mm,
            poses: [row.target, row.reached],
            arms: &row.arms,
            placed,
            placed_by: row.placed_by.as_deref(),
            flags: &row.flags,
            quality: row.quality,
            settle_ms: row.settle_ms,
            scalars: row.scalars,
            contact_count: row.contact_count,
            max_force_n: row.max_force_n,
            frame_count: row.frame_count,
            times: times.map(|at| at.map(Cow::Borrowed)),
            imported_split: row.imported_split.as_deref(),
            imported_tag: row.imported_tag.as_deref(),
        }
    }

    /// Returns the CRC-32 of the values, in the order of this function. The order never changes: a
    /// stored checksum would differ. A value that older rows lack enters only if it is present.
    pub(crate) fn crc32(&self) -> u32 {
        let mut sum = Sum(Vec::with_capacity(SUMMED_BYTES));
        let wholes = [
            self.key.configuration,
            self.key.depth_index,
            self.attempt,
            u32::from(self.tips),
            u32::from(self.contact_count),
            self.frame_count,
        ];
        sum.numbers(wholes.map(f64::from).map(Some));
        sum.numbers([self.depth_mm, self.settle_ms, self.scalars.overshoot_n, self.max_force_n]);
        for pose in self.poses {
            let numbers = pose.map(|p| [p.x_mm, p.y_mm, p.z_mm, p.radius_mm]);
            sum.numbers((0..4).map(|i| numbers.map(|n| n[i])));
        }
        for a in self.arms {
            let numbers = [f64::from(a.arm), a.x_mm, a.y_mm, a.force_n, a.cell_v, a.tare_v];
            sum.numbers(numbers.map(Some));
        }
        for p in self.placed {
            sum.numbers([p.x_mm, p.y_mm, p.force_n, p.diameter_mm]);
        }
        let q = &self.quality;
        let counts =
            [q.saturated_channels, q.stuck_channels, q.missing_channels, q.dropped_packets];
        sum.numbers(counts.map(|n| n.map(f64::from)));
        sum.numbers([q.injection_sum_v]);
        sum.text(self.placed_by);
        for flag in self.flags {
            sum.text(Some(flag.as_str()));
        }
        for at in &self.times {
            sum.text(at.as_deref());
        }
        // The overshoot is as old as the checksums.
        sum.if_present(self.scalars.columns().filter(|(name, _)| *name != "overshoot_n"));
        // Older rows have none, and their checksum is that of before the column.
        let imported =
            [("imported_split", self.imported_split), ("imported_tag", self.imported_tag)];
        for (name, text) in imported.into_iter().filter(|(_, text)| text.is_some()) {
            sum.text(Some(name));
            sum.text(text);
        }
        sum.crc32()
    }
}

/// Values of which a checksum is computed: all at once takes a fraction of the time of one after the other.
/// An absent value differs from zero.
struct Sum(Vec<u8>);

impl Sum {
    /// Adds numbers. SQLite stores a negative zero as zero, and NaN as NULL.
    fn numbers(&mut self, values: impl IntoIterator<Item = Option<f64>>) {
        for value in values {
            match value.filter(|v| !v.is_nan()) {
                Some(value) => self.0.extend_from_slice(&(value + 0.0).to_le_bytes()),
                None => self.0.push(b'-'),
            }
        }
    }

    /// Adds the name and value of each number that is present: a row that was stored before a column
    /// was added has the same checksum with the column as without it.
    fn if_present(&mut self, columns: impl Iterator<Item = (&'static str, Option<f64>)>) {
        for (name, value) in columns {
            if value.is_some_and(|v| !v.is_nan()) {
                self.text(Some(name));
                self.numbers([value]);
            }
        }
    }

    /// Adds a text, then whether it is present.
    fn text(&mut self, value: Option<&str>) {
        self.0.extend_from_slice(value.unwrap_or_default().as_bytes());
        self.0.push(u8::from(value.is_some()));
    }

    fn crc32(&self) -> u32 {
        crc32fast::hash(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expected number was computed by another program from the bytes that rows have had since the
    /// first checksum.
    #[test]
    fn the_checksum_of_a_stored_row_never_changes() {
        let numbers = Numbers {
            key: TrialKey { configuration: 1, depth_index: 2 },
            attempt: 3,
            tips: 4,
            depth_mm: Some(0.5),
            poses: [Some(Pose { x_mm: 1.0, y_mm: 2.0, z_mm: 3.0, radius_mm: 4.0 }), None],
            arms: &[ArmReading {
                arm: 1,
                x_mm: 10.0,
                y_mm: 20.0,
                force_n: 5.5,
                cell_v: 0.7,
                tare_v: 0.5,
            }],
            placed: &[],
            placed_by: None,
            flags: &[Flag::Unsettled],
            quality: FrameQuality {
                saturated_channels: Some(7),
                injection_sum_v: Some(0.001),
                ..FrameQuality::default()
            },
            settle_ms: Some(1800.25),
            scalars: overshoot(0.125),
            contact_count: 1,
            max_force_n: Some(5.5),
            frame_count: 2,
            times: [Some("2026-11-20T18:00:00.123Z".into()), None],
            imported_split: None,
            imported_tag: None,
        };
        assert_eq!(numbers.crc32(), 0x10e258d5);
        let split = Numbers { imported_split: Some("test"), ..numbers };
        let others = [0x10e258d5, split.crc32()];
        assert_ne!(others[0], others[1]);
        let tagged = Numbers { imported_split: None, imported_tag: Some("test"), ..split };
        assert!(!others.contains(&tagged.crc32()));
    }

    /// Returns scalars of a row from before any other scalar.
    fn overshoot(value_n: f64) -> TrialScalars {
        let value = |name| Ok::<_, ()>((name == "overshoot_n").then_some(value_n));
        TrialScalars::of_columns(value).unwrap()
    }

    #[test]
    fn a_later_scalar_enters_only_if_it_is_present() {
        let sum = |columns: &[(&'static str, Option<f64>)]| {
            let mut sum = Sum(Vec::new());
            sum.numbers([Some(1.0)]);
            sum.if_present(columns.iter().copied());
            sum.crc32()
        };
        assert_eq!(sum(&[("a_n", None), ("b_n", Some(f64::NAN))]), sum(&[]));
        assert_ne!(sum(&[("a_n", Some(0.0))]), sum(&[]));
        assert_ne!(sum(&[("a_n", Some(2.0))]), sum(&[("b_n", Some(2.0))]));
    }
}
