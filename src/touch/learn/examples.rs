//! A dataset laid out for training: frames in one flat file, read row by row; contacts in memory.
//! Uses: `dataset::read`, arrow. Never: frames in memory, rows that the dataset does not have.
//!
//! Parquet yields rows in order, training needs them shuffled: frames are therefore copied once.
//! The file contains, for each row, the measured and (if requested) the simulated frame,
//! little-endian f32.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, UInt32Type};
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use sim_core::stats::norm;

use super::error::LearnError;
use super::model_file::TrainedRange;
use crate::dataset::format::Rows;
use crate::dataset::read::DatasetRows;
use crate::dataset::schema::{FRAME_COUNT, SPLIT};
use crate::dataset::select::Wanted;
use crate::dataset::split::Part;
use crate::ids::TrialId;
use crate::new_file;
use crate::simulate::schema::CONTACTS;
use crate::store::Contact;

/// Column with the number of a trial in the store.
const TRIAL_ID: &str = "trial_id";

/// Rows of a dataset.
#[derive(Debug)]
pub struct Examples {
    /// Number of values in a frame.
    pub channels: usize,
    columns: Vec<&'static str>,
    file: File,
    parts: Vec<Option<Part>>,
    contacts: Vec<Contact>,
    /// End of each row's contacts in the list of all contacts.
    ends: Vec<usize>,
    trial_ids: Vec<Option<i64>>,
    frame_counts: Vec<u32>,
    /// Euclidean norm of each row's first frame, V.
    norms_v: Vec<f32>,
}

impl Examples {
    /// Copies the rows of a dataset that meet `conditions` to an unnamed file in `folder`; `frames`
    /// are the requested columns, in this order.
    ///
    /// # Errors
    /// `LearnError` if the file cannot be read, or a column or a frame of a row is missing.
    pub fn gather(
        data_file: &Path,
        conditions: &[String],
        frames: &[&'static str],
        folder: &Path,
    ) -> Result<Self, LearnError> {
        let mut columns: Vec<String> = frames.iter().map(|&name| name.to_owned()).collect();
        columns.push(CONTACTS.into());
        let all = DatasetRows::open(data_file, &Wanted::default())?;
        let has = |name: &str| all.schema().column_with_name(name).is_some();
        for &name in frames {
            if !has(name) {
                let limit = "is not a column of this dataset";
                return Err(LearnError::value("dataset", "column", name, limit));
            }
        }
        let others = [SPLIT, TRIAL_ID, FRAME_COUNT].into_iter().filter(|name| has(name));
        columns.extend(others.map(str::to_owned));
        let conditions = conditions.to_vec();
        let wanted = Wanted { columns, conditions, ..Wanted::default() };
        let rows = DatasetRows::open(data_file, &wanted)?;
        let file = unnamed_file(folder).map_err(LearnError::file("creating a file in", folder))?;
        let mut examples = Self {
            channels: frame_length(&rows, frames[0])?,
            columns: frames.to_vec(),
            file,
            parts: Vec::new(),
            contacts: Vec::new(),
            ends: Vec::new(),
            trial_ids: Vec::new(),
            frame_counts: Vec::new(),
            norms_v: Vec::new(),
        };
        let copy = examples.file.try_clone().map_err(LearnError::file("opening", folder))?;
        let mut out = BufWriter::with_capacity(1 << 20, copy);
        for batch in rows.batches(None)? {
            examples.append(&batch?, &mut out, folder)?;
        }
        out.flush().map_err(LearnError::file("writing to", folder))?;
        Ok(examples)
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The rows of a part, in the dataset's order.
    pub fn part(&self, part: Part) -> Vec<u32> {
        let rows = self.parts.iter().enumerate();
        rows.filter(|(_, of)| **of == Some(part)).map(|(row, _)| row as u32).collect()
    }

    /// The contacts of a row.
    pub fn contacts(&self, row: u32) -> &[Contact] {
        let row = row as usize;
        let start = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.contacts[start..self.ends[row]]
    }

    /// Reads a row's frame of a column (by its place among those gathered) into `frame`.
    ///
    /// # Errors
    /// `LearnError::File` if the flat file cannot be read.
    ///
    /// # Panics
    /// If the length of `frame` is not that of a frame.
    pub fn frame(&self, row: u32, column: usize, frame: &mut [f32]) -> Result<(), LearnError> {
        assert_eq!(frame.len(), self.channels, "a frame of {} numbers", self.channels);
        let at = (row as usize * self.columns.len() + column) * self.channels * 4;
        let mut bytes = [0_u8; 4096];
        for (index, piece) in frame.chunks_mut(bytes.len() / 4).enumerate() {
            let bytes = &mut bytes[..piece.len() * 4];
            self.file
                .read_exact_at(bytes, (at + index * 4096) as u64)
                .map_err(LearnError::file("reading frames of", Path::new("a training's file")))?;
            for (number, bytes) in piece.iter_mut().zip(bytes.as_chunks().0) {
                *number = f32::from_le_bytes(*bytes);
            }
        }
        Ok(())
    }

    /// The number of a row's trial in the store; `None` for free simulations.
    pub fn trial_id(&self, row: u32) -> Option<TrialId> {
        self.trial_ids[row as usize].map(TrialId)
    }

    /// Number of raw frames in the mean of a row's measured frame; 0 if it is unknown.
    pub fn frame_count(&self, row: u32) -> u32 {
        self.frame_counts[row as usize]
    }

    /// Range of these rows: the trained range of a net trained on them.
    pub fn range(&self, rows: &[u32]) -> TrainedRange {
        let counts: BTreeSet<u32> =
            rows.iter().map(|&row| self.contacts(row).len() as u32).collect();
        let contacts = || rows.iter().flat_map(|&row| self.contacts(row));
        let max_force_n = contacts().filter_map(|c| c.force_n).reduce(f64::max);
        TrainedRange {
            contact_counts: counts.into_iter().collect(),
            max_force_n: max_force_n.filter(|&most| most > 0.0),
            forces_unknown: max_force_n.is_none() && contacts().next().is_some(),
            max_norm_v: rows
                .iter()
                .map(|&row| f64::from(self.norms_v[row as usize]))
                .reduce(f64::max)
                .filter(|&most| most > 0.0),
        }
    }

    fn append(
        &mut self,
        batch: &RecordBatch,
        out: &mut impl Write,
        folder: &Path,
    ) -> Result<(), LearnError> {
        let column = |name: &str| batch.column_by_name(name);
        let mut frames = Vec::with_capacity(self.columns.len());
        for &name in &self.columns {
            let frame = column(name).and_then(|c| c.as_fixed_size_list_opt());
            let frame = frame.filter(|f| f.value_length() as usize == self.channels);
            let frame = frame
                .ok_or_else(|| LearnError::value("dataset", "column", name, DIFFERENT_LENGTHS))?;
            if frame.null_count() > 0 {
                let rows = format!("{name} of {} rows", frame.null_count());
                let limit = "is missing: exclude these rows";
                return Err(LearnError::value("dataset", "column", rows, limit));
            }
            frames.push(frame);
        }
        for row in 0..batch.num_rows() {
            for (place, frame) in frames.iter().enumerate() {
                let numbers = frame.value(row);
                let numbers = numbers.as_primitive::<Float32Type>().values();
                if place == 0 {
                    self.norms_v.push(norm(numbers) as f32);
                }
                for number in numbers {
                    out.write_all(&number.to_le_bytes())
                        .map_err(LearnError::file("writing to", folder))?;
                }
            }
        }
        let split = column(SPLIT).and_then(|c| c.as_string_opt::<i32>());
        let part = |row| split.and_then(|names| Part::named(names.value(row)));
        self.parts.extend((0..batch.num_rows()).map(part));
        let ids = column(TRIAL_ID).and_then(|c| c.as_primitive_opt::<Int64Type>());
        let id = |row| ids.filter(|ids| ids.is_valid(row)).map(|ids| ids.value(row));
        self.trial_ids.extend((0..batch.num_rows()).map(id));
        let counts = column(FRAME_COUNT).and_then(|c| c.as_primitive_opt::<UInt32Type>());
        let count = |row| counts.filter(|c| c.is_valid(row)).map_or(0, |c| c.value(row));
        self.frame_counts.extend((0..batch.num_rows()).map(count));
        self.append_contacts(batch);
        Ok(())
    }

    fn append_contacts(&mut self, batch: &RecordBatch) {
        let lists = batch.column_by_name(CONTACTS).and_then(|c| c.as_list_opt::<i32>());
        for row in 0..batch.num_rows() {
            if let Some(lists) = lists.filter(|lists| lists.is_valid(row)) {
                let contacts = lists.value(row);
                let contacts = contacts.as_struct();
                let number = |name: &str, at: usize| {
                    let column = contacts.column_by_name(name).filter(|c| c.is_valid(at))?;
                    Some(match column.data_type() {
                        DataType::Float32 => {
                            f64::from(column.as_primitive::<Float32Type>().value(at))
                        }
                        _ => column.as_primitive::<Float64Type>().value(at),
                    })
                };
                self.contacts.extend((0..contacts.len()).map(|at| Contact {
                    x_mm: number("x_mm", at),
                    y_mm: number("y_mm", at),
                    force_n: number("force_n", at),
                    diameter_mm: number("diameter_mm", at),
                }));
            }
            self.ends.push(self.contacts.len());
        }
    }
}

/// Limit of frames that differ in length.
const DIFFERENT_LENGTHS: &str = "must have frames of one length";

fn frame_length(rows: &DatasetRows, column: &str) -> Result<usize, LearnError> {
    match rows.schema().field_with_name(column).map(|field| field.data_type().clone()) {
        Ok(DataType::FixedSizeList(_, length)) => Ok(length as usize),
        _ => Err(LearnError::value("dataset", "column", column, "must hold frames")),
    }
}

/// A file that is removed when it is closed, also if the process is killed.
fn unnamed_file(folder: &Path) -> std::io::Result<File> {
    new_file::make_folder(folder)?;
    let path = folder.join(format!("training-{}.partial", uuid::Uuid::now_v7()));
    let file = new_file::as_private_as(folder)?.read(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}
