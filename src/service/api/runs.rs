//! Runs: reading, arming, and every action on them.
//! Uses: `conductor`, `campaign::shown::command`, `store`. Never: motion.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, Params, ProblemBody};
use crate::campaign::STOPS;
use crate::campaign::shown::command::Request;
use crate::conductor::{Armed, Started};
use crate::ids::RunUid;
use crate::journal::Journal;
use crate::schedule::preflight::Preflight;
use crate::store::{Role, RunPage, RunRow, SettingCount, SkipRow};

/// Rows of a page, unless asked otherwise, and at most.
const PAGE: u32 = 50;
const LONGEST_PAGE: u32 = 500;

/// Which page.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct PageParams {
    /// Up to so many, at most 500.
    pub limit: Option<u32>,
    /// `next` of the page before.
    pub cursor: Option<i64>,
}

/// What came of a run.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub struct Summary {
    /// The run.
    pub run: RunRow,
    /// Trials stored.
    pub trials_stored: u64,
    /// Planned trials of configurations that were given up and are not stored.
    pub trials_skipped: u64,
    /// Failed attempts.
    pub retries: u64,
    /// Stored trials with 0 to 6 contacts.
    pub contact_counts: [u64; 7],
    /// Stored trials of each setting.
    pub settings: Vec<SettingCount>,
    /// Configurations given up, and why.
    pub skips: Vec<SkipRow>,
    /// From its start to its end, wall s; absent before its end.
    pub duration_s: Option<f64>,
}

/// An action on a run.
#[derive(Debug, Clone, Deserialize, ToSchema)]
pub struct Act {
    /// What to do.
    pub action: Action,
    /// For `pause`: `checkpoint` (after the trial, the default) or `now`.
    pub when: Option<When>,
    /// For `start`: the code that arming gave.
    pub code: Option<String>,
    /// Who asks, for the log of actions.
    pub who: Option<String>,
    /// Why, for the log of actions.
    pub why: Option<String>,
}

/// What can be done with a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Start an armed run, or go on with an interrupted one.
    Start,
    /// Pause it.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Finish the trial, raise, end.
    Stop,
    /// Raise now, end.
    Abort,
    /// What the run waits for has been done.
    Confirm,
    /// The last manual trial was bad.
    Repeat,
}

impl Action {
    fn name(self) -> &'static str {
        match self {
            Action::Start => "start",
            Action::Pause => "pause",
            Action::Resume => "resume",
            Action::Stop => "stop",
            Action::Abort => "abort",
            Action::Confirm => "confirm",
            Action::Repeat => "repeat",
        }
    }

    /// The operator lock blocks starting and editing, never stopping; so do roles.
    fn needs_lock(self) -> bool {
        match self {
            Action::Start | Action::Resume | Action::Confirm | Action::Repeat => true,
            Action::Pause | Action::Stop | Action::Abort => false,
        }
    }
}

/// When to pause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// After the current trial.
    Checkpoint,
    /// Now.
    Now,
}

/// Who asks, and why.
#[derive(Debug, Clone, Default, Deserialize, ToSchema)]
pub struct Asked {
    /// For the log of actions.
    pub who: Option<String>,
    /// For the log of actions.
    pub why: Option<String>,
}

/// An action that was taken up.
#[derive(Debug, Serialize, ToSchema)]
pub struct TakenUp {
    /// The run.
    pub run: RunUid,
    /// For `start`: whether it is under way or waits for the one before it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub started: Option<Started>,
}

/// A run by its uid or its scan_id.
pub async fn find(app: &App, run: &str) -> Result<RunRow, ApiError> {
    let found = if let Ok(scan_id) = run.parse::<i64>() {
        app.store.run_by_scan_id(scan_id).await?
    } else if let Ok(uid) = run.parse::<RunUid>() {
        app.store.run(uid).await?
    } else {
        return Err(ApiError::value("run", run, "must be a uid or a scan_id"));
    };
    found.ok_or_else(|| ApiError::not_found(format!("there is no run {run}")))
}

/// Runs, the newest first.
#[utoipa::path(get, path = "/api/v1/runs", tag = "runs", params(PageParams),
    responses((status = 200, body = RunPage)))]
pub async fn list(
    State(app): State<App>,
    Params(page): Params<PageParams>,
) -> Result<Json<RunPage>, ApiError> {
    let limit = page.limit.unwrap_or(PAGE);
    if !(1..=LONGEST_PAGE).contains(&limit) {
        return Err(ApiError::value("limit", limit, "must be from 1 to 500"));
    }
    Ok(Json(app.store.runs(limit, page.cursor).await?))
}

/// One run.
#[utoipa::path(get, path = "/api/v1/runs/{run}", tag = "runs",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = RunRow), (status = 404, body = ProblemBody)))]
pub async fn one(
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<RunRow>, ApiError> {
    Ok(Json(find(&app, &run).await?))
}

/// What came of a run.
#[utoipa::path(get, path = "/api/v1/runs/{run}/summary", tag = "runs",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = Summary), (status = 404, body = ProblemBody)))]
pub async fn summary(
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Summary>, ApiError> {
    let run = find(&app, &run).await?;
    let uid = run.uid;
    let progress = app
        .store
        .progress(uid)
        .await
        .map_err(|e| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
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

/// The preflight of a stored run on this rig.
#[utoipa::path(get, path = "/api/v1/runs/{run}/preflight", tag = "runs",
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = Preflight), (status = 404, body = ProblemBody)))]
pub async fn preflight(
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Preflight>, ApiError> {
    let run = find(&app, &run).await?;
    Ok(Json(app.conductor.preflight_of(&run).await?))
}

/// The first of the two steps of starting: answers with the preflight and a code.
#[utoipa::path(post, path = "/api/v1/runs/{run}/arm", tag = "runs", request_body = Asked,
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 200, body = Armed), (status = 409, body = ProblemBody),
        (status = 422, body = ProblemBody)))]
pub async fn arm(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(run): Path<String>,
    Body(asked): Body<Asked>,
) -> Result<Json<Armed>, ApiError> {
    let run = find(&app, &run).await?;
    let outcome = async {
        app.unlocked(&asker, asked.who.as_deref()).await?;
        Ok(app.conductor.arm(&run).await?)
    }
    .await;
    let about = (Some(run.uid), asked.who.as_deref(), asked.why.as_deref());
    Ok(Json(app.logged(&asker, "arm", about, outcome).await?))
}

/// An action on a run. The answer says that it was taken up; the status says what was reached.
#[utoipa::path(post, path = "/api/v1/runs/{run}/actions", tag = "runs", request_body = Act,
    description = STOPS,
    params(("run" = String, Path, description = "uid or scan_id")),
    responses((status = 202, body = TakenUp), (status = 409, body = ProblemBody)))]
pub async fn act(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(run): Path<String>,
    Body(act): Body<Act>,
) -> Result<(StatusCode, Json<TakenUp>), ApiError> {
    let run = find(&app, &run).await?;
    let outcome = take_up(&app, &asker, &run, &act).await;
    let about = (Some(run.uid), act.who.as_deref(), act.why.as_deref());
    let started = app.logged(&asker, act.action.name(), about, outcome).await?;
    Ok((StatusCode::ACCEPTED, Json(TakenUp { run: run.uid, started })))
}

async fn take_up(
    app: &App,
    asker: &Asker,
    run: &RunRow,
    act: &Act,
) -> Result<Option<Started>, ApiError> {
    if act.action.needs_lock() {
        asker.require(Role::Operator)?;
        app.unlocked(asker, act.who.as_deref()).await?;
    }
    if act.action == Action::Start {
        let code = act.code.as_deref().unwrap_or_default();
        return Ok(Some(app.conductor.start(run, code).await?));
    }
    if app.campaign.status().run.is_none_or(|r| r.uid != run.uid) {
        let words =
            format!("{} is not possible: run {} is {}", act.action.name(), run.scan_id, run.state);
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let request = match act.action {
        Action::Pause if act.when == Some(When::Now) => Request::PauseNow,
        Action::Pause => Request::PauseAtCheckpoint,
        Action::Resume | Action::Start => Request::Resume,
        Action::Stop => Request::Stop,
        Action::Abort => Request::Abort,
        Action::Confirm => Request::Confirm { who: asker.name(act.who.as_deref()) },
        Action::Repeat => Request::Repeat { why: act.why.clone().unwrap_or_default() },
    };
    app.campaign.ask(request).await?;
    Ok(None)
}
