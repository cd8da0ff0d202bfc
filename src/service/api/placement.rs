//! `GET /api/v1/placement`: which weights a person is asked to place, and the estimated contacts.
//! Uses: `placement`, `campaign` (its status), `store`. Never: a wait for an inference.

use axum::Json;
use axum::http::StatusCode;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::problem::{ApiError, ApiResult};
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::placement::{Confirmation, VerdictKind};
use crate::campaign::shown::run_action::ActionOnRun;
use crate::campaign::shown::status::{Done, Phase, RunStatus, Status, Wanted};
use crate::ids::{RunUid, TrialId};
use crate::placement::verdict::{AskedContact, Verdict};
use crate::placement::watch::{Awaited, Felt, Judged};
use crate::store::LastPlaced;

/// A placement of weights, and the contacts estimated from the skin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlacementOut {
    /// Uid of the run.
    pub run: RunUid,
    /// Number of the run, for people.
    pub scan_id: i64,
    /// Name of the experiment.
    pub experiment: String,
    /// Index of the placement in the plan.
    pub trial: u32,
    /// Number of placements in the plan.
    pub of: u64,
    /// Number of stored placements.
    pub done: u64,
    /// Number of times that a person repeated a placement of this run.
    pub repeated: u64,
    /// Weights to be placed.
    pub contacts: Vec<AskedContact>,
    /// What happens now.
    pub stage: Stage,
    /// Whether the skin is at rest; null until it was read.
    pub at_rest: Option<bool>,
    /// What the serving method feels; null before its first answer, or if no model serves.
    pub felt: Option<Felt>,
    /// Comparison of what is felt with what is asked.
    pub verdict: Verdict,
    /// The placement that was stored last; null before the first.
    pub last: Option<LastPlacement>,
    /// Wall time at which the untouched skin was last seen in this run; null until it is tared.
    pub untouched_at: Option<Timestamp>,
}

/// Stage of a placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The run waits for a person.
    Place,
    /// The skin settles after the confirmation.
    Settling,
    /// Frames are taken and stored.
    Measuring,
    /// The trial is stored.
    Stored,
}

/// A stored placement.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LastPlacement {
    /// Index of the placement in the plan.
    pub trial: u32,
    /// Id of the trial.
    pub trial_id: TrialId,
    /// Verdict with which it was confirmed; null if it is not known.
    pub verdict: Option<VerdictKind>,
}

impl From<LastPlaced> for LastPlacement {
    fn from(last: LastPlaced) -> Self {
        let verdict = last.verdict.and_then(|word| serde_json::from_value(word.into()).ok());
        Self { trial: last.trial, trial_id: last.trial_id, verdict }
    }
}

/// Returns the placement that a run requests, the estimated contacts, and the verdict.
///
/// While the run waits, the frames are read continuously. The weights must not be touched when the skin
/// is judged: `at_rest` states whether it has settled.
#[utoipa::path(get, operation_id = "placement", path = "/api/v1/placement", tag = "runs",
    responses((status = 200, body = PlacementOut),
        (status = 404, description = "no run asks for a placement")))]
pub async fn placement(app: App) -> ApiResult<Json<PlacementOut>> {
    let none = || ApiError::not_found("no run asks for a placement");
    let status = app.campaign.status();
    let awaited = Awaited::of(&status);
    let run = status.run.ok_or_else(none)?;
    let judged = app.placement.judged().filter(|judged| judged.run == run.uid);
    let (stage, judged) = match (awaited, judged) {
        (Some(awaited), judged) => {
            let same = judged.filter(|judged| judged.trial == awaited.trial);
            (Stage::Place, same.unwrap_or_else(|| Judged::unread(&awaited)))
        }
        (None, Some(judged)) => (stage(&run, judged.trial).ok_or_else(none)?, judged),
        (None, None) => return Err(none()),
    };
    let last = app.store.last_placed(run.uid).await?.map(LastPlacement::from);
    let untouched = app.campaign.untouched().filter(|skin| skin.run == Some(run.uid));
    Ok(Json(PlacementOut {
        run: run.uid,
        scan_id: run.scan_id,
        experiment: run.experiment,
        trial: judged.trial,
        of: run.trials_planned,
        done: run.trials_stored,
        repeated: app.store.accepted_on(run.uid, ActionOnRun::Repeat.as_str()).await?,
        contacts: judged.asked,
        stage,
        at_rest: judged.at_rest,
        felt: judged.felt,
        verdict: judged.verdict,
        last,
        untouched_at: untouched.map(|skin| skin.at),
    }))
}

/// Stage of a placement that was confirmed; `None` if the run does something else.
fn stage(run: &RunStatus, trial: u32) -> Option<Stage> {
    if run.trial.is_none_or(|key| key.configuration != trial) {
        return None;
    }
    match run.phase {
        Phase::Settle => Some(Stage::Settling),
        Phase::Measure | Phase::Commit => Some(Stage::Measuring),
        Phase::Next | Phase::Wait => Some(Stage::Stored),
        Phase::TouchOff | Phase::Travel | Phase::Tare | Phase::Press | Phase::Raise => None,
    }
}

/// The request that confirms what a run waits for. A placement is judged first.
///
/// # Errors
/// 409 if the run waits for nothing now and nothing is stated, or with the reasons if the skin contradicts the placement,
/// unless it is to be stored anyway.
pub async fn confirmation(
    app: &App,
    done: Done,
    mut confirmation: Confirmation,
) -> ApiResult<Request> {
    let status = app.campaign.status();
    let done = completed(done, &status)?;
    let Some(awaited) = Awaited::of(&status).filter(|awaited| done.trial == Some(awaited.trial))
    else {
        // A tip change, or a confirmation that the campaign refuses.
        return Ok(Request::Confirm { done, confirmation });
    };
    let verdict = app.placement.judge_now(awaited.run, awaited.trial).await;
    confirmation.verdict = unless_refused(awaited.trial, &verdict, confirmation.anyway)?;
    Ok(Request::Confirm { done, confirmation })
}

/// The verdict with which a placement is confirmed.
///
/// # Errors
/// 409 with the reasons if the skin contradicts the placement, unless it is to be stored `anyway`.
fn unless_refused(trial: u32, verdict: &Verdict, anyway: bool) -> ApiResult<VerdictKind> {
    if verdict.kind != VerdictKind::Wrong || anyway {
        return Ok(verdict.kind);
    }
    let reasons = verdict.words.join("; ");
    let words = format!(
        "trial {trial} is not confirmed: {reasons}; correct it, or confirm it with `anyway`"
    );
    Err(ApiError::new(StatusCode::CONFLICT, words))
}

/// What a person has done, with what the run waits for now in place of what is not stated: it must not confirm what the
/// run waits for when the campaign reads it, for example the next placement, which was not judged.
///
/// # Errors
/// A refusal if nothing is stated and the run waits for nothing now.
fn completed(done: Done, status: &Status) -> Result<Done, Refusal> {
    if done != Done::default() {
        // The campaign refuses what does not fit.
        return Ok(done);
    }
    match status.run.as_ref().and_then(|run| run.wanted.as_ref()) {
        Some(Wanted::Tips { tips }) => Ok(Done { tips: Some(*tips), ..done }),
        Some(Wanted::Placement { trial, .. }) => Ok(Done { trial: Some(*trial), ..done }),
        None => {
            let words = ActionOnRun::Confirm.refused(status);
            Err(Refusal::State(words.unwrap_or_else(|| "the run waits for nothing".into())))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::needs::tests::{status, waiting};
    use super::*;
    use crate::campaign::bench::rig_state::RigState;
    use crate::state::{PausedWhy, StoredState};

    #[test]
    fn a_placement_that_was_refused_is_confirmed_once_the_skin_agrees_or_anyway() {
        let wrong = Verdict::without(VerdictKind::Wrong, "weight 1 is not felt");
        let refused = unless_refused(3, &wrong, false).unwrap_err();
        assert_eq!(refused.status(), StatusCode::CONFLICT);
        let words = refused.detail();
        assert!(words.starts_with("trial 3 is not confirmed: weight 1 is not felt; "), "{words}");
        // The second confirmation.
        assert_eq!(unless_refused(3, &wrong, true).unwrap(), VerdictKind::Wrong, "doubted");
        for kind in [VerdictKind::Right, VerdictKind::Unsure, VerdictKind::Unknown] {
            let verdict = Verdict::without(kind, "");
            assert_eq!(unless_refused(3, &verdict, false).unwrap(), kind);
        }
    }

    #[test]
    fn a_confirmation_is_of_what_the_run_waits_for_when_it_arrives() {
        let (mut now, unstated) = (status(RigState::Homed), Done::default());
        assert!(completed(unstated, &now).is_err(), "no run is active");
        now.run = Some(waiting(PausedWhy::ManualTrial));
        assert_eq!(completed(unstated, &now), Ok(Done { trial: Some(3), tips: None }));
        let other = Done { trial: Some(2), tips: None };
        assert_eq!(completed(other, &now), Ok(other), "the campaign refuses it");
        let wanted = Some(Wanted::Tips { tips: 4 });
        now.run = Some(RunStatus { wanted, ..waiting(PausedWhy::TipChange) });
        assert_eq!(completed(unstated, &now), Ok(Done { trial: None, tips: Some(4) }));
        // It is measured now: what the run waits for next is not confirmed.
        let run = now.run.as_mut().unwrap();
        (run.state, run.paused_why, run.wanted) = (StoredState::Running, None, None);
        assert!(completed(unstated, &now).is_err());
    }
}
