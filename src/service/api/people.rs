//! The operator lock, the keys, and the log of who did what.
//! Uses: `store`. Never: a key's text, but in the one answer that creates it.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::auth::Asker;
use super::problem::{ApiError, Body, Params, ProblemBody};
use super::queue::ByWhom;
use super::runs::find;
use crate::store::{ActionRow, KeyRow, LockRow, Role};

/// A lock that is asked for.
#[derive(Debug, Deserialize, ToSchema)]
pub struct NewLock {
    /// Who takes it; with a key the key's name counts, without one it becomes `NAME (local)`.
    pub holder: Option<String>,
    /// Why, for those who find it.
    pub note: String,
}

/// A key that is asked for.
#[derive(Debug, Deserialize, ToSchema)]
pub struct NewKey {
    /// Whose, or what for.
    pub name: String,
    /// What its holder may do.
    pub role: Role,
}

/// A key that was made; its text is told once.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct MadeKey {
    /// The key.
    pub key: KeyRow,
    /// Its text.
    pub secret: String,
}

/// Which actions.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ActionParams {
    /// On this run only: uid or scan_id.
    pub run: Option<String>,
    /// Up to so many, at most 1000.
    pub limit: Option<u32>,
    /// Older than this number.
    pub cursor: Option<i64>,
}

/// The operator lock, or null.
#[utoipa::path(get, path = "/api/v1/lock", tag = "people",
    responses((status = 200, body = Option<LockRow>)))]
pub async fn lock(State(app): State<App>) -> Result<Json<Option<LockRow>>, ApiError> {
    Ok(Json(app.store.lock().await?))
}

/// Takes the operator lock: it blocks starting and editing by others, never stopping.
#[utoipa::path(put, path = "/api/v1/lock", tag = "people", request_body = NewLock,
    responses((status = 200, body = LockRow), (status = 409, body = ProblemBody)))]
pub async fn take_lock(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(new): Body<NewLock>,
) -> Result<Json<LockRow>, ApiError> {
    let holder = asker.identity(new.holder.as_deref());
    let outcome = app.store.set_lock(&holder, &new.note).await.map_err(ApiError::from);
    let about = (None, new.holder.as_deref(), Some(new.note.as_str()));
    Ok(Json(app.logged(&asker, "lock", about, outcome).await?))
}

/// Gives the lock back. Another's can be broken by an admin only.
#[utoipa::path(delete, path = "/api/v1/lock", tag = "people", params(ByWhom),
    responses((status = 204), (status = 403, body = ProblemBody)))]
pub async fn clear_lock(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Params(by): Params<ByWhom>,
) -> Result<StatusCode, ApiError> {
    let identity = asker.identity(by.who.as_deref());
    let outcome = async {
        if app.store.lock().await?.is_some_and(|l| l.holder != identity) {
            asker.require(Role::Admin)?;
        }
        app.store.clear_lock().await?;
        Ok(())
    }
    .await;
    app.logged(&asker, "unlock", (None, by.who.as_deref(), None), outcome).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The keys, without their texts.
#[utoipa::path(get, path = "/api/v1/keys", tag = "people",
    responses((status = 200, body = Vec<KeyRow>), (status = 403, body = ProblemBody)))]
pub async fn keys(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
) -> Result<Json<Vec<KeyRow>>, ApiError> {
    asker.require(Role::Admin)?;
    Ok(Json(app.store.keys().await?))
}

/// Makes a key.
#[utoipa::path(post, path = "/api/v1/keys", tag = "people", request_body = NewKey,
    responses((status = 201, body = MadeKey), (status = 403, body = ProblemBody),
        (status = 422, body = ProblemBody)))]
pub async fn create_key(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Body(new): Body<NewKey>,
) -> Result<(StatusCode, Json<MadeKey>), ApiError> {
    let outcome = async {
        asker.require(Role::Admin)?;
        let (key, secret) = app.keys.create(&new.name, new.role, rand::random()).await?;
        Ok(MadeKey { key, secret })
    }
    .await;
    let about = (None, None, Some(new.name.as_str()));
    Ok((StatusCode::CREATED, Json(app.logged(&asker, "key", about, outcome).await?)))
}

/// Revokes a key.
#[utoipa::path(delete, path = "/api/v1/keys/{id}", tag = "people",
    params(("id" = i64, Path, description = "its number")),
    responses((status = 204), (status = 404, body = ProblemBody)))]
pub async fn revoke_key(
    State(app): State<App>,
    Extension(asker): Extension<Asker>,
    Path(id): Path<i64>,
) -> Result<StatusCode, ApiError> {
    let outcome = async {
        asker.require(Role::Admin)?;
        if app.keys.revoke(id).await? {
            Ok(())
        } else {
            Err(ApiError::not_found(format!("there is no valid key {id}")))
        }
    }
    .await;
    app.logged(&asker, "revoke_key", (None, None, None), outcome).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Who did what, when and why; the newest first.
#[utoipa::path(get, path = "/api/v1/actions", tag = "people", params(ActionParams),
    responses((status = 200, body = Vec<ActionRow>)))]
pub async fn actions(
    State(app): State<App>,
    Params(asked): Params<ActionParams>,
) -> Result<Json<Vec<ActionRow>>, ApiError> {
    let run = match &asked.run {
        Some(run) => Some(find(&app, run).await?.uid),
        None => None,
    };
    let limit = asked.limit.unwrap_or(100).clamp(1, 1000);
    Ok(Json(app.store.actions(run, limit, asked.cursor).await?))
}
