//! Twins that other machines make: what they are computed from, and their check before they are stored.
//! Uses: `make`, `simulate::twins`, `store`. Never: a stored twin that changes; a frame of another model, of other
//! contacts or of trials of another run.

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use sim_core::batch::Kernel;
use sim_core::forward::Workspace;
use utoipa::ToSchema;

use super::make::{Recipe, outcome};
use super::{PoolError, TwinPool, WORKER_TRIALS};
use crate::dataset::background::background;
use crate::digest::sha256_hex;
use crate::ids::{RunUid, TrialId};
use crate::simulate::twins::file::{TwinRow, TwinsFile};
use crate::simulate::twins::{TwinInput, twin_frame};
use crate::store::{TrialQuery, TrialRow, Twin, TwinOutcome};

/// Number of trials whose frames are read at a time for the comparison.
const COMPARED_TRIALS: usize = 256;

/// What the twins of consecutive trials of a run are computed from.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct TwinInputs {
    /// uid of the run.
    pub run: RunUid,
    /// Simulation id of the model that the service uses for the run.
    pub simulation: String,
    /// Vector instructions of the service's processor, on which the last digits of a frame depend.
    pub kernel: String,
    /// Text of the sensor file.
    pub sensor: String,
    /// Text of the calibration file; null for the nominal model.
    pub calibration: Option<String>,
    /// Number of trials.
    pub trials: u64,
    /// A line for each trial: its id, then after a space `x,y,force` of each contact (mm, N), or `?` if the position or
    /// the force of one is unknown.
    pub contacts: String,
    /// Id of the last trial, if others follow; null otherwise.
    pub next: Option<TrialId>,
}

/// Result of storing twins that were made elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoredTwins {
    /// uid of the run.
    pub run: RunUid,
    /// Number of twins that were stored, trials that the model cannot simulate included.
    pub stored: u64,
    /// Number of twins that were stored before, and are the same.
    pub present: u64,
}

impl TwinPool {
    /// Returns what the twins of at most `limit` trials of a run are computed from, in the order of storing, with ids
    /// above `after`.
    ///
    /// # Errors
    /// `PoolError` if the run has no model, or the store fails.
    pub async fn inputs(
        &self,
        run: RunUid,
        after: TrialId,
        limit: u32,
    ) -> Result<TwinInputs, PoolError> {
        let row = self.row(run).await?;
        let recipe = self.unstored_recipe(&row).await?;
        let calibration = self.inner.calibration.as_ref();
        let calibration = calibration.filter(|_| recipe.model.sensor().calibration().is_some());
        let calibration =
            calibration.map(|(_, own)| own.to_toml()).transpose().map_err(|error| {
                PoolError::File { run: row.scan_id, file: "calibration", why: error.to_string() }
            })?;
        // One more shows whether others follow.
        let query = TrialQuery {
            run: Some(run),
            after: Some(after),
            limit: limit + 1,
            ..TrialQuery::default()
        };
        let mut trials = self.inner.store.trials(&query).await?;
        let has_more = trials.len() > limit as usize;
        trials.truncate(limit as usize);
        Ok(TwinInputs {
            run,
            simulation: recipe.model.model_hash().to_owned(),
            kernel: Kernel::detect().name().to_owned(),
            sensor: row.sensor,
            calibration,
            trials: trials.len() as u64,
            contacts: TwinInput::lines(trials.iter().map(|trial| recipe.input(trial))),
            next: trials.last().filter(|_| has_more).map(|trial| trial.trial_id),
        })
    }

    /// Stores the twins of a file (`simulate::twins::file`), each once. All are checked before the first one is stored.
    ///
    /// # Errors
    /// `PoolError::Made` if the file is not of this run, its model and its contacts; `OtherTwin` if a stored twin
    /// differs; another one if the run has no model, or the store fails.
    pub async fn store_made(&self, run: RunUid, file: Bytes) -> Result<StoredTwins, PoolError> {
        let recipe = self.stored_recipe(run).await?;
        let channels = recipe.model.sensor().channels();
        let read = background(move || TwinsFile::read(file, channels)).await;
        let file = read.map_err(|_| PoolError::Worker)?.map_err(PoolError::Made)?;
        self.check_made(run, &recipe, &file).await?;
        let mut missing = Vec::new();
        for rows in file.rows.chunks(COMPARED_TRIALS) {
            missing.extend(self.missing(&recipe, rows).await?);
        }
        for twins in missing.chunks(WORKER_TRIALS) {
            self.inner.store.insert_twins(recipe.id, twins.to_vec()).await?;
        }
        let stored = missing.len() as u64;
        Ok(StoredTwins { run, stored, present: file.rows.len() as u64 - stored })
    }

    /// Checks that a file was made of the model and the contacts that the service would use.
    async fn check_made(
        &self,
        run: RunUid,
        recipe: &Recipe,
        file: &TwinsFile,
    ) -> Result<(), PoolError> {
        let (head, model) = (&file.head, recipe.model.model_hash());
        if head.run != run {
            return Err(PoolError::Made(format!("is of run {}, not of {run}", head.run)));
        }
        if head.model != model {
            let words = format!(
                "was made with the model {}, the service uses {model} for this run: order again",
                head.model
            );
            return Err(PoolError::Made(words));
        }
        let ids: Vec<TrialId> = file.rows.iter().map(|row| row.trial).collect();
        let trials = self.inner.store.trials_of(&ids).await?;
        // Both in ascending order.
        let is_there = |(at, id): &(usize, &TrialId)| {
            trials.get(*at).is_some_and(|trial| trial.trial_id == **id && trial.run == run)
        };
        if let Some((_, id)) = ids.iter().enumerate().find(|entry| !is_there(entry)) {
            let words = format!("has trial {}, which is no trial of this run: order again", id.0);
            return Err(PoolError::Made(words));
        }
        let contacts = TwinInput::lines(trials.iter().map(|trial| recipe.input(trial)));
        if sha256_hex(contacts) != head.contacts_sha256 {
            let words = "was made of other contacts than the stored trials have: order again";
            return Err(PoolError::Made(words.into()));
        }
        Ok(())
    }

    /// The twins of these rows that are not stored; those that are stored must be the same.
    async fn missing(&self, recipe: &Recipe, rows: &[TwinRow]) -> Result<Vec<Twin>, PoolError> {
        let store = &self.inner.store;
        let ids: Vec<TrialId> = rows.iter().map(|row| row.trial).collect();
        let trials = store.trials_with_voltages(&ids).await?;
        let stored = store.twins_of(recipe.id, &ids).await?;
        // All in ascending order of the trials.
        let (mut trials, mut stored) = (trials.iter().peekable(), stored.iter().peekable());
        let (mut missing, mut work) = (Vec::new(), Workspace::default());
        for row in rows {
            // It was discarded meanwhile.
            let Some(trial) = trials.next_if(|trial| trial.trial_id == row.trial) else { continue };
            let made = made(recipe, trial, row, &mut work)?;
            match stored.next_if(|twin| twin.trial == row.trial) {
                None => missing.push(Twin { trial: row.trial, outcome: made }),
                Some(there) if is_same(&there.outcome, &made) => {}
                Some(_) => return Err(PoolError::OtherTwin(row.trial.0)),
            }
        }
        Ok(missing)
    }
}

/// The twin of a row, as the service would have made it. Why the model cannot simulate a trial is determined here.
fn made(
    recipe: &Recipe,
    trial: &TrialRow,
    row: &TwinRow,
    work: &mut Workspace,
) -> Result<TwinOutcome, PoolError> {
    let simulated = match &row.frame_v {
        Some(frame_v) => Ok(frame_v.clone()),
        None => {
            let contacts = recipe.input(trial).contacts;
            let frame_v = twin_frame(&recipe.model, contacts.as_deref(), work);
            if frame_v.is_ok() {
                let words = format!("has no frame of trial {}, the model has one", row.trial.0);
                return Err(PoolError::Made(words));
            }
            frame_v
        }
    };
    Ok(outcome(simulated, trial.voltages_v.as_deref()))
}

/// Whether two twins have the same bytes.
fn is_same(there: &TwinOutcome, made: &TwinOutcome) -> bool {
    match (there, made) {
        (
            TwinOutcome::Frame { voltages_v: there, .. },
            TwinOutcome::Frame { voltages_v: made, .. },
        ) => there.iter().map(|v| v.to_bits()).eq(made.iter().map(|v| v.to_bits())),
        (TwinOutcome::Failure(_), TwinOutcome::Failure(_)) => true,
        (TwinOutcome::Frame { .. }, TwinOutcome::Failure(_))
        | (TwinOutcome::Failure(_), TwinOutcome::Frame { .. }) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(voltages_v: &[f32]) -> TwinOutcome {
        TwinOutcome::Frame { voltages_v: voltages_v.to_vec(), rmse_v: 0.1, fvu: None }
    }

    #[test]
    fn twins_are_compared_to_the_last_bit() {
        let failure = |why: &str| TwinOutcome::Failure(why.into());
        assert!(is_same(&frame(&[0.1, -0.0]), &frame(&[0.1, -0.0])));
        assert!(!is_same(&frame(&[0.1, -0.0]), &frame(&[0.1, 0.0])));
        assert!(!is_same(&frame(&[0.1]), &frame(&[0.1, 0.1])));
        assert!(is_same(&failure("off the skin"), &failure("another version's words")));
        assert!(!is_same(&failure("off the skin"), &frame(&[0.1])));
        assert!(!is_same(&frame(&[0.1]), &failure("off the skin")));
    }
}
