//! The datasets of a service: found, made on request; `exports` has their files in other formats.
//! Uses: `store`, `dataset::{build, export}`. Never: HTTP; two builds or two exports at once.
//!
//! An id stands for a dataset that never changes. A name stands for the newest dataset that was made
//! with it when it is read, and for the result of its definition when one is made.
//! Exports are tasks of the store, so that they continue after a restart.

mod exports;

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_schema::Schema;
use jiff::Timestamp;
use tracing::{Instrument, error_span};

use crate::clock::Clock;
use crate::dataset::begun::Begun;
use crate::dataset::build::{self, Progress, build, data_file};
use crate::dataset::card;
use crate::dataset::definition::Definition;
use crate::dataset::error::{DatasetError, DatasetResult, Product};
use crate::dataset::format::Format;
use crate::dataset::inputs::Inputs;
use crate::dataset::making::{AllMaking, MakingKind};
use crate::dataset::prune::{self, Pruned};
use crate::dataset::read::DatasetPages;
use crate::dataset::schema::{self, BATCH_ROWS};
use crate::dataset::select::Wanted;
use crate::dataset::space::{self, Space};
use crate::dataset::used;
use crate::ids::{DatasetId, RunUid};
use crate::near::did_you_mean;
use crate::new_file::sweep;
use crate::problem::Problem;
use crate::state::StoredState;
use crate::store::{DatasetRow, RunRow, Store, TaskKind, TaskQueue};

pub use self::exports::ExportProgress;

/// The datasets of a data folder. Clones share them.
#[derive(Clone)]
pub struct Catalog {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    data: PathBuf,
    clock: Clock,
    /// Held while a dataset is made; the begun file of a run.
    building: tokio::sync::Mutex<Option<Begun>>,
    writing: tokio::sync::Mutex<()>,
    queue: TaskQueue<Progress>,
    making: AllMaking,
}

impl Catalog {
    /// Opens the datasets of a data folder and removes unfinished files of an earlier process.
    ///
    /// # Errors
    /// `DatasetError::File` if an unfinished file cannot be removed.
    pub fn open(store: Store, data: &Path, clock: Clock) -> DatasetResult<Self> {
        let inner = Inner {
            queue: TaskQueue::new(store.clone(), TaskKind::EXPORTS),
            store,
            data: data.to_owned(),
            clock,
            building: tokio::sync::Mutex::default(),
            writing: tokio::sync::Mutex::default(),
            making: AllMaking::default(),
        };
        let catalog = Self { inner: Arc::new(inner) };
        for folder in [catalog.datasets(), catalog.exports(), catalog.uploads()] {
            sweep(&folder).map_err(DatasetError::file("removing unfinished files in", &folder))?;
        }
        Ok(catalog)
    }

    /// Folder of the dataset files.
    pub fn datasets(&self) -> PathBuf {
        self.inner.data.join("datasets")
    }

    /// Folder of files that are being uploaded.
    pub fn uploads(&self) -> PathBuf {
        self.inner.data.join("uploads")
    }

    /// The datasets that are made on request, and the imports.
    pub fn making(&self) -> &AllMaking {
        &self.inner.making
    }

    /// Folder of the export files.
    fn exports(&self) -> PathBuf {
        self.inner.data.join("exports")
    }

    /// Returns the dataset with this id, or the newest one of this name. None is made.
    ///
    /// # Errors
    /// `DatasetError::NoDataset` if the id or name is unknown, `NotMade` if no dataset of the name
    /// has been made, `FileMissing` if its file is missing, `NotEnded` for the name of a run that
    /// has not ended.
    pub async fn find(&self, name: &str) -> DatasetResult<DatasetRow> {
        if let Ok(id) = name.parse() {
            return self.of_id(&id).await;
        }
        match self.inner.store.newest_dataset(name).await? {
            Some(row) => self.of_id(&row.id).await,
            None => {
                let definition = self.definition(name).await?;
                Err(DatasetError::NotMade(definition.name))
            }
        }
    }

    /// Whether making a dataset again would return the same one; `None` if it could not be made
    /// again, because its runs or shards no longer exist.
    ///
    /// # Errors
    /// `DatasetError::Store` if the store fails.
    pub async fn is_current(&self, row: &DatasetRow) -> DatasetResult<Option<bool>> {
        let Ok(definition) = serde_json::from_value(row.definition.clone()) else {
            return Ok(None);
        };
        match self.existing(&definition).await {
            Ok((now, _)) => Ok(Some(now.is_some_and(|now| now.id == row.id))),
            Err(DatasetError::Store(error)) => Err(error.into()),
            Err(_) => Ok(None),
        }
    }

    /// Returns the dataset with this id, or the one of this name of the trials stored now, which is
    /// made if needed.
    ///
    /// # Errors
    /// As [`Self::find`], and the errors of [`Self::make`].
    pub async fn resolve(&self, name: &str) -> DatasetResult<DatasetRow> {
        if let Ok(id) = name.parse() {
            return self.of_id(&id).await;
        }
        let definition = self.definition(name).await?;
        self.make(&definition).await
    }

    /// Returns the file of a run's dataset; `None` if it has not been made of the trials and twins that
    /// are stored now.
    ///
    /// # Errors
    /// `DatasetError::Store` if the store fails.
    pub async fn current_of_run(&self, run: &RunRow) -> DatasetResult<Option<PathBuf>> {
        if run.state != StoredState::Ended {
            return Ok(None);
        }
        let (row, _) = self.existing(&Definition::of_run(run.scan_id)).await?;
        Ok(row.map(|row| data_file(&self.datasets(), &row.id)))
    }

    async fn of_id(&self, id: &DatasetId) -> DatasetResult<DatasetRow> {
        match self.inner.store.dataset(id).await? {
            Some(row) if data_file(&self.datasets(), id).is_file() => Ok(row),
            Some(row) => Err(DatasetError::FileMissing(row.id)),
            None => Err(self.no_dataset(id.as_str())),
        }
    }

    fn no_dataset(&self, name: &str) -> DatasetError {
        let choices = Definition::built_in_names().collect::<Vec<_>>();
        let meant = match name.parse::<u32>() {
            Ok(run) => format!("; did you mean `run-{run}`?"),
            Err(_) => did_you_mean(name, choices.iter().copied()),
        };
        DatasetError::NoDataset { name: name.into(), choices: choices.join(", "), meant }
    }

    /// Returns the definition of a name: of a run (`run-N`), built in, or of the newest dataset of
    /// that name.
    ///
    /// # Errors
    /// `DatasetError::NoDataset` if the name is unknown, `NotEnded` for a run that has not ended,
    /// `Store` if the store fails.
    pub async fn definition(&self, name: &str) -> DatasetResult<Definition> {
        if let Some(run) = self.run_of(name).await? {
            return match run.state {
                StoredState::Ended => Ok(Definition::of_run(run.scan_id)),
                _ => Err(DatasetError::NotEnded(run.scan_id)),
            };
        }
        if let Some(built_in) = Definition::built_in(name) {
            return Ok(built_in);
        }
        match self.inner.store.newest_dataset(name).await? {
            Some(row) => serde_json::from_value(row.definition).map_err(DatasetError::Json),
            None => Err(self.no_dataset(name)),
        }
    }

    /// Makes the dataset of a client's definition. Its name must not be that of a built-in
    /// definition with other content, or of a run.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the definition is invalid or its name is in use; the errors of
    /// [`Self::make`].
    pub async fn make_custom(
        &self,
        file: &str,
        definition: &Definition,
    ) -> DatasetResult<DatasetRow> {
        definition.check(file).map_err(DatasetError::Problems)?;
        let name = &definition.name;
        let taken = name.starts_with("run-")
            || Definition::built_in(name).is_some_and(|built_in| built_in != *definition);
        if taken {
            let limit = "is the name of a built-in dataset or of a run: choose another name";
            return Err(DatasetError::Problems(vec![Problem::new(file, "name", name, limit)]));
        }
        self.make(definition).await
    }

    async fn run_of(&self, name: &str) -> DatasetResult<Option<RunRow>> {
        let Some(scan_id) = name.strip_prefix("run-").and_then(|n| n.parse().ok()) else {
            return Ok(None);
        };
        Ok(self.inner.store.run_by_scan_id(scan_id).await?)
    }

    /// Returns the dataset of a definition on the current trials and shards. It is made unless it
    /// exists.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the definition is invalid, `NoRun`, `Labels`, `Channels` or
    /// `Models` if its runs or shards do not exist or do not fit each other, `Empty` if there are
    /// none, `DiskFull` without free space; `Store`, `File` or `Shards` if reading or writing
    /// fails.
    pub async fn make(&self, definition: &Definition) -> DatasetResult<DatasetRow> {
        let progress = self.making().begin(MakingKind::Dataset, &definition.name);
        self.make_watched(definition, progress).await
    }

    async fn make_watched(
        &self,
        definition: &Definition,
        progress: Arc<Progress>,
    ) -> DatasetResult<DatasetRow> {
        if let Some(row) = self.existing(definition).await?.0 {
            return Ok(row);
        }
        // A separate task: it continues without the caller, and the next request finds the result.
        let (catalog, definition) = (self.clone(), definition.clone());
        let span = error_span!("dataset", dataset = definition.name);
        let making = async move {
            let mut building = catalog.inner.building.lock().await;
            let (row, inputs) = catalog.existing(&definition).await?;
            if let Some(row) = row {
                return Ok(row);
            }
            let name = definition.name.clone();
            if inputs.candidates() == 0 {
                let why = "no ended run and no shard matches its definition".into();
                return Err(DatasetError::Empty { name, why });
            }
            let columns =
                schema::of_dataset(&definition, inputs.channels(&catalog.inner.store).await?);
            let begun = building.take_if(|begun| begun.is_of(&definition));
            let rows = inputs.candidates().saturating_sub(begun.as_ref().map_or(0, Begun::rows));
            catalog.check_space(rows, &columns).await?;
            let (store, folder) = (&catalog.inner.store, catalog.datasets());
            let at = catalog.inner.clock.timestamp();
            let row = build(store, &folder, inputs, begun, at, progress).await?;
            tracing::info!(id = %row.id, rows = row.rows, "a dataset was made");
            Ok(row)
        };
        tokio::spawn(making.instrument(span)).await.map_err(|_| DatasetError::Worker)?
    }

    /// Writes the next 1000 trials of an active run to the begun file of its dataset, if they have their
    /// twins. Does nothing while a dataset is made, or if the disk has only the space for runs.
    ///
    /// # Errors
    /// `DatasetError::Store` or `File` if the trials cannot be read or written.
    pub async fn write_ahead(&self, run: RunUid, scan_id: i64) -> DatasetResult<()> {
        let Ok(mut begun) = self.inner.building.try_lock() else { return Ok(()) };
        let (rows, columns) = (BATCH_ROWS as u64, schema::all(schema::PAPER_CHANNELS));
        match self.check_space(rows, &columns).await {
            Err(DatasetError::DiskFull { .. }) => return Ok(()),
            checked => checked?,
        }
        Begun::advance(&mut begun, &self.inner.store, &self.datasets(), run, scan_id).await
    }

    /// Returns the scan id of the run whose dataset has a begun file; `None` also while a dataset is made.
    pub fn begun(&self) -> Option<i64> {
        self.inner.building.try_lock().ok()?.as_ref().map(Begun::scan_id)
    }

    /// The dataset of the current inputs of a definition, if it exists, and these inputs.
    async fn existing(
        &self,
        definition: &Definition,
    ) -> DatasetResult<(Option<DatasetRow>, Inputs)> {
        let inputs = Inputs::find(&self.inner.store, &self.inner.data, definition).await?;
        let row = self.inner.store.dataset_of_inputs(&inputs.key).await?;
        let existing = row.filter(|row| data_file(&self.datasets(), &row.id).is_file());
        Ok((existing, inputs))
    }

    /// Checks that the disk has room for a dataset of `rows` rows.
    async fn check_space(&self, rows: u64, columns: &Schema) -> DatasetResult<()> {
        let needed = rows.saturating_mul(space::row_bytes(columns, Format::Parquet));
        Space { needed, free: self.inner.store.free_bytes().await? }.check(Product::Dataset)
    }

    /// Checks that the disk has room for an upload of `bytes` bytes and for its trials; 0 bytes: that
    /// the space for runs is free.
    ///
    /// # Errors
    /// `DatasetError::DiskFull` if it has not, `Store` if the free space is unknown.
    pub async fn check_upload(&self, bytes: u64) -> DatasetResult<()> {
        let (needed, free) = (space::upload_bytes(bytes), self.inner.store.free_bytes().await?);
        Space { needed, free }.check(Product::Import)
    }

    /// Opens selected rows of a dataset, for pages.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the selection does not fit the columns; `File` or `Parquet` if
    /// the file cannot be read.
    pub fn pages(&self, id: &DatasetId, wanted: &Wanted) -> DatasetResult<DatasetPages> {
        DatasetPages::open(&self.used(id), wanted)
    }

    /// Returns the file of a dataset, and notes that its rows are read now.
    pub fn used(&self, id: &DatasetId) -> PathBuf {
        let path = data_file(&self.datasets(), id);
        used::note(&path);
        path
    }

    /// Returns what [`Self::prune`] would do with each dataset; removes none.
    ///
    /// # Errors
    /// `DatasetError::Store` if the store fails.
    pub async fn prunable(&self, keep: usize) -> DatasetResult<Vec<Pruned>> {
        let rows = self.inner.store.datasets().await?;
        let needed = self.inner.store.dataset_users().await?;
        Ok(prune::decide(&rows, keep, &needed, |id| self.last_used_at(id)))
    }

    /// Removes the datasets of each name except the `keep` newest and those to which a model or a job
    /// refers. Returns what became of each.
    ///
    /// # Errors
    /// `DatasetError::Store` if the store fails; `File` if a file cannot be removed.
    pub async fn prune(&self, keep: usize) -> DatasetResult<Vec<Pruned>> {
        let _no_build = self.inner.building.lock().await;
        let decided = self.prunable(keep).await?;
        let gone: Vec<DatasetId> =
            decided.iter().filter(|one| one.stays.is_none()).map(|one| one.id.clone()).collect();
        if gone.is_empty() {
            return Ok(decided);
        }
        self.inner.store.remove_datasets(gone.clone()).await?;
        for id in &gone {
            let folder = self.datasets();
            for path in [data_file(&folder, id), build::card_file(&folder, id)] {
                match std::fs::remove_file(&path) {
                    Err(error) if error.kind() != ErrorKind::NotFound => {
                        return Err(DatasetError::file("removing", &path)(error));
                    }
                    _ => {}
                }
            }
        }
        tracing::info!(removed = gone.len(), "datasets were removed");
        Ok(decided)
    }

    /// Wall time at which the rows of a dataset were last read; `None` if it is unknown.
    pub fn last_used_at(&self, id: &DatasetId) -> Option<Timestamp> {
        used::last_used_at(&data_file(&self.datasets(), id))
    }

    /// Returns the card of a dataset, Markdown. One without a file, since the process ended before it was written, is
    /// written from the row.
    ///
    /// # Errors
    /// `DatasetError::File` if the card cannot be read.
    pub fn card(&self, row: &DatasetRow) -> DatasetResult<String> {
        let path = build::card_file(&self.datasets(), &row.id);
        match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(card::text(row)),
            text => text.map_err(DatasetError::file("reading", &path)),
        }
    }
}
