//! The datasets of a service: found, made when they are asked for, exported one after the other.
//! Uses: `store`, `dataset::{build, export}`. Never: HTTP; two builds or two exports at once.
//!
//! A name stands for the dataset that its definition gives on what is stored now; an id for one
//! that never changes. Exports are rows of the store, so that a restart goes on with them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;

use super::background::background;
use super::build::{self, Progress, build, data_file};
use super::definition::Definition;
use super::error::DatasetError;
use super::export::{self, ExportRequest, Sendable};
use super::file::sweep;
use super::format::{Format, Rows};
use super::inputs::Inputs;
use super::read::{DatasetRows, SKIN};
use super::schema;
use super::select::{Selection, Wanted};
use crate::clock::Clock;
use crate::problem::Problem;
use crate::store::{DatasetRow, ExportEnd, ExportRow, RunRow, Store};

/// Free bytes that stay for runs, whatever is exported.
const KEPT_FREE_BYTES: u64 = 2 << 30;
/// Most bytes of export files that are kept; the oldest go first.
const EXPORTS_BYTES: u64 = 20 << 30;
/// Most exports that may wait.
const WAITING_MAX: u32 = 100;
/// Pause of the worker when nothing waits.
const IDLE: Duration = Duration::from_millis(500);

/// How far something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Done {
    /// Rows that are written.
    pub rows_done: u64,
    /// Rows to write; 0 while they are being counted.
    pub rows_total: u64,
}

/// The datasets. Clones share them.
#[derive(Clone)]
pub struct Catalog {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    data: PathBuf,
    clock: Clock,
    building: tokio::sync::Mutex<()>,
    writing: tokio::sync::Mutex<()>,
    progress: Mutex<HashMap<String, Arc<Progress>>>,
    changed: watch::Sender<u64>,
}

impl Catalog {
    /// The datasets of a data folder. What a killed process left half written is removed.
    pub fn open(store: Store, data: &Path, clock: Clock) -> Result<Self, DatasetError> {
        let inner = Inner {
            store,
            data: data.to_owned(),
            clock,
            building: tokio::sync::Mutex::default(),
            writing: tokio::sync::Mutex::default(),
            progress: Mutex::default(),
            changed: watch::Sender::new(0),
        };
        let catalog = Self { inner: Arc::new(inner) };
        for folder in [catalog.datasets(), catalog.exports(), catalog.uploads()] {
            sweep(&folder).map_err(DatasetError::file("sweeping", &folder))?;
        }
        Ok(catalog)
    }

    /// Folder of the datasets' files.
    pub fn datasets(&self) -> PathBuf {
        self.inner.data.join("datasets")
    }

    /// Folder of files that are being handed in.
    pub fn uploads(&self) -> PathBuf {
        self.inner.data.join("uploads")
    }

    /// Folder of the exports' files.
    fn exports(&self) -> PathBuf {
        self.inner.data.join("exports")
    }

    /// The dataset of an id, or the one that a name stands for now, made if need be.
    pub async fn resolve(&self, name: &str) -> Result<DatasetRow, DatasetError> {
        if name.starts_with("ds-") {
            return self.of_id(name).await;
        }
        let definition = self.definition(name).await?;
        self.make(&definition).await
    }

    async fn of_id(&self, id: &str) -> Result<DatasetRow, DatasetError> {
        match self.inner.store.dataset(id).await? {
            Some(row) if data_file(&self.datasets(), id).is_file() => Ok(row),
            Some(row) => Err(DatasetError::Damaged(row.id)),
            None => Err(self.no_dataset(id)),
        }
    }

    fn no_dataset(&self, name: &str) -> DatasetError {
        let choices = Definition::built_in_names().collect::<Vec<_>>().join(", ");
        DatasetError::NoDataset { name: name.into(), choices }
    }

    /// The definition that a name stands for: of a run (`run-N`), of the binary, or of the last dataset
    /// of that name.
    pub async fn definition(&self, name: &str) -> Result<Definition, DatasetError> {
        if let Some(run) = self.run_of(name).await? {
            return match run.state.as_str() {
                "ended" => Ok(Definition::of_run(run.scan_id)),
                _ => Err(DatasetError::NotEnded(run.scan_id)),
            };
        }
        if let Some(built_in) = Definition::built_in(name) {
            return Ok(built_in);
        }
        match self.inner.store.newest_dataset(name).await? {
            Some(row) => serde_json::from_value(row.definition).map_err(DatasetError::json),
            None => Err(self.no_dataset(name)),
        }
    }

    /// Makes the dataset of somebody's definition, which must not take a name that means another.
    pub async fn make_own(
        &self,
        file: &str,
        definition: &Definition,
    ) -> Result<DatasetRow, DatasetError> {
        definition.check(file).map_err(DatasetError::Problems)?;
        let name = &definition.name;
        let taken = name.starts_with("run-")
            || Definition::built_in(name).is_some_and(|built_in| built_in != *definition);
        if taken {
            let limit = "is the name of another dataset: choose one of your own";
            return Err(DatasetError::Problems(vec![Problem::new(file, "name", name, limit)]));
        }
        self.make(definition).await
    }

    async fn run_of(&self, name: &str) -> Result<Option<RunRow>, DatasetError> {
        let Some(scan_id) = name.strip_prefix("run-").and_then(|n| n.parse().ok()) else {
            return Ok(None);
        };
        Ok(self.inner.store.run_by_scan_id(scan_id).await?)
    }

    /// The dataset that a definition gives on what is stored now. One that is there is not made
    /// again.
    pub async fn make(&self, definition: &Definition) -> Result<DatasetRow, DatasetError> {
        self.make_watched(definition, Arc::default()).await
    }

    async fn make_watched(
        &self,
        definition: &Definition,
        progress: Arc<Progress>,
    ) -> Result<DatasetRow, DatasetError> {
        if let Some(row) = self.made(definition).await?.0 {
            return Ok(row);
        }
        // Goes on when the one who asked has gone: the next one to ask finds it made.
        let (catalog, definition) = (self.clone(), definition.clone());
        let making = tokio::spawn(async move {
            let _one_at_a_time = catalog.inner.building.lock().await;
            let (row, inputs) = catalog.made(&definition).await?;
            if let Some(row) = row {
                return Ok(row);
            }
            let name = definition.name.clone();
            if inputs.candidates() == 0 {
                let why = "no ended run, and no shard, that it takes".into();
                return Err(DatasetError::Empty { name, why });
            }
            catalog.room_for(inputs.candidates() * 4096).await?;
            let (store, folder) = (&catalog.inner.store, catalog.datasets());
            let at = catalog.inner.clock.timestamp();
            let row = build(store, &folder, inputs, at, progress).await?;
            tracing::info!(dataset = row.id, name, rows = row.rows, "a dataset was made");
            Ok(row)
        });
        making.await.map_err(|_| DatasetError::Worker)?
    }

    /// The dataset of a definition's present inputs, if it is there.
    async fn made(
        &self,
        definition: &Definition,
    ) -> Result<(Option<DatasetRow>, Inputs), DatasetError> {
        let inputs = Inputs::find(&self.inner.store, &self.inner.data, definition).await?;
        let row = self.inner.store.dataset_of_inputs(&inputs.key).await?;
        let there = row.filter(|row| data_file(&self.datasets(), &row.id).is_file());
        Ok((there, inputs))
    }

    async fn room_for(&self, needed: u64) -> Result<(), DatasetError> {
        let free = self.inner.store.free_bytes().await?;
        if free < KEPT_FREE_BYTES + needed {
            return Err(DatasetError::DiskFull { needed, free, kept: KEPT_FREE_BYTES });
        }
        Ok(())
    }

    /// Chosen rows of a dataset; what is wrong with the choice otherwise.
    pub fn rows(&self, id: &str, wanted: &Wanted) -> Result<DatasetRows, DatasetError> {
        DatasetRows::open(&data_file(&self.datasets(), id), wanted)
    }

    /// The text of a dataset's card.
    pub fn card(&self, id: &str) -> Result<String, DatasetError> {
        let path = build::card_file(&self.datasets(), id);
        std::fs::read_to_string(&path).map_err(DatasetError::file("reading", &path))
    }

    /// The file of a dataset's rows in this format, written if need be.
    pub async fn file(
        &self,
        row: &DatasetRow,
        format: Format,
        wanted: &Wanted,
        progress: Arc<Progress>,
    ) -> Result<Sendable, DatasetError> {
        let (catalog, row, wanted) = (self.clone(), row.clone(), wanted.clone());
        let writing =
            tokio::spawn(async move { catalog.write(&row, format, &wanted, progress).await });
        writing.await.map_err(|_| DatasetError::Worker)?
    }

    async fn write(
        &self,
        row: &DatasetRow,
        format: Format,
        wanted: &Wanted,
        progress: Arc<Progress>,
    ) -> Result<Sendable, DatasetError> {
        let rows = self.rows(&row.id, wanted)?;
        if format == Format::Parquet && rows.is_whole() {
            let path = data_file(&self.datasets(), &row.id);
            return Ok(Sendable { path, sha256: row.sha256.clone() });
        }
        let name = export::file_name(&row.id, format, wanted)?;
        let path = self.exports().join(&name);
        // The sha256 stands beside the file, and is written after it.
        let beside = path.with_extension(format!("{}.sha256", format.extension()));
        let there = || {
            let sha256 = std::fs::read_to_string(&beside).ok().filter(|_| path.is_file())?;
            Some(Sendable { path: path.clone(), sha256 })
        };
        if let Some(sendable) = there() {
            return Ok(sendable);
        }
        let _one_at_a_time = self.inner.writing.lock().await;
        // Somebody else may have wished for the same meanwhile.
        if let Some(sendable) = there() {
            return Ok(sendable);
        }
        let bytes_a_row = 8 * rows.schema().fields().len() as u64 + 3 * row.bytes / row.rows.max(1);
        self.room_for(rows.count() * bytes_a_row).await?;
        let folder = self.exports();
        trim(&folder, EXPORTS_BYTES).map_err(DatasetError::file("trimming", &folder))?;
        let writing = background(move || export::write(&rows, format, &folder, &name, &progress));
        let finished = writing.await??;
        std::fs::write(&beside, &finished.sha256)
            .map_err(DatasetError::file("writing", &beside))?;
        Ok(Sendable { path, sha256: finished.sha256 })
    }

    /// Stores a request for an export, checked as far as its dataset exists.
    pub async fn ask(
        &self,
        request: &ExportRequest,
        asked_by: &str,
    ) -> Result<ExportRow, DatasetError> {
        let waiting = self.inner.store.open_exports(WAITING_MAX).await?.len();
        if waiting >= WAITING_MAX as usize {
            let limit = format!("must be under {WAITING_MAX}: wait for some to end");
            return Err(DatasetError::value("exports that wait", waiting, &limit));
        }
        let wanted = request.wanted();
        if request.dataset.starts_with("ds-") {
            self.rows(&self.of_id(&request.dataset).await?.id, &wanted)?;
        } else {
            // The number of channels is known when its rows are.
            let wanted = Wanted { slice: None, ..wanted };
            let definition = self.definition(&request.dataset).await?;
            let columns = schema::of_dataset(&definition, schema::CHANNELS);
            Selection::new(&wanted, &columns, Some(SKIN)).map_err(DatasetError::Problems)?;
        }
        let id = format!("ex-{}", uuid::Uuid::now_v7());
        let text = serde_json::to_value(request).map_err(DatasetError::json)?;
        let row = self.inner.store.create_export(id, text, asked_by).await?;
        self.inner.changed.send_modify(|changes| *changes += 1);
        Ok(row)
    }

    /// How far an export is that is being written.
    pub fn done(&self, export: &str) -> Done {
        use std::sync::atomic::Ordering::Relaxed;
        let progress = self.progress().get(export).cloned().unwrap_or_default();
        Done { rows_done: progress.done.load(Relaxed), rows_total: progress.total.load(Relaxed) }
    }

    /// The file of an export that is done, if it is still there.
    pub fn exported(&self, export: &ExportRow) -> Option<Sendable> {
        let (file, sha256) = (export.file.as_ref()?, export.sha256.clone()?);
        let path = [self.exports(), self.datasets()].map(|folder| folder.join(file));
        let path = path.into_iter().find(|path| path.is_file())?;
        Some(Sendable { path, sha256 })
    }

    /// Carries out exports until it is dropped, oldest first.
    pub async fn work(self) {
        let mut changed = self.inner.changed.subscribe();
        loop {
            match self.inner.store.open_exports(1).await {
                Ok(open) if !open.is_empty() => {
                    for export in open {
                        self.carry_out(export).await;
                    }
                    continue;
                }
                Ok(_) => {}
                Err(error) => tracing::warn!(%error, "exports are not looked at"),
            }
            // A change that is missed is found at the next look.
            let _ = tokio::time::timeout(IDLE, changed.changed()).await;
        }
    }

    async fn carry_out(&self, export: ExportRow) {
        let progress = Arc::new(Progress::default());
        self.progress().insert(export.id.clone(), progress.clone());
        let end = match self.exported_file(&export, progress).await {
            Ok(sendable) => match tokio::fs::metadata(&sendable.path).await {
                Ok(metadata) => ExportEnd::Done {
                    file: sendable.path.file_name().unwrap_or_default().to_string_lossy().into(),
                    bytes: metadata.len(),
                    sha256: sendable.sha256,
                },
                Err(error) => ExportEnd::Failed(error.to_string()),
            },
            Err(error) => ExportEnd::Failed(error.to_string()),
        };
        if let Err(error) = self.inner.store.end_export(&export.id, end).await {
            tracing::error!(%error, export = export.id, "the end of an export was not stored");
            tokio::time::sleep(IDLE).await;
        }
        self.progress().remove(&export.id);
    }

    async fn exported_file(
        &self,
        export: &ExportRow,
        progress: Arc<Progress>,
    ) -> Result<Sendable, DatasetError> {
        let request: ExportRequest =
            serde_json::from_value(export.request.clone()).map_err(DatasetError::json)?;
        let store = &self.inner.store;
        store.begin_export(&export.id, None).await?;
        // After a restart the dataset that it had begun on, not what the name stands for by now.
        let row = match &export.dataset {
            Some(id) => self.of_id(id).await?,
            None if request.dataset.starts_with("ds-") => self.of_id(&request.dataset).await?,
            None => {
                let definition = self.definition(&request.dataset).await?;
                self.make_watched(&definition, progress.clone()).await?
            }
        };
        store.begin_export(&export.id, Some(&row.id)).await?;
        self.file(&row, request.format, &request.wanted(), progress).await
    }

    fn progress(&self) -> parking_lot::MutexGuard<'_, HashMap<String, Arc<Progress>>> {
        self.inner.progress.lock()
    }
}

/// Removes the oldest files of a folder until it holds no more than this.
fn trim(folder: &Path, bytes: u64) -> std::io::Result<()> {
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
    for (_, length, path) in files {
        if held <= bytes {
            break;
        }
        std::fs::remove_file(path)?;
        held -= length;
    }
    Ok(())
}
