//! The rows of a rig as tables, one for each label, with ids that no row of another rig has.
//! Uses: `dataset::{read, format}`, `new_file`. Never: a value other than the rig's, except `configuration`.
//!
//! A dataset may have several runs, each with its configurations from 0. An import is one run, whose trials have
//! the key (configuration, depth_index): so the configurations of a run follow those of the runs before it. The
//! column `trial` keeps the ones of the run: `RIG/RUN/CONFIGURATION/DEPTH`, or `RIG/sim-random/SEED/INDEX`.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use arrow_array::cast::AsArray;
use arrow_array::types::{UInt32Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, ArrowPrimitiveType, BooleanArray, PrimitiveArray, RecordBatch, StringArray,
    UInt32Array,
};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use arrow_select::filter::filter_record_batch;
use serde::Serialize;

use super::TRIALS;
use crate::dataset::build::Progress;
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::format::{FormatError, ParquetWriter, Rows};
use crate::dataset::read::DatasetRows;
use crate::new_file::NewFile;
use crate::simulate::schema as base;
use crate::store::Label;

/// Column of the name of the rig.
const RIG: &str = "rig";
/// Column of the id of a trial among all rigs.
const TRIAL: &str = "trial";
const RUN: &str = "run";
const LABEL: &str = "label";
const CONFIGURATION: &str = "configuration";
const DEPTH_INDEX: &str = "depth_index";

/// A table with the rows of one rig and one label.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelFile {
    /// Path in the folder of the federation.
    pub file: String,
    /// Origin of the data: `measured`, `virtual` or `simulated`.
    pub label: &'static str,
    /// Number of rows.
    pub rows: u64,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// sha256 of the file, in hexadecimal digits.
    pub sha256: String,
}

/// A table that is being written, with its number of rows.
type Unfinished = (ParquetWriter<NewFile>, u64);

/// First configuration of each run in the tables, by uid of the run: in the order of their begin.
///
/// # Errors
/// `DatasetError::Format` or `Arrow` if the rows cannot be read or lack a column, `Problems` if there are too many
/// configurations.
pub(super) fn offsets(rows: &DatasetRows) -> DatasetResult<BTreeMap<String, u32>> {
    let schema = rows.schema();
    let columns = [schema.index_of(RUN)?, schema.index_of(CONFIGURATION)?];
    let mut largest: BTreeMap<String, u32> = BTreeMap::new();
    for batch in rows.batches(Some(&columns)).map_err(FormatError::from)? {
        let batch = batch.map_err(FormatError::from)?;
        let pairs = texts(&batch, RUN)?.iter().zip(numbers::<UInt32Type>(&batch, CONFIGURATION)?);
        for (run, configuration) in pairs {
            let Some((run, configuration)) = run.zip(configuration) else { continue };
            let most = largest.entry(run.to_owned()).or_default();
            *most = configuration.max(*most);
        }
    }
    let (mut first, mut offsets) = (0_u32, BTreeMap::new());
    for (run, most) in largest {
        offsets.insert(run, first);
        let next = first.checked_add(most).and_then(|end| end.checked_add(1));
        first = next.ok_or_else(|| {
            let limit = "must have at most 4294967295 configurations";
            DatasetError::value(CONFIGURATION, "the runs of a dataset", limit)
        })?;
    }
    Ok(offsets)
}

/// Writes the tables of a rig's rows, one for each label, into the folder of the federation, and counts the rows.
///
/// # Errors
/// `DatasetError::Format` or `Arrow` if the rows cannot be read or lack a column, `Problems` if a label is
/// unknown, `File` if a file cannot be written.
pub(super) fn write(
    rig: &str,
    rows: &DatasetRows,
    offsets: &BTreeMap<String, u32>,
    metadata: &HashMap<String, String>,
    folder: &Path,
    progress: &Progress,
) -> DatasetResult<Vec<LabelFile>> {
    let own = [RIG, TRIAL].map(|name| Field::new(name, DataType::Utf8, false));
    let schema = rows.schema();
    let others = schema.fields().iter().map(|field| field.as_ref().clone());
    let schema: SchemaRef =
        Arc::new(Schema::new(own.into_iter().chain(others).collect::<Vec<_>>()));
    let folder = folder.join(TRIALS);
    let mut tables: BTreeMap<&'static str, Unfinished> = BTreeMap::new();
    for batch in rows.batches(None).map_err(FormatError::from)? {
        let batch = batch.map_err(FormatError::from)?;
        let table = with_ids(rig, &batch, &schema, offsets)?;
        let labels = texts(&batch, LABEL)?;
        let found: BTreeSet<Option<&str>> = labels.iter().collect();
        for label in found {
            let mask: BooleanArray = labels.iter().map(|other| Some(other == label)).collect();
            let part = filter_record_batch(&table, &mask)?;
            let (writer, count) = match tables.entry(known(label)?) {
                Entry::Occupied(begun) => begun.into_mut(),
                Entry::Vacant(none) => none.insert(begin(&folder, &schema)?),
            };
            writer.push(&part)?;
            *count += part.num_rows() as u64;
        }
        progress.done.fetch_add(batch.num_rows() as u64, Relaxed);
    }
    let mut files = Vec::new();
    for (label, (mut writer, rows)) in tables {
        writer.describe(metadata.clone());
        let name = format!("{rig}.{label}.parquet");
        let failed = DatasetError::file("writing", &folder.join(&name));
        let finished = writer.finish()?.finish(&name).map_err(failed)?;
        let (bytes, sha256) = (finished.bytes, finished.sha256);
        files.push(LabelFile { file: format!("{TRIALS}/{name}"), label, rows, bytes, sha256 });
    }
    Ok(files)
}

fn begin(folder: &Path, schema: &SchemaRef) -> DatasetResult<Unfinished> {
    let file = NewFile::create(folder).map_err(DatasetError::file("creating a file in", folder))?;
    Ok((ParquetWriter::new(schema, file)?, 0))
}

/// The label of a row, which becomes part of a file name.
fn known(label: Option<&str>) -> DatasetResult<&'static str> {
    let found = label.and_then(|text| serde_json::from_value::<Label>(text.into()).ok());
    found.map(Label::as_str).ok_or_else(|| {
        let limit = "must be measured, virtual or simulated";
        DatasetError::value(LABEL, label.unwrap_or("absent"), limit)
    })
}

/// A batch with the columns of a table.
fn with_ids(
    rig: &str,
    batch: &RecordBatch,
    schema: &SchemaRef,
    offsets: &BTreeMap<String, u32>,
) -> Result<RecordBatch, ArrowError> {
    let rigs = std::iter::repeat_n(rig, batch.num_rows());
    let ids: [ArrayRef; 2] =
        [Arc::new(StringArray::from_iter_values(rigs)), Arc::new(trial_ids(rig, batch)?)];
    let configurations: ArrayRef = Arc::new(configurations(batch, offsets)?);
    let own = batch.schema();
    let columns = own.fields().iter().zip(batch.columns());
    let columns = columns.map(|(field, column)| match field.name().as_str() {
        CONFIGURATION => configurations.clone(),
        _ => column.clone(),
    });
    RecordBatch::try_new(schema.clone(), ids.into_iter().chain(columns).collect())
}

/// The configurations of a batch, those of each run after those of the runs before it.
fn configurations(
    batch: &RecordBatch,
    offsets: &BTreeMap<String, u32>,
) -> Result<UInt32Array, ArrowError> {
    let pairs = texts(batch, RUN)?.iter().zip(numbers::<UInt32Type>(batch, CONFIGURATION)?);
    let shifted =
        pairs.map(|(run, own)| Some(own? + offsets.get(run?).copied().unwrap_or_default()));
    Ok(shifted.collect())
}

fn trial_ids(rig: &str, batch: &RecordBatch) -> Result<StringArray, ArrowError> {
    let runs = texts(batch, RUN)?;
    let configurations = numbers::<UInt32Type>(batch, CONFIGURATION)?;
    let depths = numbers::<UInt32Type>(batch, DEPTH_INDEX)?;
    // Only datasets with rows of Sim-Random have these columns.
    let seeds = numbers::<UInt64Type>(batch, base::SEED).ok();
    let indices = numbers::<UInt64Type>(batch, base::INDEX).ok();
    let drawn = |numbers: Option<&PrimitiveArray<UInt64Type>>, row: usize| {
        numbers.filter(|numbers| numbers.is_valid(row)).map(|numbers| numbers.value(row))
    };
    let id = |row: usize| match runs.is_valid(row) {
        true => {
            let (configuration, depth) = (configurations.value(row), depths.value(row));
            Some(format!("{rig}/{}/{configuration}/{depth}", runs.value(row)))
        }
        false => Some(format!("{rig}/sim-random/{}/{}", drawn(seeds, row)?, drawn(indices, row)?)),
    };
    let ids: Option<Vec<String>> = (0..batch.num_rows()).map(id).collect();
    let missing = || ArrowError::InvalidArgumentError("a row has neither run nor seed".into());
    Ok(StringArray::from_iter_values(ids.ok_or_else(missing)?))
}

fn texts<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a StringArray, ArrowError> {
    let column = batch.column_by_name(name).and_then(|column| column.as_string_opt::<i32>());
    column.ok_or_else(|| ArrowError::SchemaError(format!("{name} must be a column of texts")))
}

fn numbers<'a, T: ArrowPrimitiveType>(
    batch: &'a RecordBatch,
    name: &str,
) -> Result<&'a PrimitiveArray<T>, ArrowError> {
    let column = batch.column_by_name(name).and_then(|column| column.as_primitive_opt::<T>());
    column.ok_or_else(|| {
        ArrowError::SchemaError(format!("{name} must be a column of {}", T::DATA_TYPE))
    })
}
