//! The operator lock, the API keys, and the log of actions.
//! Uses: `store`. Never: the text of a key, except in the response that creates it.

use axum::http::StatusCode;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::audit::Act;
use super::auth::Caller;
use super::limits::{TICKET, TICKETS, WHO_MAX_CHARS, WHY_MAX_CHARS};
use super::pages::{Page, PageParams, PageRequest};
use super::problem::{ApiError, ApiResult, Body, Params, Path};
use super::queue::WhoParams;
use super::runs::find;
use crate::store::{ActionRow, KeyRow, LockRow, Role};

/// The operator lock while a person holds it.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct LockOut {
    /// Holder, note and time.
    #[serde(flatten)]
    pub row: LockRow,
    /// Whether it was taken without a key: then it holds for every caller, its holder included, and a
    /// caller without a key may release it.
    pub keyless: bool,
}

impl From<LockRow> for LockOut {
    fn from(row: LockRow) -> Self {
        Self { keyless: row.is_keyless(), row }
    }
}

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
}

/// Returns the operator lock, or null.
#[utoipa::path(get, path = "/api/v1/lock", tag = "people",
    responses((status = 200, body = Option<LockOut>)))]
pub async fn lock(app: App) -> ApiResult<Json<Option<LockOut>>> {
    Ok(Json(app.store.lock().await?.map(LockOut::from)))
}

/// Takes the operator lock.
///
/// It prevents others from starting and editing, never from stopping. A lock that is taken without
/// a key holds for every caller, its holder included, until a caller without a key, or an admin,
/// releases it: without a key no caller can prove to be the holder.
#[utoipa::path(put, path = "/api/v1/lock", tag = "people", request_body = LockRequest,
    responses((status = 200, body = LockOut),
        (status = 409, description = "another person holds the operator lock")))]
pub async fn take_lock(
    app: App,
    act: Act,
    Body(new): Body<LockRequest>,
) -> ApiResult<Json<LockOut>> {
    act.stated(new.holder.as_deref(), Some(&new.note));
    let holder = new.holder.as_deref();
    ApiError::check_text("holder", holder.unwrap_or_default(), WHO_MAX_CHARS)?;
    ApiError::check_text("note", &new.note, WHY_MAX_CHARS)?;
    Ok(Json(app.store.set_lock(&act.caller().holder(holder), &new.note).await?.into()))
}

/// Releases the operator lock.
///
/// Only the role `admin` may release the lock of another holder's key.
#[utoipa::path(delete, path = "/api/v1/lock", tag = "people", params(WhoParams),
    responses((status = 204),
        (status = 403, description = "another person holds the lock, and the role is not admin")))]
pub async fn clear_lock(
    app: App,
    act: Act,
    Params(by): Params<WhoParams>,
) -> ApiResult<StatusCode> {
    act.stated(by.who.as_deref(), None);
    if let Some(lock) = app.store.lock().await?
        && !act.caller().may_release(&lock)
    {
        let words = format!(
            "{} holds the operator lock ({}): only the holder or an admin may release it",
            lock.holder, lock.note
        );
        return Err(ApiError::new(StatusCode::FORBIDDEN, words));
    }
    app.store.clear_lock().await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Returns the API keys, without their texts.
#[utoipa::path(get, path = "/api/v1/keys", tag = "people",
    responses((status = 200, body = Page<KeyRow>)))]
pub async fn keys(app: App) -> ApiResult<Page<KeyRow>> {
    Ok(Page::whole(app.store.keys().await?))
}

/// Creates an API key.
#[utoipa::path(post, path = "/api/v1/keys", tag = "people", request_body = KeyRequest,
    responses((status = 201, body = CreatedKey),
        (status = 422, description = "the name is invalid or in use")))]
pub async fn create_key(
    app: App,
    act: Act,
    Body(new): Body<KeyRequest>,
) -> ApiResult<(StatusCode, Json<CreatedKey>)> {
    act.about(&new.name);
    let (key, secret) = app.keys.create(&new.name, new.role, rand::random()).await?;
    Ok((StatusCode::CREATED, Json(CreatedKey { key, secret })))
}

/// Revokes an API key.
#[utoipa::path(delete, path = "/api/v1/keys/{id}", tag = "people",
    params(("id" = i64, Path, description = "number of the key")), responses((status = 204),
        (status = 404, description = "no valid key has this number")))]
pub async fn revoke_key(app: App, act: Act, Path(id): Path<i64>) -> ApiResult<StatusCode> {
    act.about(&format!("key {id}"));
    match app.keys.revoke(id).await? {
        true => Ok(StatusCode::NO_CONTENT),
        false => Err(ApiError::not_found(format!("no valid key {id}"))),
    }
}

/// A ticket for one WebSocket.
#[derive(Debug, Serialize, ToSchema)]
pub struct Ticket {
    /// Value of the parameter `ticket` of the WebSocket's address.
    pub ticket: String,
    /// Time for which it may be used, s.
    pub valid_s: u64,
}

/// Who asks, and with which rights.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct CallerOut {
    /// Name of the key; absent for a caller on this machine without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Role, which determines the allowed operations.
    pub role: Role,
}

/// Returns name and role of the caller, so that an interface offers only what is allowed.
#[utoipa::path(get, path = "/api/v1/caller", tag = "people",
    responses((status = 200, body = CallerOut)))]
pub async fn caller(Extension(caller): Extension<Caller>) -> Json<CallerOut> {
    Json(CallerOut { name: caller.key.map(|key| key.name), role: caller.role })
}

/// Creates a ticket with which one WebSocket may be opened.
///
/// A browser's WebSocket sends no header with a key, and no address may hold a key. The ticket has
/// the rights of its caller; it can be used once.
#[utoipa::path(post, operation_id = "create_ticket", path = "/api/v1/tickets", tag = "people",
    responses((status = 201, body = Ticket, description = "the ticket"),
        (status = 429, description = "too many tickets wait to be used")))]
pub async fn ticket(
    app: App,
    Extension(caller): Extension<Caller>,
) -> ApiResult<(StatusCode, Json<Ticket>)> {
    let ticket = app.facts.tickets.create(caller, rand::random()).ok_or_else(|| {
        let words = format!("{TICKETS} tickets wait to be used: use one, or wait");
        ApiError::new(StatusCode::TOO_MANY_REQUESTS, words)
    })?;
    Ok((StatusCode::CREATED, Json(Ticket { ticket, valid_s: TICKET.as_secs() })))
}

/// Returns the log of actions, newest first.
#[utoipa::path(get, path = "/api/v1/actions", tag = "people", params(ActionParams, PageParams),
    responses((status = 200, body = Page<ActionRow>),
        (status = 404, description = "no run has this uid or scan_id")))]
pub async fn actions(
    app: App,
    Params(params): Params<ActionParams>,
    asked: PageRequest,
) -> ApiResult<Page<ActionRow>> {
    let run = match &params.run {
        Some(run) => Some(find(&app, run).await?.uid),
        None => None,
    };
    let found = app.store.actions(run, asked.limit + 1, asked.after()?).await?;
    Ok(asked.first(found, |action| action.id))
}
