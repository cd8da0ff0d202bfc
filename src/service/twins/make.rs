//! The twins of a page of trials, simulated from their measured contacts and forces.
//! Uses: `simulate::{twins, compare}`, `dataset::pressed`. Never: the store, which trials are pending.

use std::sync::Arc;

use sim_core::forward::{ForwardModel, Workspace};
use tokio::task::JoinError;
use tracing::Span;

use crate::campaign::spans::trial_span;
use crate::dataset::pressed::contacts;
use crate::ids::TrialKey;
use crate::simulate::compare::Compared;
use crate::simulate::twins::{TwinFailure, TwinInput, twin_frame};
use crate::store::{RunKind, TrialRow, Twin, TwinModelId, TwinOutcome};

/// Model and settings for the twins of a run.
#[derive(Clone)]
pub(super) struct Recipe {
    /// Model of the skin.
    pub model: Arc<ForwardModel>,
    /// Id of the model in the store.
    pub id: TwinModelId,
    /// Origin of the trials.
    pub kind: RunKind,
    /// Force up to which the output of a cell counts as noise, N.
    pub force_noise_n: f64,
}

impl Recipe {
    /// What the twin of a trial is computed from.
    pub(super) fn input(&self, trial: &TrialRow) -> TwinInput {
        let contacts = contacts(trial, self.kind, self.force_noise_n);
        TwinInput { trial: trial.trial_id, contacts }
    }
}

/// The twins of a page, in its order; the workers share the work.
///
/// # Errors
/// `JoinError` if a worker panicked.
pub(super) async fn twins_of(
    recipe: &Recipe,
    trials: &Arc<Vec<TrialRow>>,
    workers: usize,
) -> Result<Vec<Twin>, JoinError> {
    let share = trials.len().div_ceil(workers).max(1);
    let tasks: Vec<_> = (0..trials.len())
        .step_by(share)
        .map(|first| {
            let (recipe, trials) = (recipe.clone(), trials.clone());
            let span = Span::current();
            tokio::task::spawn_blocking(move || {
                let _inside = span.entered();
                let mut work = Workspace::default();
                let end = (first + share).min(trials.len());
                trials[first..end].iter().map(|t| twin(&recipe, t, &mut work)).collect::<Vec<_>>()
            })
        })
        .collect();
    let mut twins = Vec::with_capacity(trials.len());
    for task in tasks {
        twins.extend(task.await?);
    }
    Ok(twins)
}

/// Simulates the twin of a trial from its measured contacts and forces.
fn twin(recipe: &Recipe, trial: &TrialRow, work: &mut Workspace) -> Twin {
    let outcome = simulated(recipe, trial, work);
    if let TwinOutcome::Failure(why) = &outcome {
        let (configuration, depth_index) = (trial.configuration, trial.depth_index);
        trial_span(TrialKey { configuration, depth_index })
            .in_scope(|| tracing::debug!(why, "a trial has no twin"));
    }
    Twin { trial: trial.trial_id, outcome }
}

fn simulated(recipe: &Recipe, trial: &TrialRow, work: &mut Workspace) -> TwinOutcome {
    let contacts = recipe.input(trial).contacts;
    let frame_v = twin_frame(&recipe.model, contacts.as_deref(), work);
    outcome(frame_v, trial.voltages_v.as_deref())
}

/// The twin with this frame, compared with the measured one.
pub(super) fn outcome(
    simulated: Result<Vec<f32>, TwinFailure>,
    measured_v: Option<&[f32]>,
) -> TwinOutcome {
    match (simulated, measured_v) {
        (Err(failure), _) => TwinOutcome::Failure(failure.to_string()),
        (Ok(_), None) => TwinOutcome::Failure("the trial has no voltages".into()),
        (Ok(frame_v), Some(measured_v)) if frame_v.len() != measured_v.len() => {
            let [trial, model] = [measured_v.len(), frame_v.len()];
            TwinOutcome::Failure(format!("the trial has {trial} voltages, the model {model}"))
        }
        (Ok(voltages_v), Some(measured_v)) => {
            let apart = Compared { measured_v, simulated_v: &voltages_v }.difference();
            TwinOutcome::Frame { rmse_v: apart.rmse_v, fvu: apart.fvu, voltages_v }
        }
    }
}
