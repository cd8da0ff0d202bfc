//! Number of values in the pages of a Parquet file, by their headers: these are decoded, whatever the footer states.
//! Uses: parquet. Never: the content of a page.

use std::fs::File;
use std::sync::Arc;

use parquet::column::page::PageReader;
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::SerializedPageReader;

use super::columns::is_read;
use super::extent::column_of;

/// Checks that the pages of the columns that are read hold as many values as the footer states.
///
/// # Errors
/// `ParquetError` if they do not, or if a header cannot be read.
pub(super) fn check(file: &Arc<File>, footer: &ParquetMetaData) -> Result<(), ParquetError> {
    for group in footer.row_groups() {
        let rows = usize::try_from(group.num_rows()).unwrap_or_default();
        for leaf in group.columns() {
            let path = leaf.column_path().string();
            if !is_read(column_of(&path)) {
                continue;
            }
            let mut pages = SerializedPageReader::new(file.clone(), leaf, rows, None)?;
            let mut held: u64 = 0;
            while let Some(page) = pages.peek_next_page()? {
                held = held.saturating_add(page.num_levels.unwrap_or_default() as u64);
                pages.skip_next_page()?;
            }
            let stated = leaf.num_values();
            if i64::try_from(held).ok() != Some(stated) {
                return Err(ParquetError::General(format!(
                    "the pages of {path} hold {held} values, and the footer states {stated}"
                )));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use arrow_array::{ArrayRef, Int64Array, RecordBatch};
    use parquet::arrow::ArrowWriter;
    use parquet::file::metadata::ParquetMetaDataReader;
    use tempfile::NamedTempFile;

    use super::*;

    #[test]
    fn a_footer_that_states_fewer_values_than_there_are_is_refused() {
        let column: ArrayRef = Arc::new(Int64Array::from(vec![1, 2, 3]));
        let batch = RecordBatch::try_from_iter([("tips", column)]).unwrap();
        let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        let written = NamedTempFile::new().unwrap();
        std::fs::write(&written, writer.into_inner().unwrap()).unwrap();
        let file = Arc::new(File::open(written.path()).unwrap());
        let footer = ParquetMetaDataReader::new().parse_and_finish(&*file).unwrap();
        check(&file, &footer).unwrap();

        let group = footer.row_group(0);
        let leaf = group.column(0).clone().into_builder().set_num_values(2).build().unwrap();
        let group = group.clone().into_builder().set_column_metadata(vec![leaf]).build().unwrap();
        let wrong = ParquetMetaData::new(footer.file_metadata().clone(), vec![group]);
        let refused = check(&file, &wrong).unwrap_err().to_string();
        let words = "the pages of tips hold 3 values, and the footer states 2";
        assert!(refused.contains(words), "{refused}");
    }
}
