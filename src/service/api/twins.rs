//! Simulated twins: status of the pool, progress for each run, and twins that other machines make.
//! Uses: `twins`, `store`. Never: a computation, a stored twin that changes.

use axum::Json;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::audit::Act;
use super::form::{Form, missing};
use super::limits::FRAMES_MAX_BYTES;
use super::problem::{ApiError, ApiResult, Params, Path};
use super::runs::find;
use crate::ids::{RunUid, TrialId};
use crate::simulate::twins::file::CHUNK_TRIALS_MAX;
use crate::store::TwinCount;
use crate::twins::elsewhere::{StoredTwins, TwinInputs};
use crate::twins::{PoolError, PoolStatus};

/// Number of runs that are counted, newest first: counting 33,000 trials takes about 20 ms.
const COUNTED_RUNS: usize = 10;

/// Status of the simulated twins.
#[derive(Debug, Serialize, ToSchema)]
pub struct Twins {
    /// Status of the pool that simulates twins.
    pub pool: PoolStatus,
    /// The newest 10 runs with trials, newest first.
    pub runs: Vec<RunTwins>,
}

/// Number of twins of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunTwins {
    /// uid of the run.
    pub run: RunUid,
    /// Number of trials, twins and failures.
    #[serde(flatten)]
    pub count: TwinCount,
    /// Number of trials without twin and without failure.
    pub pending: u64,
}

impl RunTwins {
    async fn of(app: &App, run: RunUid) -> ApiResult<Self> {
        let count = app.twins.count(run).await?;
        Ok(Self { run, count, pending: count.pending() })
    }
}

/// Returns the status of the simulated twins.
#[utoipa::path(get, operation_id = "twins", path = "/api/v1/twins", tag = "simulation",
    responses((status = 200, body = Twins)))]
pub async fn all(app: App) -> ApiResult<Json<Twins>> {
    let mut runs = Vec::new();
    for run in app.store.runs_with_trials().await?.into_iter().take(COUNTED_RUNS) {
        runs.push(RunTwins::of(&app, run).await?);
    }
    Ok(Json(Twins { pool: app.twins.status(), runs }))
}

/// Returns the number of twins of a run.
#[utoipa::path(get, operation_id = "run_twins", path = "/api/v1/runs/{run}/twins",
    tag = "simulation", responses((status = 200, body = RunTwins)))]
pub async fn of_run(app: App, Path(run): Path<String>) -> ApiResult<Json<RunTwins>> {
    let run = find(&app, &run).await?.uid;
    RunTwins::of(&app, run).await.map(Json)
}

/// Selection of trials.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct InputsParams {
    /// Only trials with a larger id; absent: from the first one on.
    pub after: Option<i64>,
    /// Largest number of trials, 1 to 10,000; 1000 if absent.
    #[serde(default = "thousand")]
    #[param(minimum = 1, maximum = 10000, default = 1000)]
    pub limit: u32,
}

fn thousand() -> u32 {
    1000
}

/// Returns what the twins of a run are computed from: the skin, and the contacts of its trials.
///
/// The trials are those that are stored, with a twin or without, in the order of storing.
#[utoipa::path(get, operation_id = "twin_inputs", path = "/api/v1/runs/{run}/twins/inputs",
    tag = "simulation", params(("run" = String, Path), InputsParams),
    responses((status = 200, body = TwinInputs),
        (status = 409, description = "the run has no model of its skin")))]
pub async fn inputs(
    app: App,
    Path(run): Path<String>,
    Params(InputsParams { after, limit }): Params<InputsParams>,
) -> ApiResult<Json<TwinInputs>> {
    if !(1..=CHUNK_TRIALS_MAX).contains(&u64::from(limit)) {
        let words = format!("must be from 1 to {CHUNK_TRIALS_MAX}");
        return Err(ApiError::query("limit", limit, &words));
    }
    let run = find(&app, &run).await?.uid;
    let after = TrialId(after.unwrap_or_default());
    Ok(Json(app.twins.inputs(run, after, limit).await?))
}

/// Form of twins that were made elsewhere.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes the request for openapi.yaml")]
pub struct TwinsForm {
    /// A chunk of `palpate cluster sbatch twins`, at most 64 MiB.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
}

/// Stores twins of a run that were made elsewhere, each once.
///
/// The file must be of the model that the service uses for the run, and of the contacts of its trials. A stored twin
/// stays; if one differs, none is stored.
#[utoipa::path(post, operation_id = "store_twins", path = "/api/v1/runs/{run}/twins",
    tag = "simulation", request_body(content = TwinsForm, content_type = "multipart/form-data"),
    responses((status = 200, body = StoredTwins),
        (status = 400, description = "the form is invalid"),
        (status = 409,
            description = "a stored twin differs, the run has no model of its skin, or another person holds the \
                           operator lock"),
        (status = 422,
            description = "the file contains no twins of this run, its model and its contacts"),
        (status = 507, description = "the disk has no room")))]
pub async fn store(
    app: App,
    act: Act,
    Path(run): Path<String>,
    form: Form,
) -> ApiResult<Json<StoredTwins>> {
    let run = find(&app, &run).await?.uid;
    act.on(run);
    app.datasets.check_upload(0).await?;
    let (file, []) = form.parts(FRAMES_MAX_BYTES, []).await?;
    let file = file.ok_or_else(|| missing("file"))?;
    app.still_allowed(&act).await?;
    Ok(Json(app.twins.store_made(run, file.into()).await?))
}

impl From<PoolError> for ApiError {
    fn from(error: PoolError) -> Self {
        let status = match error {
            PoolError::Store(error) => return error.into(),
            PoolError::File { .. } | PoolError::Foreign(_) | PoolError::OtherTwin(_) => {
                StatusCode::CONFLICT
            }
            PoolError::Made(_) => StatusCode::UNPROCESSABLE_ENTITY,
            PoolError::Worker => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self::new(status, error.to_string())
    }
}
