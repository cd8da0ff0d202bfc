//! Twins of consecutive trials as a Parquet file: a row for each trial, and in the footer what they were made of.
//! Uses: `simulate::schema`, arrow, parquet. Never: a frame of another length, trials that are not in order.

use std::io::Write;
use std::sync::Arc;

use arrow_array::{Array, ArrayRef, FixedSizeListArray, Float32Array, Int64Array, RecordBatch};
use arrow_buffer::NullBuffer;
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::reader::ChunkReader;
use serde::{Deserialize, Serialize};

use crate::ids::{RunUid, TrialId};
use crate::simulate::schema::{self, Packing};

/// Largest number of trials of a file, which is a chunk.
pub const CHUNK_TRIALS_MAX: u64 = 10_000;
/// Key of the footer entry with a [`TwinsHead`], as JSON.
const TWINS_HEAD: &str = "palpate.twins";
/// Number of rows that are read at a time.
const READ_TWINS: usize = 1024;

/// What the twins of a file were made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinsHead {
    /// Run of the trials.
    pub run: RunUid,
    /// Simulation id of the model.
    pub model: String,
    /// sha256 of the contacts, as [`super::TwinInput::lines`] writes them.
    pub contacts_sha256: String,
}

/// The simulated frame of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinRow {
    /// Id of the trial.
    pub trial: TrialId,
    /// Voltages, V, injection-major; `None` if the model cannot simulate the trial.
    pub frame_v: Option<Vec<f32>>,
}

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinsFile {
    /// What the twins were made of.
    pub head: TwinsHead,
    /// The twins, in ascending order of their trials.
    pub rows: Vec<TwinRow>,
}

impl TwinsFile {
    /// Writes the file; returns `out`. Each frame has `channels` voltages.
    ///
    /// # Errors
    /// `ParquetError` if a frame has another length, or the file cannot be written.
    pub fn write<W: Write + Send>(&self, channels: usize, out: W) -> Result<W, ParquetError> {
        let head = serde_json::to_string(&self.head).map_err(external)?;
        let footer = vec![KeyValue::new(TWINS_HEAD.to_owned(), head)];
        let items = i32::try_from(channels).map_err(external)?;
        let trials = Int64Array::from_iter_values(self.rows.iter().map(|row| row.trial.0));
        let mut values = Vec::with_capacity(self.rows.len() * channels);
        let mut known = Vec::with_capacity(self.rows.len());
        for TwinRow { trial, frame_v } in &self.rows {
            known.push(frame_v.is_some());
            match frame_v {
                Some(frame_v) if frame_v.len() == channels => values.extend_from_slice(frame_v),
                Some(frame_v) => {
                    let found = frame_v.len();
                    let words = format!("trial {}: {found} voltages, not {channels}", trial.0);
                    return Err(ParquetError::General(words));
                }
                None => values.resize(values.len() + channels, 0.0),
            }
        }
        let values: ArrayRef = Arc::new(Float32Array::from(values));
        let element = Arc::new(schema::voltage_element());
        let frames =
            FixedSizeListArray::try_new(element, items, values, Some(NullBuffer::from(known)))?;
        let schema = Arc::new(Schema::new(vec![
            Field::new("trial_id", DataType::Int64, false),
            schema::voltages(schema::SIM_VOLTAGES_V, items).with_nullable(true),
        ]));
        let columns: Vec<ArrayRef> = vec![Arc::new(trials), Arc::new(frames)];
        let batch = RecordBatch::try_new(schema.clone(), columns)?;
        let properties = schema::parquet_properties(Packing::default(), footer);
        let mut writer = ArrowWriter::try_new(out, schema, Some(properties))?;
        writer.write(&batch)?;
        writer.into_inner()
    }

    /// Reads a file, of which nothing is taken for granted; its frames must have `channels` voltages.
    ///
    /// # Errors
    /// What is wrong with it, as text.
    pub fn read<R: ChunkReader + 'static>(input: R, channels: usize) -> Result<Self, String> {
        let words = |error: ParquetError| format!("cannot be read: {error}");
        let builder = ParquetRecordBatchReaderBuilder::try_new(input).map_err(words)?;
        let fields = builder.schema().fields();
        let is_frame = |field: &Field| match field.data_type() {
            DataType::FixedSizeList(item, items) => {
                *item.data_type() == DataType::Float32 && usize::try_from(*items) == Ok(channels)
            }
            _ => false,
        };
        let fits = fields.len() == 2 && *fields[0].data_type() == DataType::Int64;
        if !fits || !is_frame(&fields[1]) {
            return Err(format!("must have the id of a trial and {channels} voltages per row"));
        }
        let mut footer =
            builder.metadata().file_metadata().key_value_metadata().into_iter().flatten();
        let head = footer.find(|entry| entry.key == TWINS_HEAD);
        let head =
            head.and_then(|entry| entry.value.as_deref()).ok_or("has no entry palpate.twins")?;
        let head: TwinsHead = serde_json::from_str(head)
            .map_err(|error| format!("has an invalid entry palpate.twins: {error}"))?;
        let mut rows: Vec<TwinRow> = Vec::new();
        for batch in builder.with_batch_size(READ_TWINS).build().map_err(words)? {
            let batch = batch.map_err(|error| words(error.into()))?;
            let (trials, frames) = (batch.column(0).as_any(), batch.column(1).as_any());
            let trials = trials.downcast_ref::<Int64Array>();
            let frames = frames.downcast_ref::<FixedSizeListArray>();
            let (Some(trials), Some(frames)) = (trials, frames) else {
                return Err("has columns of other types".into());
            };
            for at in 0..batch.num_rows() {
                let trial = TrialId(trials.value(at));
                if rows.last().is_some_and(|before| before.trial >= trial) {
                    return Err(format!("has trial {} after a larger id, or twice", trial.0));
                }
                let frame_v = match frames.is_valid(at) {
                    true => {
                        Some(floats(&frames.value(at)).ok_or("has a voltage that is not finite")?)
                    }
                    false => None,
                };
                rows.push(TwinRow { trial, frame_v });
            }
            if rows.len() as u64 > CHUNK_TRIALS_MAX {
                return Err(format!("has more than {CHUNK_TRIALS_MAX} trials"));
            }
        }
        Ok(Self { head, rows })
    }
}

/// The numbers of an array, if all are finite: twins never change, and a comparison with another one has no result.
fn floats(values: &ArrayRef) -> Option<Vec<f32>> {
    let values = values.as_any().downcast_ref::<Float32Array>()?;
    let is_whole = values.null_count() == 0 && values.values().iter().all(|v| v.is_finite());
    is_whole.then(|| values.values().to_vec())
}

fn external(error: impl std::error::Error + Send + Sync + 'static) -> ParquetError {
    ParquetError::External(Box::new(error))
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};

    use super::*;

    fn row(trial: i64, frame_v: Option<Vec<f32>>) -> TwinRow {
        TwinRow { trial: TrialId(trial), frame_v }
    }

    #[test]
    fn a_file_is_read_as_it_was_written_and_refused_in_another_form() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("twins.parquet");
        let head = TwinsHead {
            run: RunUid::new(),
            model: "sim-1".into(),
            contacts_sha256: "0".repeat(64),
        };
        let frame_v = vec![0.1, f32::MIN_POSITIVE, -3.5, 0.0];
        let rows = vec![row(3, Some(frame_v.clone())), row(4, None), row(9, Some(vec![1.0; 4]))];
        let file = TwinsFile { head, rows };
        let written = |file: &TwinsFile| {
            file.write(4, File::create(&path).unwrap()).unwrap().sync_all().unwrap();
            File::open(&path).unwrap()
        };
        assert_eq!(TwinsFile::read(written(&file), 4), Ok(file.clone()));
        let bytes = fs::read(&path).unwrap();
        let other = TwinsFile::read(written(&file), 9).unwrap_err();
        assert!(other.contains("9 voltages per row"), "{other}");
        assert_eq!(fs::read(&path).unwrap(), bytes, "the same content has the same bytes");

        let twice = TwinsFile { rows: vec![row(3, None), row(3, None)], ..file.clone() };
        let refused = TwinsFile::read(written(&twice), 4).unwrap_err();
        assert!(refused.starts_with("has trial 3 after"), "{refused}");
        let lost = vec![row(3, Some(vec![1.0, f32::NAN, 0.0, 0.0]))];
        let refused = TwinsFile::read(written(&TwinsFile { rows: lost, ..file.clone() }), 4);
        assert_eq!(refused.unwrap_err(), "has a voltage that is not finite");
        let short = TwinsFile { rows: vec![row(3, Some(vec![1.0]))], ..file };
        assert!(short.write(4, Vec::new()).is_err());
        fs::write(&path, "no Parquet").unwrap();
        let refused = TwinsFile::read(File::open(&path).unwrap(), 4).unwrap_err();
        assert!(refused.starts_with("cannot be read"), "{refused}");
    }
}
