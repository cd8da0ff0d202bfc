//! The file of a run's dataset, begun while the run is active: its trials that have their twins.
//! Uses: `store`, `dataset::{encoder, background}`. Never: a row that differs from what is stored when the
//! dataset is made, a file that outlives the process.
//!
//! A trial and the model of its newest twin determine a row, as ids are not given twice and a stored twin
//! never changes. `build` therefore compares the written pairs with the stored ones. It appends the
//! remaining rows if they agree, and otherwise writes all rows.

use std::path::Path;

use arrow_schema::SchemaRef;

use super::background::background;
use super::batch::Row;
use super::definition::Definition;
use super::encoder::Encoder;
use super::error::DatasetResult;
use super::schema::{self, BATCH_ROWS};
use super::split::Part;
use crate::ids::{RunUid, TrialId};
use crate::store::{Store, TrialRow};

/// The begun file of a run's dataset; removed if it is dropped.
pub struct Begun {
    scan_id: i64,
    encoder: Encoder,
    /// The written trials in their order, each with the number of the model of its twin.
    written: Vec<(TrialId, i64)>,
}

impl Begun {
    fn new(folder: &Path, scan_id: i64, trials: &[TrialRow]) -> DatasetResult<Self> {
        let definition = Definition::of_run(scan_id);
        let frame = trials.iter().find_map(|trial| trial.voltages_v.as_ref().map(Vec::len));
        let channels = frame.map_or(schema::PAPER_CHANNELS, |channels| channels as i32);
        let columns = schema::of_dataset(&definition, channels);
        let encoder = Encoder::new(folder, &definition, &columns)?;
        Ok(Self { scan_id, encoder, written: Vec::new() })
    }

    /// Scan id of the run.
    pub fn scan_id(&self) -> i64 {
        self.scan_id
    }

    /// Number of written rows.
    pub fn rows(&self) -> u64 {
        self.written.len() as u64
    }

    /// Whether this is the file of the dataset of this definition.
    pub fn is_of(&self, definition: &Definition) -> bool {
        *definition == Definition::of_run(self.scan_id)
    }

    /// Writes the next 1000 trials of a run if they have their twins, to its begun file or to a new one,
    /// which replaces that of another run. A begun file whose trials or twins have changed is removed.
    ///
    /// # Errors
    /// `DatasetError::Store` if the trials cannot be read: the file stays as it is; another variant if they
    /// cannot be written: the file is removed.
    pub async fn advance(
        begun: &mut Option<Self>,
        store: &Store,
        folder: &Path,
        run: RunUid,
        scan_id: i64,
    ) -> DatasetResult<()> {
        let last = begun
            .as_ref()
            .filter(|begun| begun.scan_id == scan_id)
            .and_then(|begun| begun.written.last())
            .map_or(TrialId(0), |(trial, _)| *trial);
        let next = store.newest_twins(run, last, BATCH_ROWS as u32).await?;
        if next.len() < BATCH_ROWS {
            return Ok(());
        }
        let stored = store.newest_twins(run, TrialId(0), u32::MAX).await?;
        let is_outdated =
            |begun: &Self| begun.scan_id == scan_id && !stored.starts_with(&begun.written);
        if begun.as_ref().is_some_and(is_outdated) {
            *begun = None;
            return Ok(());
        }
        // A trial whose twin is of an older model, or absent, gets one: its row would change.
        let newest = stored.iter().map(|(_, model)| *model).max();
        if next.iter().any(|(_, model)| Some(*model) != newest) {
            return Ok(());
        }
        let ids: Vec<TrialId> = next.iter().map(|(trial, _)| *trial).collect();
        let trials = store.trials_with_voltages(&ids).await?;
        if trials.len() != ids.len() {
            return Ok(());
        }
        let mut own = match begun.take_if(|begun| begun.scan_id == scan_id) {
            Some(own) => own,
            None => Self::new(folder, scan_id, &trials)?,
        };
        // The definition has no deadband and no split: the labels are the stored ones.
        let rows: Vec<Row> = trials.into_iter().map(|trial| Row { trial, part: None }).collect();
        let writing = move || -> DatasetResult<Self> {
            own.encoder.push_trials(&rows)?;
            own.written.extend(next);
            Ok(own)
        };
        *begun = Some(background(writing).await??);
        Ok(())
    }

    /// Returns the begun file if a dataset of the trials `kept` with these columns starts with its rows.
    /// `stored`: the trials of the run and the numbers of the models of their twins.
    pub(super) fn start_of(
        self,
        columns: &SchemaRef,
        kept: &[(TrialId, Option<Part>)],
        stored: &[(TrialId, i64)],
    ) -> Option<Encoder> {
        let rows = self.written.iter().map(|(trial, _)| (*trial, None::<Part>));
        let is_start = self.encoder.columns() == columns
            && stored.starts_with(&self.written)
            && kept.iter().copied().take(self.written.len()).eq(rows);
        is_start.then_some(self.encoder)
    }
}
