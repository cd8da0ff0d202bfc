//! The file of a dataset while it is written: its row groups, the hash of its rows, and their counts.
//! Uses: `dataset::{batch, format}`, `new_file`. Never: the store; a name before the last row.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray;
use arrow_array::types::UInt8Type;
use arrow_ipc::writer::StreamWriter;
use arrow_schema::SchemaRef;

use super::batch::{self, Row};
use super::definition::Definition;
use super::error::{DatasetError, DatasetResult};
use super::format::ParquetWriter;
use super::split::Part;
use crate::digest::{Hashing, ID_DIGITS};
use crate::ids::DatasetId;
use crate::new_file::{Finished, NewFile};

/// Counts of the written rows.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub rows: u64,
    pub parts: BTreeMap<&'static str, u64>,
    pub contact_counts: BTreeMap<u8, u64>,
}

impl Tally {
    fn count(&mut self, part: Option<Part>, contacts: u8) {
        self.rows += 1;
        *self.contact_counts.entry(contacts).or_default() += 1;
        if let Some(part) = part {
            *self.parts.entry(part.name()).or_default() += 1;
        }
    }
}

/// The unfinished file of a dataset; removed if it is dropped unfinished.
pub(super) struct Encoder {
    columns: SchemaRef,
    parquet: ParquetWriter<NewFile>,
    rows: StreamWriter<Hashing>,
    tally: Tally,
}

impl Encoder {
    /// Starts a file with these columns in `folder`.
    pub(super) fn new(
        folder: &Path,
        definition: &Definition,
        columns: &SchemaRef,
    ) -> DatasetResult<Self> {
        let file =
            NewFile::create(folder).map_err(DatasetError::file("creating a file in", folder))?;
        let mut hash = Hashing::default();
        hash.update(serde_json::to_string(definition).map_err(DatasetError::Json)?);
        Ok(Self {
            columns: columns.clone(),
            parquet: ParquetWriter::new(columns, file)?,
            // Without the metadata: the same rows have the same id on every machine.
            rows: StreamWriter::try_new(hash, columns)?,
            tally: Tally::default(),
        })
    }

    /// The columns of the file.
    pub(super) fn columns(&self) -> &SchemaRef {
        &self.columns
    }

    /// Counts of the written rows.
    pub(super) fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Appends trials as a row group.
    pub(super) fn push_trials(&mut self, rows: &[Row]) -> DatasetResult<()> {
        self.push(&batch::of_trials(&self.columns, rows)?)?;
        rows.iter().for_each(|row| self.tally.count(row.part, row.trial.contact_count));
        Ok(())
    }

    /// Appends rows of a Sim-Random shard as a row group; `parts` holds the part of each.
    pub(super) fn push_shard(
        &mut self,
        rows: &RecordBatch,
        parts: &[Option<Part>],
    ) -> DatasetResult<()> {
        let batch = batch::of_shard(&self.columns, rows, parts)?;
        self.push(&batch)?;
        let counts = batch.column_by_name("contact_count");
        let counts = counts.and_then(|counts| counts.as_primitive_opt::<UInt8Type>());
        for (row, part) in parts.iter().enumerate() {
            self.tally.count(*part, counts.map_or(0, |counts| counts.value(row)));
        }
        Ok(())
    }

    fn push(&mut self, batch: &RecordBatch) -> DatasetResult<()> {
        self.rows.write(batch)?;
        Ok(self.parquet.push(batch)?)
    }

    /// Ends the rows. Returns `ds-` and the start of a sha256 over definition, columns and rows.
    pub(super) fn id(&mut self) -> DatasetResult<DatasetId> {
        self.rows.finish()?;
        let digits = self.rows.get_ref().clone().finish();
        Ok(DatasetId::unchecked(format!("ds-{}", &digits[..ID_DIGITS])))
    }

    /// Writes the metadata and makes the file durable under the name of its id.
    pub(super) fn finish(
        mut self,
        id: &DatasetId,
        metadata: HashMap<String, String>,
    ) -> DatasetResult<Finished> {
        self.parquet.describe(metadata);
        let file = self.parquet.finish()?;
        let name = format!("{id}.parquet");
        file.finish(&name).map_err(DatasetError::file("writing", Path::new(&name)))
    }
}
