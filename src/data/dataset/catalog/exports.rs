//! Files of datasets in other formats: written on request, one after the other, and kept until space is needed.
//! Uses: `catalog`, `export`, the queue of tasks. Never: HTTP; two exports at once.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use tracing::Instrument;

use super::Catalog;
use crate::dataset::background::background;
use crate::dataset::build::{Progress, data_file};
use crate::dataset::error::{DatasetError, DatasetResult, Product};
use crate::dataset::export::{self, ExportFile, ExportRequest, ExportResult};
use crate::dataset::format::{Format, Rows};
use crate::dataset::read::{DatasetRows, PAPER_SKIN};
use crate::dataset::schema;
use crate::dataset::select::{Selection, Wanted};
use crate::dataset::space::{self, Space};
use crate::ids::TaskId;
use crate::journal::error_chain;
use crate::new_file;
use crate::store::{DatasetRow, TaskEnd, TaskKind, TaskRow};

/// Largest total size of the export files, bytes; the oldest are removed first.
const EXPORTS_BYTES: u64 = 20 << 30;
/// Number of hexadecimal digits of a sha256.
const SHA256_DIGITS: usize = 64;
/// Largest number of waiting exports.
const WAITING_EXPORTS_MAX: u32 = 100;

/// Progress of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ExportProgress {
    /// Number of rows written.
    pub rows_done: u64,
    /// Number of rows to write; 0 until they are counted, and if the export is not being written.
    pub rows_total: u64,
}

impl Catalog {
    /// Returns the file with the selected rows of a dataset in `format`; it is written if needed.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the selection does not fit the columns, `DiskFull` without free
    /// space; `File`, `Format` or `Parquet` if reading or writing fails.
    pub async fn file(
        &self,
        row: &DatasetRow,
        format: Format,
        wanted: &Wanted,
        progress: Arc<Progress>,
    ) -> DatasetResult<ExportFile> {
        let (catalog, row, wanted) = (self.clone(), row.clone(), wanted.clone());
        let writing = async move { catalog.write(&row, format, &wanted, progress).await };
        tokio::spawn(writing.in_current_span()).await.map_err(|_| DatasetError::Worker)?
    }

    async fn write(
        &self,
        row: &DatasetRow,
        format: Format,
        wanted: &Wanted,
        progress: Arc<Progress>,
    ) -> DatasetResult<ExportFile> {
        let rows = DatasetRows::open(&self.used(&row.id), wanted)?;
        if format == Format::Parquet && rows.is_whole() {
            let path = data_file(&self.datasets(), &row.id);
            return Ok(ExportFile { path, sha256: row.sha256.clone() });
        }
        let name = export::file_name(&row.id, format, wanted)?;
        let path = self.exports().join(&name);
        // The sha256 is stored in a file next to the export, and written after it.
        let digest_name = format!("{name}.sha256");
        let digest = self.exports().join(&digest_name);
        let existing = || {
            let sha256 = std::fs::read_to_string(&digest).ok().filter(|_| path.is_file())?;
            // Earlier versions did not sync this file: it may be truncated.
            let hex = sha256.bytes().all(|b| b.is_ascii_hexdigit());
            let whole = hex && sha256.len() == SHA256_DIGITS;
            whole.then(|| ExportFile { path: path.clone(), sha256 })
        };
        if let Some(file) = existing() {
            return Ok(file);
        }
        let _one_at_a_time = self.inner.writing.lock().await;
        // An equal request may have been completed while this one waited.
        if let Some(file) = existing() {
            return Ok(file);
        }
        let folder = self.exports();
        let needed = rows.count().saturating_mul(space::row_bytes(&rows.schema(), format));
        let free = self.inner.store.free_bytes().await?;
        // Old exports make room for a new one.
        trim(&folder, EXPORTS_BYTES, Space { needed, free }.lacking())
            .map_err(DatasetError::file("removing old exports in", &folder))?;
        let free = self.inner.store.free_bytes().await?;
        Space { needed, free }.check(Product::Export)?;
        let failed = DatasetError::file("writing", &digest);
        let writing = background(move || {
            let finished = export::write(&rows, format, &folder, &name, &progress)?;
            new_file::write(&folder, &digest_name, &finished.sha256).map_err(failed)?;
            Ok::<_, DatasetError>(finished.sha256)
        });
        let sha256 = writing.await??;
        Ok(ExportFile { path, sha256 })
    }

    /// Stores a request for an export. The request is checked against the dataset if it exists,
    /// otherwise against the columns of its definition.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the selection does not fit the columns or too many exports wait,
    /// `NoDataset` or `NotEnded` if the dataset cannot be made, `Store` if the store fails.
    pub async fn request_export(
        &self,
        request: &ExportRequest,
        asked_by: &str,
    ) -> DatasetResult<TaskRow> {
        if self.inner.queue.is_full(WAITING_EXPORTS_MAX).await? {
            let limit = format!("must be under {WAITING_EXPORTS_MAX}: wait until one ends");
            return Err(DatasetError::value("waiting exports", WAITING_EXPORTS_MAX, &limit));
        }
        let wanted = request.wanted();
        if let Ok(id) = request.dataset.parse() {
            self.pages(&self.of_id(&id).await?.id, &wanted)?;
        } else {
            // The number of channels, and so the range of a slice, is known after the dataset is
            // made.
            let wanted = Wanted { slice: None, ..wanted };
            let definition = self.definition(&request.dataset).await?;
            let columns = schema::of_dataset(&definition, schema::PAPER_CHANNELS);
            Selection::new(&wanted, &columns, Some(PAPER_SKIN)).map_err(DatasetError::Problems)?;
        }
        let request = serde_json::to_value(request).map_err(DatasetError::Json)?;
        Ok(self.inner.queue.add(TaskKind::Export, request, asked_by).await?)
    }

    /// Progress of the export with this id.
    pub fn export_progress(&self, export: TaskId) -> ExportProgress {
        let progress = self.inner.queue.running(export).unwrap_or_default();
        let (rows_done, rows_total) = (progress.done.load(Relaxed), progress.total.load(Relaxed));
        ExportProgress { rows_done, rows_total }
    }

    /// The file of a completed export; `None` before its completion, and after its removal.
    pub fn export_file(&self, export: &TaskRow) -> Option<ExportFile> {
        let ExportResult { file, sha256, .. } = ExportResult::of(export)?;
        let path = [self.exports(), self.datasets()].map(|folder| folder.join(&file));
        let path = path.into_iter().find(|path| path.is_file())?;
        Some(ExportFile { path, sha256 })
    }

    /// Writes the requested exports, oldest first, until the future is dropped.
    pub async fn work(self) {
        let write = |export: TaskRow, progress| {
            let catalog = self.clone();
            async move { catalog.write_export(&export, progress).await }
        };
        self.inner.queue.work(write, |_, _| ()).await;
    }

    async fn write_export(&self, export: &TaskRow, progress: Arc<Progress>) -> TaskEnd {
        let written = match self.write_requested(export, progress).await {
            Ok(written) => written,
            Err(error) => {
                // The record of the export has the cause for those who requested it: a command that started this
                // service would report it twice.
                let error = error_chain(&error);
                tracing::info!(error, "an export has failed");
                return TaskEnd::Failed(error);
            }
        };
        let bytes = match tokio::fs::metadata(&written.path).await {
            Ok(metadata) => metadata.len(),
            Err(error) => {
                return TaskEnd::Failed(format!("reading {}: {error}", written.path.display()));
            }
        };
        let file = written.path.file_name().unwrap_or_default().to_string_lossy().into();
        match serde_json::to_value(ExportResult { file, bytes, sha256: written.sha256 }) {
            Ok(result) => TaskEnd::Done(result),
            Err(error) => TaskEnd::Failed(DatasetError::Json(error).to_string()),
        }
    }

    async fn write_requested(
        &self,
        export: &TaskRow,
        progress: Arc<Progress>,
    ) -> DatasetResult<ExportFile> {
        let request: ExportRequest =
            serde_json::from_value(export.request.clone()).map_err(DatasetError::Json)?;
        // After a restart: the dataset that the export began with, not the current one of its name.
        let id = export.dataset.clone().or_else(|| request.dataset.parse().ok());
        let row = match id {
            Some(id) => self.of_id(&id).await?,
            None => {
                let definition = self.definition(&request.dataset).await?;
                self.make_watched(&definition, progress.clone()).await?
            }
        };
        self.inner.store.begin_task(export.id, Some(&row.id)).await?;
        self.file(&row, request.format, &request.wanted(), progress).await
    }
}

/// Removes the oldest files of a folder until their total size is at most `bytes` and at least `lacking`
/// bytes are removed.
fn trim(folder: &Path, bytes: u64, lacking: u64) -> std::io::Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry?;
        let metadata = entry.metadata()?;
        files.push((metadata.modified()?, metadata.len(), entry.path()));
    }
    files.sort();
    let mut held: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
    // If removing all files would not be enough, none is removed for it.
    let bytes = held.checked_sub(lacking).map_or(bytes, |kept| bytes.min(kept));
    for (_, length, path) in files {
        if held <= bytes {
            break;
        }
        std::fs::remove_file(path)?;
        held -= length;
    }
    Ok(())
}
