//! Trials as Parquet: a row group is encoded separately, on any thread, then appended to its file.
//! Uses: `simulate::schema`, arrow, parquet. Never: files, the order of trials.

use std::io::Write;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Float64Array, ListArray, RecordBatch, StringArray,
    StructArray, UInt8Array, UInt64Array,
};
use arrow_buffer::OffsetBuffer;
use arrow_schema::SchemaRef;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::{ArrowColumnChunk, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use sim_core::forward::Contact;

use super::manifest::{Definition, SIM_RANDOM};
use crate::simulate::schema::{self, Packing};

/// Key of the footer entry with the definition of a shard, as JSON.
pub const DEFINITION: &str = "palpate.definition";

/// Consecutive trials with their frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Trials {
    /// Number of the first trial.
    pub first: u64,
    /// Contacts of all trials, one after the other.
    pub contacts: Vec<Contact>,
    /// End of each trial's contacts in `contacts`.
    pub ends: Vec<usize>,
    /// Frames of all trials, V, one after the other.
    pub voltages_v: Vec<f32>,
}

impl Trials {
    /// The contacts of each trial.
    pub fn each(&self) -> Vec<&[Contact]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.contacts[start..end]).collect()
    }
}

/// An encoded row group.
pub type RowGroup = Vec<ArrowColumnChunk>;

/// Common properties of the shards of a definition: columns, settings, footer.
#[derive(Debug, Clone)]
pub struct Layout {
    schema: SchemaRef,
    properties: WriterProperties,
    channels: i32,
    seed: u64,
    diameter_mm: f32,
}

impl Layout {
    /// Builds the layout of a definition's shards, for frames of `channels` voltages.
    ///
    /// # Errors
    /// `ParquetError` if the definition cannot be written as JSON, or `channels` exceeds i32.
    pub fn new(
        definition: &Definition,
        channels: usize,
        tip_diameter_mm: f64,
    ) -> Result<Self, ParquetError> {
        let text = serde_json::to_string(definition)
            .map_err(|error| ParquetError::External(Box::new(error)))?;
        let channels =
            i32::try_from(channels).map_err(|error| ParquetError::External(Box::new(error)))?;
        let footer = vec![KeyValue::new(DEFINITION.to_owned(), text)];
        Ok(Self {
            schema: Arc::new(schema::sim_random(channels)),
            properties: schema::parquet_properties(Packing::default(), footer),
            channels,
            seed: definition.draws.seed,
            diameter_mm: tip_diameter_mm as f32,
        })
    }

    /// Starts a file of this layout.
    ///
    /// # Errors
    /// `ParquetError` if the writer cannot be created.
    pub fn file<W: Write + Send>(&self, out: W) -> Result<SerializedFileWriter<W>, ParquetError> {
        Ok(self.writer(out)?.0)
    }

    /// Returns the encoder of row groups of this layout.
    ///
    /// # Errors
    /// `ParquetError` if the writer cannot be created.
    pub fn encoder(&self) -> Result<Encoder, ParquetError> {
        Ok(Encoder { layout: self.clone(), columns: self.writer(std::io::sink())?.1 })
    }

    fn writer<W: Write + Send>(
        &self,
        out: W,
    ) -> Result<(SerializedFileWriter<W>, ArrowRowGroupWriterFactory), ParquetError> {
        let properties = Some(self.properties.clone());
        ArrowWriter::try_new(out, self.schema.clone(), properties)?.into_serialized_writer()
    }

    /// Converts trials to columns.
    ///
    /// # Errors
    /// `ParquetError` if the lengths of contacts or frames do not match.
    pub fn batch(&self, trials: Trials) -> Result<RecordBatch, ParquetError> {
        let count = trials.ends.len();
        let each = trials.each();
        let numbers = trials.first..trials.first + count as u64;
        let forces =
            each.iter().map(|contacts| contacts.iter().map(|c| c.force_n as f32).reduce(f32::max));
        let columns: Vec<ArrayRef> = vec![
            Arc::new(UInt64Array::from_value(self.seed, count)),
            Arc::new(UInt64Array::from_iter_values(numbers)),
            Arc::new(StringArray::from_iter_values(std::iter::repeat_n(SIM_RANDOM, count))),
            Arc::new(UInt8Array::from_iter_values(each.iter().map(|c| c.len() as u8))),
            Arc::new(Float32Array::from_iter(forces)),
            self.contacts(&each)?,
            self.frames(trials.voltages_v)?,
        ];
        Ok(RecordBatch::try_new(self.schema.clone(), columns)?)
    }

    fn contacts(&self, trials: &[&[Contact]]) -> Result<ArrayRef, ParquetError> {
        let all = || trials.iter().copied().flatten();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(Float64Array::from_iter_values(all().map(|c| c.x_mm))),
            Arc::new(Float64Array::from_iter_values(all().map(|c| c.y_mm))),
            Arc::new(Float32Array::from_iter_values(all().map(|c| c.force_n as f32))),
            Arc::new(Float32Array::from_value(self.diameter_mm, all().count())),
        ];
        let contacts = StructArray::try_new(schema::contact_fields(), columns, None)?;
        let ends = OffsetBuffer::from_lengths(trials.iter().map(|contacts| contacts.len()));
        let element = Arc::new(schema::contact_element());
        Ok(Arc::new(ListArray::try_new(element, ends, Arc::new(contacts), None)?))
    }

    fn frames(&self, voltages_v: Vec<f32>) -> Result<ArrayRef, ParquetError> {
        let values = Arc::new(Float32Array::from(voltages_v));
        let element = Arc::new(schema::voltage_element());
        Ok(Arc::new(FixedSizeListArray::try_new(element, self.channels, values, None)?))
    }
}

/// Encodes row groups, on any number of threads.
#[derive(Debug)]
pub struct Encoder {
    layout: Layout,
    columns: ArrowRowGroupWriterFactory,
}

impl Encoder {
    /// Encodes and compresses trials as one row group.
    ///
    /// # Errors
    /// `ParquetError` if the trials do not match the layout, or a column cannot be encoded.
    pub fn encode(&self, trials: Trials) -> Result<RowGroup, ParquetError> {
        let batch = self.layout.batch(trials)?;
        // The number of the row group matters to encrypted files alone.
        let mut writers = self.columns.create_column_writers(0)?.into_iter();
        let mut group = RowGroup::new();
        for (field, column) in self.layout.schema.fields().iter().zip(batch.columns()) {
            for (leaf, mut writer) in compute_leaves(field, column)?.into_iter().zip(&mut writers) {
                writer.write(&leaf)?;
                group.push(writer.close()?);
            }
        }
        Ok(group)
    }
}

/// Appends a row group to a file of the same layout.
///
/// # Errors
/// `ParquetError` if the file cannot be written.
pub fn append<W: Write + Send>(
    file: &mut SerializedFileWriter<W>,
    group: RowGroup,
) -> Result<(), ParquetError> {
    let mut writer = file.next_row_group()?;
    for column in group {
        column.append_to_row_group(&mut writer)?;
    }
    writer.close()?;
    Ok(())
}
