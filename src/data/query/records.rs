//! What the store holds in addition to trials, as tables: runs, events, reference presses.
//! Uses: `store`, arrow-json, `dataset::format`. Never: the texts of files that a run was made of, all events in memory.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_json::ReaderBuilder;
use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};
use serde_json::{Value, json};

use crate::dataset::error::{DatasetError, DatasetResult};
use crate::dataset::format::{Format, Stream, zone};
use crate::new_file::NewFile;
use crate::store::{RunRow, Store};

/// Events of a page.
const PAGE_EVENTS: u32 = 10_000;
/// Rows that the decoder holds: its default.
const DECODER_ROWS: usize = 1024;

/// A file that is removed with this value.
#[derive(Debug)]
pub struct Scratch(pub PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        // A file that stays is removed with the unused pieces.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A table that is being written.
struct Records {
    folder: PathBuf,
    name: String,
    schema: SchemaRef,
    stream: Stream<NewFile>,
}

impl Records {
    /// Begins a file in `folder` with these columns.
    fn new(folder: &Path, fields: &[(&str, DataType)]) -> DatasetResult<Self> {
        let fields = fields.iter().map(|(name, kind)| Field::new(*name, kind.clone(), true));
        let schema: SchemaRef = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        let failed = DatasetError::file("writing a table in", folder);
        let file = NewFile::create(folder).map_err(failed)?;
        let name = format!("records-{}.parquet", uuid::Uuid::now_v7());
        let empty = RecordBatch::new_empty(schema.clone());
        let named = zone::renamed(&empty, zone::OFFSET, zone::NAME)?.schema();
        let stream = Stream::new(Format::Parquet, &named, file)?;
        Ok(Self { folder: folder.to_owned(), name, schema, stream })
    }

    /// Writes further rows.
    fn push(&mut self, rows: &[Value]) -> DatasetResult<()> {
        let mut decoder = ReaderBuilder::new(self.schema.clone()).build_decoder()?;
        for rows in rows.chunks(DECODER_ROWS) {
            decoder.serialize(rows)?;
            if let Some(batch) = decoder.flush()? {
                self.stream.push(&zone::renamed(&batch, zone::OFFSET, zone::NAME)?)?;
            }
        }
        Ok(())
    }

    fn finish(self) -> DatasetResult<Scratch> {
        let failed = DatasetError::file("writing a table in", &self.folder);
        self.stream.finish()?.finish_unsynced(&self.name).map_err(failed)?;
        Ok(Scratch(self.folder.join(self.name)))
    }
}

fn time() -> DataType {
    DataType::Timestamp(TimeUnit::Millisecond, Some(zone::OFFSET.into()))
}

/// Writes a file with one row for each run.
///
/// # Errors
/// `DatasetError` if it cannot be written.
pub fn runs(folder: &Path, runs: &[RunRow]) -> DatasetResult<Scratch> {
    type Cell = fn(&RunRow) -> Value;
    let columns: [(&str, DataType, Cell); 18] = [
        ("scan_id", DataType::Int64, |run| json!(run.scan_id)),
        ("run", DataType::Utf8, |run| json!(run.uid)),
        ("experiment", DataType::Utf8, |run| json!(run.experiment)),
        ("kind", DataType::Utf8, |run| json!(run.kind)),
        ("label", DataType::Utf8, |run| json!(run.label)),
        ("state", DataType::Utf8, |run| json!(run.state)),
        ("exit_status", DataType::Utf8, |run| json!(run.exit_status)),
        ("reason", DataType::Utf8, |run| json!(run.reason)),
        ("trials_planned", DataType::Int64, |run| json!(run.trials_planned)),
        ("deadband_n", DataType::Float64, |run| json!(run.deadband_n)),
        ("tip_diameter_mm", DataType::Float64, |run| json!(run.tip_diameter_mm)),
        ("calibration_id", DataType::Utf8, |run| json!(run.calibration_id)),
        ("seed", DataType::UInt64, |run| json!(run.seed)),
        ("version", DataType::Utf8, |run| json!(run.version)),
        ("submitted_by", DataType::Utf8, |run| json!(run.submitted_by)),
        ("created_at", time(), |run| json!(run.created_at)),
        ("started_at", time(), |run| json!(run.started_at)),
        ("ended_at", time(), |run| json!(run.ended_at)),
    ];
    let row = |run: &RunRow| -> Value {
        columns.iter().map(|(name, _, cell)| (*name, cell(run))).collect()
    };
    let rows: Vec<Value> = runs.iter().map(row).collect();
    let mut records = Records::new(folder, &columns.map(|(name, kind, _)| (name, kind)))?;
    records.push(&rows)?;
    records.finish()
}

/// Writes a file with one row for each event, page by page.
///
/// # Errors
/// `DatasetError` if the events cannot be read, or the file not be written.
pub async fn events(store: &Store, folder: &Path, runs: &[RunRow]) -> DatasetResult<Scratch> {
    let columns = [
        ("seq", DataType::Int64),
        ("scan_id", DataType::Int64),
        ("at", time()),
        ("kind", DataType::Utf8),
        ("data", DataType::Utf8),
    ];
    let mut records = Records::new(folder, &columns)?;
    let mut after = 0;
    loop {
        let page = store.events_since(after, PAGE_EVENTS, None, &[]).await?;
        let Some(last) = page.last() else { return records.finish() };
        after = last.seq;
        let rows = page.iter().map(|event| {
            let run = runs.iter().find(|run| Some(run.uid) == event.run);
            json!({
                "seq": event.seq, "scan_id": run.map(|run| run.scan_id), "at": event.at,
                "kind": event.kind, "data": event.data.to_string(),
            })
        });
        records.push(&rows.collect::<Vec<_>>())?;
    }
}

/// Writes a file with one row for each load cell of each reference press.
///
/// # Errors
/// `DatasetError` if they cannot be read, or the file not be written.
pub async fn references(store: &Store, folder: &Path, runs: &[RunRow]) -> DatasetResult<Scratch> {
    let columns = [
        ("scan_id", DataType::Int64),
        ("before_configuration", DataType::Int64),
        ("depth_mm", DataType::Float64),
        ("reached_z_mm", DataType::Float64),
        ("arm", DataType::Int64),
        ("x_mm", DataType::Float64),
        ("y_mm", DataType::Float64),
        ("force_n", DataType::Float64),
        ("at", time()),
    ];
    let mut records = Records::new(folder, &columns)?;
    for run in runs {
        let mut rows = Vec::new();
        for press in store.references(run.uid).await? {
            rows.extend(press.arms.iter().map(|arm| {
                json!({
                    "scan_id": run.scan_id, "before_configuration": press.before_configuration,
                    "depth_mm": press.depth_mm, "reached_z_mm": press.reached.z_mm,
                    "arm": arm.arm, "x_mm": arm.x_mm, "y_mm": arm.y_mm, "force_n": arm.force_n,
                    "at": press.at,
                })
            }));
        }
        records.push(&rows)?;
    }
    records.finish()
}
