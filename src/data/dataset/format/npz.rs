//! NPZ: an uncompressed zip file with a NumPy array for each column, readable by `numpy.load`
//! without pickle.
//! Uses: `dataset::format`, zip. Never: all rows at once.
//!
//! | column | array of N rows |
//! |---|---|
//! | f32, f64 | the same type, NaN if missing |
//! | whole numbers | the same type; f64 with NaN if any value is missing |
//! | boolean | bool; f64 with NaN if any value is missing |
//! | text | `<U`, as wide as the longest; empty if missing |
//! | time | `datetime64[ms]` in UTC, NaT if missing |
//! | list of fixed length of f32 (frames, forces, maps) | `(N, length)` f32, NaN if missing |
//! | list of records (contacts) | `(N, most, fields)` f64, NaN beyond a list's end and if missing |
//! | list of texts (flags) | `<U` of JSON; empty if missing |
//!
//! The fields of a record are in the order of the schema: `x_mm, y_mm, force_n, diameter_mm` in
//! `contacts`. `most` is the length of the longest list.
//!
//! The rows are read once to determine the widths, and once for each column, so that at most one
//! batch is in memory. Sizes are zip64, times fixed, values aligned to 64 bytes.

use std::io::Write;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::npy::{Layout, Survey};
use super::{Format, FormatError, Rows, check_count};

/// Writes all rows; `progress` is called with the written share of the bytes, in rows.
pub(super) fn write(
    rows: &dyn Rows,
    out: &mut (impl Write + Send),
    progress: &mut dyn FnMut(u64),
) -> Result<(), FormatError> {
    let layouts = layouts(rows)?;
    let row_bytes: usize = layouts.iter().map(|layout| layout.row_bytes()).sum();
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644)
        .large_file(true)
        .with_alignment(64);
    let mut file = ZipWriter::new_stream(out);
    let mut bytes = Vec::new();
    let mut written = 0;
    for (column, (field, layout)) in rows.schema().fields().iter().zip(&layouts).enumerate() {
        file.start_file(format!("{}.npy", field.name()), options)?;
        file.write_all(&layout.header(rows.count()))?;
        let mut found = 0;
        for batch in rows.batches(Some(&[column]))? {
            let batch = batch?;
            bytes.clear();
            layout.append(field, batch.column(0), &mut bytes)?;
            file.write_all(&bytes)?;
            found += batch.num_rows() as u64;
            written += bytes.len() as u64;
            progress(written / row_bytes.max(1) as u64);
        }
        check_count(rows, found)?;
    }
    file.finish()?;
    Ok(())
}

/// Array layout of each column, after a survey of the columns whose values determine it.
fn layouts(rows: &dyn Rows) -> Result<Vec<Layout>, FormatError> {
    let schema = rows.schema();
    let fields = schema.fields();
    let mut surveys = vec![Survey::default(); fields.len()];
    let needed: Vec<usize> = (0..fields.len()).filter(|&i| Survey::is_needed(&fields[i])).collect();
    if !needed.is_empty() {
        for batch in rows.batches(Some(&needed))? {
            for (&column, values) in needed.iter().zip(batch?.columns()) {
                surveys[column].add(&fields[column], values)?;
            }
        }
    }
    let layout = |(field, survey): (&arrow_schema::FieldRef, Survey)| {
        Layout::of(field, survey).ok_or_else(|| FormatError::Column {
            column: field.name().clone(),
            kind: field.data_type().clone(),
            format: Format::Npz,
        })
    };
    fields.iter().zip(surveys).map(layout).collect()
}
