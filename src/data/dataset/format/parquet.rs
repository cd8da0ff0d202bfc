//! Parquet: one row group per batch, its columns encoded on two threads.
//! Uses: `dataset::format`, parquet. Never: files, the meaning of columns.
//!
//! The schema determines the settings (`docs/decisions/0007-parquet-encoding.md`): byte stream
//! split for floating-point numbers, whose upper bytes repeat; deltas for whole numbers; statistics
//! for scalars, so that readers can skip row groups, and none for lists.

use std::collections::HashMap;
use std::io::Write;
use std::sync::Arc;
use std::{panic, thread};

use arrow_array::RecordBatch;
use arrow_schema::{Schema, SchemaRef};
use parking_lot::Mutex;
use parquet::arrow::arrow_writer::{
    ArrowColumnChunk, ArrowColumnWriter, ArrowLeafColumn, ArrowRowGroupWriterFactory,
    ArrowWriterOptions, compute_leaves,
};
use parquet::arrow::{ArrowSchemaConverter, ArrowWriter, add_encoded_arrow_schema_to_metadata};
use parquet::basic::{Compression, Encoding, Type, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;

use super::FormatError;

/// A Parquet file being written. The metadata of the schema is written at the end.
pub(in crate::dataset) struct Writer<W: Write + Send> {
    schema: SchemaRef,
    file: SerializedFileWriter<W>,
    columns: ArrowRowGroupWriterFactory,
    groups: usize,
}

impl<W: Write + Send> Writer<W> {
    pub(in crate::dataset) fn new(schema: &SchemaRef, out: W) -> Result<Self, FormatError> {
        let options = ArrowWriterOptions::new()
            .with_properties(properties(schema)?)
            .with_skip_arrow_metadata(true);
        let writer = ArrowWriter::try_new_with_options(out, schema.clone(), options)?;
        let (file, columns) = writer.into_serialized_writer()?;
        Ok(Self { schema: schema.clone(), file, columns, groups: 0 })
    }

    /// Replaces the metadata of the schema.
    pub(in crate::dataset) fn describe(&mut self, metadata: HashMap<String, String>) {
        self.schema = Arc::new(self.schema.as_ref().clone().with_metadata(metadata));
    }

    /// Appends a row group, unless the batch is empty.
    pub(in crate::dataset) fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        if batch.num_rows() == 0 {
            return Ok(());
        }
        let mut leaves = Vec::new();
        for (field, column) in self.schema.fields().iter().zip(batch.columns()) {
            leaves.extend(compute_leaves(field, column)?);
        }
        let writers = self.columns.create_column_writers(self.groups)?;
        let mut group = self.file.next_row_group()?;
        for chunk in encode(leaves.into_iter().zip(writers).collect())? {
            chunk.append_to_row_group(&mut group)?;
        }
        group.close()?;
        self.groups += 1;
        Ok(())
    }

    pub(in crate::dataset) fn finish(mut self) -> Result<W, FormatError> {
        for pair in footer(&self.schema) {
            self.file.append_key_value_metadata(pair);
        }
        Ok(self.file.into_inner()?)
    }
}

/// The metadata of the schema by key, then the schema itself as Arrow encodes it.
fn footer(schema: &Schema) -> Vec<KeyValue> {
    let mut pairs: Vec<_> = schema.metadata().iter().collect();
    pairs.sort();
    let pairs = pairs.into_iter().map(|(key, text)| KeyValue::new(key.clone(), text.clone()));
    let builder = WriterProperties::builder().set_key_value_metadata(Some(pairs.collect()));
    let mut properties = builder.build();
    add_encoded_arrow_schema_to_metadata(schema, &mut properties);
    properties.key_value_metadata().cloned().unwrap_or_default()
}

/// Encodes and compresses the columns of a row group on two threads; returns them in their order.
fn encode(
    columns: Vec<(ArrowLeafColumn, ArrowColumnWriter)>,
) -> Result<Vec<ArrowColumnChunk>, ParquetError> {
    let waiting = Mutex::new(columns.into_iter().enumerate());
    let next = || waiting.lock().next();
    let work = || {
        let mut done = Vec::new();
        while let Some((number, (leaf, mut writer))) = next() {
            done.push((number, writer.write(&leaf).and_then(|()| writer.close())));
        }
        done
    };
    let mut chunks = thread::scope(|scope| {
        let other = scope.spawn(work);
        let mut done = work();
        done.extend(other.join().unwrap_or_else(|cause| panic::resume_unwind(cause)));
        done
    });
    chunks.sort_by_key(|(number, _)| *number);
    chunks.into_iter().map(|(_, chunk)| chunk).collect()
}

fn properties(schema: &Schema) -> Result<WriterProperties, ParquetError> {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_statistics_enabled(EnabledStatistics::Chunk);
    for leaf in ArrowSchemaConverter::new().convert(schema)?.columns() {
        let encoding = match leaf.physical_type() {
            Type::FLOAT | Type::DOUBLE => Some(Encoding::BYTE_STREAM_SPLIT),
            Type::INT32 | Type::INT64 => Some(Encoding::DELTA_BINARY_PACKED),
            _ => None,
        };
        if let Some(encoding) = encoding {
            properties = properties
                .set_column_dictionary_enabled(leaf.path().clone(), false)
                .set_column_encoding(leaf.path().clone(), encoding);
        }
        if leaf.max_rep_level() > 0 {
            let none = EnabledStatistics::None;
            properties = properties.set_column_statistics_enabled(leaf.path().clone(), none);
        }
    }
    Ok(properties.build())
}
