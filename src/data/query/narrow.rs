//! The columns of a dataset without its frames, in a second file with few row groups: a question about millions
//! of trials reads their values, not the footers of thousands of row groups (`docs/decisions/0015`).
//! Uses: arrow, parquet, `dataset::format`. Never: all rows at once, a file of a dataset that is no longer there, a
//! sync to the disk during a run.

use std::fs::File;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatchReader;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use crate::dataset::background::background;
use crate::dataset::error::{DatasetError, DatasetResult, Product};
use crate::dataset::format::{Format, Stream};
use crate::dataset::space::Space;
use crate::new_file::NewFile;
use crate::store::table::Column;

/// Rows of a row group: 20 MB in memory.
const NARROW_ROWS: usize = 32_768;

/// Returns the file of `folder` with the columns of a dataset's file except its frames; `None` if it is not written.
pub fn known(folder: &Path, dataset: &Path) -> Option<PathBuf> {
    let narrow = folder.join(dataset.file_name()?);
    narrow.is_file().then_some(narrow)
}

/// Returns the file of `folder` with the columns of a dataset's file except its frames; it is written if it is
/// missing. It has the name of the dataset's file and never changes. `free` is the free space of the disk, bytes.
///
/// # Errors
/// `DatasetError` if the dataset's file cannot be read, or this one not be written without the space that is reserved
/// for runs.
pub async fn of_dataset(folder: &Path, dataset: &Path, free: u64) -> DatasetResult<PathBuf> {
    if let Some(narrow) = known(folder, dataset) {
        return Ok(narrow);
    }
    // It is smaller than the dataset's file.
    let needed = dataset.metadata().map_err(DatasetError::file("opening", dataset))?.len();
    Space { needed, free }.check(Product::Dataset)?;
    let name = dataset.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let narrow = folder.join(&name);
    let (folder, dataset) = (folder.to_owned(), dataset.to_owned());
    background(move || write(&folder, &name, &dataset)).await??;
    Ok(narrow)
}

fn write(folder: &Path, name: &str, dataset: &Path) -> DatasetResult<()> {
    let file = File::open(dataset).map_err(DatasetError::file("opening", dataset))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file)?;
    let is_frame = |name: &str| Column::find(name).is_some_and(Column::is_frame);
    let columns: Vec<usize> = (0..builder.schema().fields().len())
        .filter(|&at| !is_frame(builder.schema().field(at).name()))
        .collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), columns);
    // A batch takes its rows from several row groups, and becomes one.
    let rows = builder.with_projection(mask).with_batch_size(NARROW_ROWS).build()?;
    let failed = DatasetError::file("writing", &folder.join(name));
    let file = NewFile::create(folder).map_err(&failed)?;
    let mut stream = Stream::new(Format::Parquet, &rows.schema(), file)?;
    for batch in rows {
        stream.push(&batch?)?;
    }
    // It is read by later processes, too.
    stream.finish()?.finish_first(name).map_err(failed)
}

/// Removes the files whose dataset is no longer in `datasets`. Those that cannot be removed now stay.
pub fn trim(folder: &Path, datasets: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let is_complete = name.to_string_lossy().starts_with("ds-");
        if is_complete && !datasets.join(&name).exists() {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow_array::builder::{FixedSizeListBuilder, Float32Builder};
    use arrow_array::{Array, ArrayRef, Int64Array, RecordBatch, StringArray};
    use arrow_select::concat::concat_batches;

    use super::*;

    /// A disk with enough space.
    const ROOM: u64 = u64::MAX / 2;

    /// A batch of trials from this id, with frames of two voltages.
    fn batch(first: i64, rows: i64) -> RecordBatch {
        let ids: Vec<i64> = (first..first + rows).collect();
        let labels: Vec<String> = ids.iter().map(|id| format!("virtual {}", id % 3)).collect();
        let mut volts = FixedSizeListBuilder::new(Float32Builder::new(), 2);
        for id in &ids {
            volts.values().append_value(*id as f32);
            volts.values().append_null();
            volts.append(true);
        }
        let columns: [(&str, ArrayRef); 3] = [
            ("trial_id", Arc::new(Int64Array::from(ids))),
            ("voltages_v", Arc::new(volts.finish())),
            ("label", Arc::new(StringArray::from(labels))),
        ];
        RecordBatch::try_from_iter(columns).unwrap()
    }

    #[tokio::test]
    async fn a_narrow_file_has_the_rows_in_few_groups_until_its_dataset_goes() {
        let folder = tempfile::tempdir().unwrap();
        let [datasets, narrow] = ["datasets", "columns"].map(|name| folder.path().join(name));
        let all: Vec<RecordBatch> = (0..40).map(|group| batch(group * 1000, 1000)).collect();
        let file = NewFile::create(&datasets).unwrap();
        let mut stream = Stream::new(Format::Parquet, &all[0].schema(), file).unwrap();
        for one in &all {
            stream.push(one).unwrap();
        }
        stream.finish().unwrap().finish("ds-1.parquet").unwrap();

        let dataset = datasets.join("ds-1.parquet");
        assert_eq!(known(&narrow, &dataset), None);
        let full = of_dataset(&narrow, &dataset, 1 << 30).await.unwrap_err();
        assert!(matches!(full, DatasetError::DiskFull { .. }), "{full}");
        let made = of_dataset(&narrow, &dataset, ROOM).await.unwrap();
        assert_eq!(made, narrow.join("ds-1.parquet"));
        assert_eq!(known(&narrow, &dataset).as_ref(), Some(&made));
        let builder = ParquetRecordBatchReaderBuilder::try_new(File::open(&made).unwrap()).unwrap();
        assert_eq!(builder.metadata().num_row_groups(), 2);
        let names: Vec<&String> = builder.schema().fields().iter().map(|f| f.name()).collect();
        assert_eq!(names, ["trial_id", "label"]);
        let found: Vec<RecordBatch> = builder.build().unwrap().map(Result::unwrap).collect();
        let found = concat_batches(&found[0].schema(), &found).unwrap();
        let all = concat_batches(&all[0].schema(), &all).unwrap();
        for name in ["trial_id", "label"] {
            let [found, all] = [&found, &all].map(|rows| rows.column_by_name(name).unwrap());
            assert_eq!(found.to_data(), all.to_data(), "{name}");
        }

        let written = std::fs::metadata(&made).unwrap().modified().unwrap();
        of_dataset(&narrow, &dataset, ROOM).await.unwrap();
        trim(&narrow, &datasets);
        assert_eq!(std::fs::metadata(&made).unwrap().modified().unwrap(), written);
        std::fs::remove_file(&dataset).unwrap();
        trim(&narrow, &datasets);
        assert!(!made.exists());
        of_dataset(&narrow, &dataset, ROOM).await.unwrap_err();
    }
}
