//! The tables of a statement: their names, and the files with their rows.
//! Uses: `dataset::catalog`, `pieces`, `narrow`, `records`. Never: a table that a statement does not read.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use parking_lot::Mutex;

use super::error::QueryError;
use super::records::{self, Scratch};
use super::{narrow, pieces};
use crate::dataset::catalog::Catalog;
use crate::dataset::error::{DatasetError, DatasetResult};
use crate::ids::RunUid;
use crate::near::did_you_mean;
use crate::new_file::sweep;
use crate::query_lines::{Form, Table};
use crate::state::StoredState;
use crate::store::{RunRow, Store};

/// A table that every data folder has, for messages and the manual.
#[derive(Debug)]
pub struct TableAbout {
    /// Name of the table in a statement.
    pub name: &'static str,
    /// What a row is.
    pub about: &'static str,
    form: Form,
}

const fn t(name: &'static str, form: Form, about: &'static str) -> TableAbout {
    TableAbout { name, about, form }
}

/// The tables that every data folder has; each dataset is a table, too.
#[rustfmt::skip]
pub static TABLES: [TableAbout; 8] = [
    t("trials", Form::Trials, "a trial: every column but the frames"),
    t("contacts", Form::Contacts, "a contact of a trial: `trial_id`, `scan_id`, `x_mm`, `y_mm`, `force_n`, `diameter_mm`"),
    t("frames", Form::Frames, "a trial: `trial_id`, `scan_id`, its measured frame `voltages_v` and its simulated frame `sim_voltages_v`, lists"),
    t("twins", Form::Twins, "a trial with a simulated twin: `trial_id`, `scan_id`, `sim_model`, `rmse_v`, `fvu`, `sim_voltages_v`"),
    t("voltages", Form::Voltages, "a voltage of a frame: `trial_id`, `scan_id`, `position` in the frame, `injection` and `pair` of electrodes, `voltage_v`, `sim_voltage_v`"),
    t("runs", Form::Rows, "a run: `scan_id`, `experiment`, `label`, `state`, `exit_status`, `trials_planned`, times"),
    t("references", Form::Rows, "a load cell of a reference press: `scan_id`, `before_configuration`, `arm`, position, `force_n`, `at`"),
    t("events", Form::Rows, "an event: `seq`, `scan_id`, `at`, `kind`, `data` (JSON)"),
];

/// Finds the files of tables.
pub struct Tables {
    store: Store,
    datasets: Catalog,
    folder: PathBuf,
    /// Folder of the columns of datasets without their frames; it outlives this process.
    columns: PathBuf,
    /// Datasets of runs that were current when they were looked up.
    current: Mutex<HashMap<RunUid, Current>>,
}

/// The dataset of a run, and the state of the run at which it was current.
#[derive(Clone)]
struct Current {
    ended_at: Option<Timestamp>,
    changes: u64,
    file: PathBuf,
}

impl Tables {
    /// Tables over the store and the datasets of a data folder. Files of an earlier process are removed.
    pub fn new(store: Store, datasets: Catalog, data: &Path) -> Self {
        let folder = data.join("query");
        pieces::clear(&folder);
        let columns = data.join("columns");
        if let Err(error) = sweep(&columns) {
            tracing::warn!(%error, folder = %columns.display(), "unfinished files stay");
        }
        Self { store, datasets, folder, columns, current: Mutex::default() }
    }

    /// Returns the tables with these names, and the files that are removed after the query.
    ///
    /// # Errors
    /// `QueryError::Refused` if there is no such table; `Dataset` if its rows cannot be read.
    pub async fn of_names(
        &self,
        names: &[String],
    ) -> Result<(Vec<Table>, Vec<Scratch>), QueryError> {
        let runs = self.store.all_runs().await?;
        let (mut tables, mut scratch) = (Vec::new(), Vec::new());
        let mut trials = None;
        for name in names {
            let Some(known) = TABLES.iter().find(|table| table.name == name) else {
                let files = vec![self.dataset(name).await?];
                tables.push(Table { name: name.clone(), form: Form::Rows, files });
                continue;
            };
            let files = if known.form == Form::Rows {
                let (store, folder) = (&self.store, &self.folder);
                let file = match known.name {
                    "runs" => records::runs(folder, &runs)?,
                    "events" => records::events(store, folder, &runs).await?,
                    _ => records::references(store, folder, &runs).await?,
                };
                let path = file.0.clone();
                scratch.push(file);
                vec![path]
            } else {
                // One list for all tables: during a query further trials may be stored.
                if trials.is_none() {
                    trials = Some(self.trials(&runs).await?);
                }
                let files = trials.clone().unwrap_or_default();
                match known.form {
                    Form::Trials | Form::Contacts => self.without_frames(files, &runs).await,
                    _ => files,
                }
            };
            tables.push(Table { name: name.clone(), form: known.form, files });
        }
        Ok((tables, scratch))
    }

    /// Whether a run is driven now.
    ///
    /// # Errors
    /// `QueryError::Dataset` if the store cannot be read.
    pub async fn has_driven_run(&self) -> Result<bool, QueryError> {
        Ok(!self.store.open_runs().await?.is_empty())
    }

    /// The files with all stored trials.
    async fn trials(&self, runs: &[RunRow]) -> DatasetResult<Vec<PathBuf>> {
        pieces::trim(&self.folder);
        let mut files = Vec::new();
        for run in runs {
            match self.current_of_run(run).await? {
                Some(file) => files.push(file),
                None => files.extend(pieces::of_run(&self.store, &self.folder, run).await?),
            }
        }
        if files.is_empty() {
            files.push(pieces::empty(&self.folder)?);
        }
        Ok(files)
    }

    /// Files with the same trials; those of datasets have no frames, and few row groups.
    async fn without_frames(&self, mut files: Vec<PathBuf>, runs: &[RunRow]) -> Vec<PathBuf> {
        let datasets = self.datasets.datasets();
        narrow::trim(&self.columns, &datasets);
        let free = self.store.free_bytes().await.unwrap_or_default();
        // A new file is synced to the disk, and a trial's commit would wait for it. The dataset's file has the same rows.
        let may_write = !runs.iter().any(RunRow::is_driven);
        for file in files.iter_mut().filter(|file| file.starts_with(&datasets)) {
            if !may_write {
                if let Some(narrow) = narrow::known(&self.columns, file) {
                    *file = narrow;
                }
                continue;
            }
            match narrow::of_dataset(&self.columns, file, free).await {
                Ok(narrow) => *file = narrow,
                // A full disk.
                Err(error) => tracing::warn!(%error, "the columns of a dataset were not written"),
            }
        }
        files
    }

    /// The file of a run's dataset, if it holds the trials and twins that are stored now. Counting them
    /// takes 10 ms for 33,000 trials, so that the count is kept.
    async fn current_of_run(&self, run: &RunRow) -> DatasetResult<Option<PathBuf>> {
        let (changes, ended_at) = (self.store.changes_of(run.scan_id), run.ended_at);
        let known = self.current.lock().get(&run.uid).cloned();
        if let Some(known) = known
            && known.changes == changes
            && known.ended_at == ended_at
            && run.state == StoredState::Ended
            && known.file.is_file()
        {
            return Ok(Some(known.file));
        }
        let found = self.datasets.current_of_run(run).await?;
        if let Some(file) = found.clone() {
            self.current.lock().insert(run.uid, Current { ended_at, changes, file });
        }
        Ok(found)
    }

    /// The file of a dataset.
    async fn dataset(&self, name: &str) -> Result<PathBuf, QueryError> {
        match self.datasets.find(name).await {
            Ok(row) => Ok(self.datasets.used(&row.id)),
            Err(DatasetError::NoDataset { .. }) => {
                let made = self.store.datasets().await?;
                let made = made.iter().map(|dataset| dataset.name.as_str());
                let names: BTreeSet<&str> =
                    TABLES.iter().map(|table| table.name).chain(made).collect();
                let names: Vec<&str> = names.into_iter().collect();
                let meant = did_you_mean(name, names.iter().copied());
                let names = names.join(", ");
                Err(QueryError::Refused(format!("no table {name}{meant}; there are {names}")))
            }
            Err(error @ (DatasetError::NotMade(_) | DatasetError::NotEnded(_))) => {
                Err(QueryError::Refused(error.to_string()))
            }
            Err(error) => Err(error.into()),
        }
    }
}
