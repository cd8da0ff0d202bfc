//! The operator lock, the API keys, and the log of actions.
//! Uses: `store`. Never: the text of a key, except in the response that creates it.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::audit::ActionContext;
use super::auth::Caller;
use super::problem::{ApiError, Body, Params, ProblemBody};
use super::queue::WhoParams;
use super::runs::find;
use crate::store::{ActionRow, KeyRow, LockRow, Role};

/// Request for the operator lock.
#[derive(Debug, Deserialize, ToSchema)]
pub struct LockRequest {
    /// Name of the holder. With a key the holder is the name of the key, without one `NAME
    /// (local)`.
    pub holder: Option<String>,
    /// Reason, shown to other persons.
    pub note: String,
}

/// Request for an API key.
#[derive(Debug, Deserialize, ToSchema)]
pub struct KeyRequest {
    /// Name of the holder or the purpose.
    pub name: String,
    /// Rights of the key.
    pub role: Role,
}

/// A new key with its text, which is not shown again.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct CreatedKey {
    /// The key without its text.
    pub key: KeyRow,
    /// Text of the key.
    pub secret: String,
}

/// Selection of actions.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ActionParams {
    /// Only actions on this run: uid or scan_id.
    pub run: Option<String>,
    /// Largest number of actions, 1 to 1000, default 100.
    pub limit: Option<u32>,
    /// Only actions with a smaller number.
    pub cursor: Option<i64>,
}

/// Returns the operator lock, or null.
#[utoipa::path(get, path = "/api/v1/lock", tag = "people",
    responses((status = 200, body = Option<LockRow>)))]
pub async fn lock(State(app): State<App>) -> Result<Json<Option<LockRow>>, ApiError> {
    Ok(Json(app.store.lock().await?))
}

/// Takes the operator lock.
///
/// It prevents others from starting and editing, never from stopping.
#[utoipa::path(put, path = "/api/v1/lock", tag = "people", request_body = LockRequest,
    responses((status = 200, body = LockRow),
        (status = 409, body = ProblemBody, description = "another person holds the operator lock")))]
pub async fn take_lock(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Body(new): Body<LockRequest>,
) -> Result<Json<LockRow>, ApiError> {
    let holder = caller.identity(new.holder.as_deref());
    let outcome = app.store.set_lock(&holder, &new.note).await.map_err(ApiError::from);
    let (who, why) = (new.holder.as_deref(), Some(new.note.as_str()));
    let context = ActionContext { run: None, who, why };
    Ok(Json(app.logged(&caller, "lock", context, outcome).await?))
}

/// Releases the operator lock.
///
/// Only the role `admin` may release the lock of another holder.
#[utoipa::path(delete, path = "/api/v1/lock", tag = "people", params(WhoParams),
    responses((status = 204),
        (status = 403, body = ProblemBody,
            description = "another person holds the lock, and the role is not admin")))]
pub async fn clear_lock(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Params(by): Params<WhoParams>,
) -> Result<StatusCode, ApiError> {
    let identity = caller.identity(by.who.as_deref());
    let outcome = async {
        if app.store.lock().await?.is_some_and(|l| l.holder != identity) {
            caller.require(Role::Admin)?;
        }
        app.store.clear_lock().await?;
        Ok(())
    }
    .await;
    let context = ActionContext { who: by.who.as_deref(), ..ActionContext::default() };
    app.logged(&caller, "unlock", context, outcome).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Returns the API keys, without their texts.
#[utoipa::path(get, path = "/api/v1/keys", tag = "people",
    responses((status = 200, body = Vec<KeyRow>),
        (status = 403, body = ProblemBody, description = "the role is not admin")))]
pub async fn keys(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
) -> Result<Json<Vec<KeyRow>>, ApiError> {
    caller.require(Role::Admin)?;
    Ok(Json(app.store.keys().await?))
}

/// Creates an API key.
#[utoipa::path(post, path = "/api/v1/keys", tag = "people", request_body = KeyRequest,
    responses((status = 201, body = CreatedKey),
        (status = 403, body = ProblemBody, description = "the role is not admin"),
        (status = 422, body = ProblemBody, description = "the name is invalid or in use")))]
pub async fn create_key(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Body(new): Body<KeyRequest>,
) -> Result<(StatusCode, Json<CreatedKey>), ApiError> {
    let outcome = async {
        caller.require(Role::Admin)?;
        let (key, secret) = app.keys.create(&new.name, new.role, rand::random()).await?;
        Ok(CreatedKey { key, secret })
    }
    .await;
    let context = ActionContext { why: Some(&new.name), ..ActionContext::default() };
    Ok((StatusCode::CREATED, Json(app.logged(&caller, "key", context, outcome).await?)))
}

/// Revokes an API key.
#[utoipa::path(delete, path = "/api/v1/keys/{id}", tag = "people",
    params(("id" = i64, Path, description = "number of the key")),
    responses((status = 204),
        (status = 404, body = ProblemBody, description = "no valid key has this number")))]
pub async fn revoke_key(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<i64>,
) -> Result<StatusCode, ApiError> {
    let outcome = async {
        caller.require(Role::Admin)?;
        if app.keys.revoke(id).await? {
            Ok(())
        } else {
            Err(ApiError::not_found(format!("no valid key {id}")))
        }
    }
    .await;
    app.logged(&caller, "revoke_key", ActionContext::default(), outcome).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Returns the log of actions, newest first.
#[utoipa::path(get, path = "/api/v1/actions", tag = "people", params(ActionParams),
    responses((status = 200, body = Vec<ActionRow>)))]
pub async fn actions(
    State(app): State<App>,
    Params(params): Params<ActionParams>,
) -> Result<Json<Vec<ActionRow>>, ApiError> {
    let run = match &params.run {
        Some(run) => Some(find(&app, run).await?.uid),
        None => None,
    };
    let limit = params.limit.unwrap_or(100).clamp(1, 1000);
    Ok(Json(app.store.actions(run, limit, params.cursor).await?))
}
