//! Runs: queries, arming, and all actions on them.
//! Uses: `conductor`, `campaign::shown::{command, run_action}`, `store`. Never: motion.

use axum::Json;
use axum::extract::Query;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::IntoResponse;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::audit::{Act, cut};
use super::limits::WHO_MAX_CHARS;
use super::pages::{Page, PageParams, PageRequest};
use super::params::RunParams;
use super::placement::confirmation;
use super::problem::{ApiError, ApiResult, Body, Path};
use super::query::run_conditions;
use crate::campaign::STOPS;
use crate::campaign::shown::command::Request;
use crate::campaign::shown::placement::Confirmation;
use crate::campaign::shown::run_action::ActionOnRun;
use crate::campaign::shown::status::Done;
use crate::conductor::{Armed, Started};
use crate::ids::RunUid;
use crate::journal::Journal;
use crate::store::{Role, RunRow, SettingCount, SkipRow};

/// Time after the end of a run within which a pause or an abort of it was meant for what moved, wall.
const JUST_ENDED: SignedDuration = SignedDuration::from_secs(10);

/// Results of a run.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct Summary {
    /// Row of the run: experiment, plan, state, label, times.
    pub run: RunRow,
    /// Number of stored trials.
    pub trials_stored: u64,
    /// Number of planned trials of skipped configurations that are not stored.
    pub trials_skipped: u64,
    /// Number of failed attempts.
    pub retries: u64,
    /// Number of stored trials with 0, 1, .. 6 contacts.
    pub contact_counts: [u64; 7],
    /// Number of stored trials of each setting.
    pub settings: Vec<SettingCount>,
    /// Skipped configurations with reasons.
    pub skips: Vec<SkipRow>,
    /// Wall time from start to end, s; absent before the end.
    pub duration_s: Option<f64>,
}

/// Request for an action on a run.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct ActionRequest {
    /// Action that the run must perform.
    pub action: ActionOnRun,
    /// For `pause`: `checkpoint` (after the trial, the default) or `now`.
    pub when: Option<When>,
    /// For `start`: the code that arming returned.
    pub code: Option<String>,
    /// For `confirm`: index of the placement that was made. A run that waits for something else refuses
    /// it, so that a confirmation sent twice confirms one placement. For `repeat`: index of the
    /// placement to repeat; absent: the one that was measured last since the start of the service.
    pub trial: Option<u32>,
    /// For `confirm`: number of tips that were mounted, as `trial`.
    pub tips: Option<u8>,
    /// For `confirm`: store the placement even if the skin contradicts it; its trial gets the flag
    /// `doubted`.
    #[serde(default)]
    pub anyway: bool,
    /// Name of the person, for the log of actions.
    pub who: Option<String>,
    /// Reason, for the log of actions.
    pub why: Option<String>,
}

/// True if the action needs the role `operator`, respects the operator lock and is refused if it comes late.
/// Stopping never is.
fn needs_lock(action: ActionOnRun) -> bool {
    match action {
        ActionOnRun::Start | ActionOnRun::Resume | ActionOnRun::Confirm | ActionOnRun::Repeat => {
            true
        }
        ActionOnRun::Pause | ActionOnRun::Stop | ActionOnRun::Abort => false,
    }
}

/// Time at which a pause takes effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// After the current trial.
    Checkpoint,
    /// Immediately; the run resumes at the current trial.
    Now,
}

/// Name and reason for the log of actions.
#[derive(Debug, Clone, Default, Deserialize, ToSchema)]
pub struct Attribution {
    /// Name of the person.
    pub who: Option<String>,
    /// Reason, in the words of the person.
    pub why: Option<String>,
}

/// Response to an accepted action.
#[derive(Debug, Serialize, ToSchema)]
pub struct ActionAccepted {
    /// uid of the run.
    pub run: RunUid,
    /// For `start`: whether the run has started or waits for another run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub started: Option<Started>,
}

/// Finds a run by its uid or scan_id.
///
/// # Errors
/// 404 if there is no such run; errors of the store.
pub async fn find(app: &App, run: &str) -> ApiResult<RunRow> {
    let found = if let Ok(scan_id) = run.parse::<i64>() {
        app.store.run_by_scan_id(scan_id).await?
    } else if let Ok(uid) = run.parse::<RunUid>() {
        app.store.run(uid).await?
    } else {
        let words = format!("no run {}: must be a uid or a scan_id", cut(run, WHO_MAX_CHARS));
        return Err(ApiError::not_found(words));
    };
    let row = found.ok_or_else(|| ApiError::not_found(format!("no run {run}")))?;
    let request = tracing::Span::current();
    request.record("run", tracing::field::display(row.uid)).record("scan_id", row.scan_id);
    Ok(row)
}

/// Returns a page of runs, newest first.
#[utoipa::path(get, operation_id = "list_runs",
    path = "/api/v1/runs", tag = "runs", params(RunParams, PageParams),
    responses((status = 200, body = Page<RunRow>)))]
pub async fn list(
    app: App,
    Query(pairs): Query<Vec<(String, String)>>,
    asked: PageRequest,
) -> ApiResult<Page<RunRow>> {
    let conditions = run_conditions(&pairs).map_err(ApiError::bad_query)?;
    let found = app.store.runs(&conditions, asked.limit, asked.after()?).await?;
    Ok(asked.page(found.runs, found.next))
}

/// Returns a run.
#[utoipa::path(get, operation_id = "run", path = "/api/v1/runs/{run}", tag = "runs",
    responses((status = 200, body = RunRow)))]
pub async fn one(app: App, Path(run): Path<String>) -> ApiResult<Json<RunRow>> {
    Ok(Json(find(&app, &run).await?))
}

/// Returns the results of a run.
#[utoipa::path(get, operation_id = "run_summary", path = "/api/v1/runs/{run}/summary", tag = "runs",
    responses((status = 200, body = Summary)))]
pub async fn summary(app: App, Path(run): Path<String>) -> ApiResult<Json<Summary>> {
    let run = find(&app, &run).await?;
    let uid = run.uid;
    let progress = app.store.progress(uid).await.map_err(ApiError::internal)?;
    let trials_stored = progress.stored.len() as u64;
    let ended = run.exit_status.is_some();
    let complete = run.trials_planned.saturating_sub(trials_stored);
    let trials_skipped = match (ended, progress.skipped.len() as u64) {
        (_, 0) => 0,
        (_, skipped) => {
            let preflight = app.conductor.preflight_of(&run).await?;
            let depths = preflight.trials / preflight.configurations.max(1);
            let kept = progress
                .stored
                .iter()
                .filter(|k| progress.skipped.contains(&k.configuration))
                .count() as u64;
            (skipped * depths).saturating_sub(kept).min(complete)
        }
    };
    let duration_s = match (run.started_at, run.ended_at) {
        (Some(from), Some(to)) => Some(to.duration_since(from).as_secs_f64()),
        _ => None,
    };
    Ok(Json(Summary {
        trials_stored,
        trials_skipped,
        retries: progress.retries,
        contact_counts: app.store.contact_counts(uid).await?,
        settings: app.store.stored_per_setting(uid).await?,
        skips: app.store.skips(uid).await?,
        duration_s,
        run,
    }))
}

/// Returns the plan that a run was queued with: every step with every position, depth and wait.
#[utoipa::path(get, operation_id = "run_plan", path = "/api/v1/runs/{run}/plan", tag = "runs",
    responses((status = 200, body = Object,
                  description = "the plan; its sha256 is `plan_sha256` of the run"),
        (status = 404, description = "no run has this uid or scan_id, or no plan was kept for it")))]
pub async fn plan(app: App, Path(run): Path<String>) -> ApiResult<impl IntoResponse> {
    let run = find(&app, &run).await?;
    let none = || ApiError::not_found(format!("run {} has no plan", run.scan_id));
    let plan = app.store.plan_of(run.uid).await?.ok_or_else(none)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], plan))
}

/// Arms a run: checks it and returns the preflight and a code.
///
/// This is the first of two steps; the action `start` with the code is the second.
#[utoipa::path(post, operation_id = "arm_run", path = "/api/v1/runs/{run}/arm", tag = "runs",
    request_body = Attribution, responses((status = 200, body = Armed),
        (status = 409,
            description = "the state of rig or run does not allow arming, or another person holds the lock"),
        (status = 422, description = "the preflight has problems")))]
pub async fn arm(
    app: App,
    act: Act,
    Path(run): Path<String>,
    Body(stated): Body<Attribution>,
) -> ApiResult<Json<Armed>> {
    act.stated(stated.who.as_deref(), stated.why.as_deref());
    let run = find(&app, &run).await?;
    act.on(run.uid);
    Ok(Json(app.conductor.arm(&run).await?))
}

/// Requests an action on a run; the response confirms the request, the status shows its effect.
#[utoipa::path(post, operation_id = "run_action", path = "/api/v1/runs/{run}/actions", tag = "runs",
    request_body = ActionRequest, description = STOPS,
    responses((status = 202, body = ActionAccepted),
        (status = 409,
            description = "the state of the run does not allow the action, the skin contradicts a placement, or another person holds the lock")))]
pub async fn act(
    app: App,
    act: Act,
    headers: HeaderMap,
    Path(run): Path<String>,
    Body(asked): Body<ActionRequest>,
) -> ApiResult<(StatusCode, Json<ActionAccepted>)> {
    act.named(asked.action.as_str());
    act.stated(asked.who.as_deref(), asked.why.as_deref());
    let run = find(&app, &run).await?;
    act.on(run.uid);
    let started = request_action(&app, &act, &headers, &run, asked).await?;
    Ok((StatusCode::ACCEPTED, Json(ActionAccepted { run: run.uid, started })))
}

async fn request_action(
    app: &App,
    act: &Act,
    headers: &HeaderMap,
    run: &RunRow,
    asked: ActionRequest,
) -> ApiResult<Option<Started>> {
    if needs_lock(asked.action) {
        act.caller().require(Role::Operator)?;
        app.in_time(headers)?;
        app.unlocked(act.caller()).await?;
    }
    if asked.action == ActionOnRun::Start {
        let code = asked.code.as_deref().unwrap_or_default();
        let by = act.caller().holder(asked.who.as_deref());
        return Ok(Some(app.conductor.start(run, code, by).await?));
    }
    let active = app.campaign.status().run.is_some_and(|r| r.uid == run.uid);
    if !active {
        return on_undriven(app, run, asked.action).await.map(|()| None);
    }
    let request = match asked.action {
        ActionOnRun::Pause if asked.when == Some(When::Now) => Request::PauseNow,
        ActionOnRun::Pause => Request::PauseAtCheckpoint,
        ActionOnRun::Resume | ActionOnRun::Start => Request::Resume,
        ActionOnRun::Stop => Request::Stop,
        ActionOnRun::Abort => Request::Abort,
        ActionOnRun::Confirm => {
            let done = Done { trial: asked.trial, tips: asked.tips };
            let by = Confirmation { anyway: asked.anyway, ..Confirmation::of(act.name()) };
            confirmation(app, done, by).await?
        }
        ActionOnRun::Repeat => {
            Request::Repeat { trial: asked.trial, why: asked.why.unwrap_or_default() }
        }
    };
    match asked.action {
        ActionOnRun::Pause | ActionOnRun::Stop | ActionOnRun::Abort => {
            app.conductor.halt(request).await?;
        }
        ActionOnRun::Start | ActionOnRun::Resume | ActionOnRun::Confirm | ActionOnRun::Repeat => {
            app.campaign.ask(request).await?;
        }
    }
    Ok(None)
}

/// An action on a run that is not driven: an abort ends an open one, takes back the start of one that waits, and aborts
/// one that is about to begin. A pause or a stop of one that is about to be driven again after a restart is refused, and
/// the run is not driven. A pause or an abort of one that has just ended is refused, and no waiting run begins.
async fn on_undriven(app: &App, run: &RunRow, action: ActionOnRun) -> ApiResult<()> {
    // It may have ended since it was read.
    let run = &app.store.run(run.uid).await?.unwrap_or_else(|| run.clone());
    let is_late = comes_late(action, run.ended_at, Timestamp::now());
    // It may be about to begin, unless it has just ended.
    let may_abort = run.is_open() || run.waiting_since.is_some() || !is_late;
    if action == ActionOnRun::Abort && may_abort && app.conductor.abort_undriven(run).await? {
        return Ok(());
    }
    let halt = match action {
        // Of one that has begun meanwhile: nothing of it was measured yet.
        ActionOnRun::Pause => Some(Request::PauseNow),
        ActionOnRun::Stop => Some(Request::Stop),
        ActionOnRun::Start
        | ActionOnRun::Resume
        | ActionOnRun::Confirm
        | ActionOnRun::Repeat
        | ActionOnRun::Abort => None,
    };
    let held = halt.filter(|_| run.is_driven());
    let is_held = held.is_some();
    if let Some(request) = held
        && app.conductor.hold_undriven(run.uid, request).await?
    {
        return Ok(());
    }
    if is_late {
        app.conductor.halt(Request::CameLate).await?;
    }
    let (action, scan_id, state) = (action.as_str(), run.scan_id, run.state);
    let mut words = format!("action {action}: run {scan_id} is {state}, not active");
    if is_held {
        words += "; it is not driven again by itself any more: start it again, or abort it";
    } else if run.is_driven() {
        words += "; it is about to be driven again after a restart: abort ends it";
    } else if let Some(other) = app.campaign.status().run {
        words += &format!("; run {} is active", other.scan_id);
    }
    Err(ApiError::new(StatusCode::CONFLICT, words))
}

/// Whether an action was meant for a run that has just ended: who requested it may be at the rig.
fn comes_late(action: ActionOnRun, ended_at: Option<Timestamp>, now: Timestamp) -> bool {
    let halts = matches!(action, ActionOnRun::Pause | ActionOnRun::Abort);
    halts && ended_at.is_some_and(|at| now.duration_since(at) <= JUST_ENDED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_or_an_abort_of_a_run_that_has_just_ended_comes_late() {
        use ActionOnRun::{Abort, Pause, Resume, Stop};
        let now = Timestamp::constant(1_795_000_000, 0);
        let late = |action, ended_s: i64| {
            comes_late(action, Some(now - SignedDuration::from_secs(ended_s)), now)
        };
        assert!(late(Abort, 0) && late(Pause, 10));
        assert!(!late(Abort, 11) && !late(Stop, 0) && !late(Resume, 0));
        assert!(!comes_late(Abort, None, now), "it has not ended");
    }
}
