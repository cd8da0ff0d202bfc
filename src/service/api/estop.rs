//! The e-stop by HTTP: latch first, then read name and reason from the body, then log.
//! Uses: `auth` (the keys in memory), `campaign::shown::command`. Never, before the latch: the
//! body, a lock, a queue, the store, a log, any other wait.

use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header;
use axum::response::IntoResponse;
use futures::StreamExt;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::audit::ActionContext;
use super::auth::{self, Caller};
use super::problem::{ApiError, ProblemBody};
use super::runs::Attribution;

/// Part of the body that is read, bytes.
const BODY_MAX_BYTES: usize = 4096;
/// Longest time for receiving the body.
const BODY_WAIT: Duration = Duration::from_secs(1);
/// Largest length of a stored name, characters; longer names are cut.
const WHO_MAX_CHARS: usize = 100;
/// Largest length of a stored reason, characters; longer reasons are cut.
const WHY_MAX_CHARS: usize = 500;

/// Response of the e-stop.
#[derive(Debug, Serialize, ToSchema)]
pub struct Latched {
    /// Always true: the stop is latched.
    pub latched: bool,
}

/// Stops all axes immediately and latches the e-stop.
///
/// Any valid key permits it, whatever its role and whoever holds the lock; it may be repeated. The
/// body is only used for the log of actions: without one, or with an invalid one, the stop is the
/// same.
#[utoipa::path(post, path = "/api/v1/estop", tag = "rig", request_body = Option<Attribution>,
    responses((status = 200, body = Latched),
        (status = 401, body = ProblemBody, description = "the key is missing, unknown or revoked")))]
pub async fn estop(
    State(app): State<App>,
    request: Request,
) -> Result<impl IntoResponse, ApiError> {
    let caller = auth::identify(&app, request.headers(), request.uri().query())?;
    let name = cut(&caller.name(None), WHO_MAX_CHARS);
    app.campaign.estop(&format!("emergency stop ({name})"));
    let threads = app.facts.threads.clone();
    threads.spawn(log(app, caller, request.into_body()));
    // A body that arrives later must not delay the response, nor be read as another request.
    Ok(([(header::CONNECTION, "close")], Json(Latched { latched: true })))
}

/// Logs who stopped, and the reason, if the body states it.
async fn log(app: App, caller: Caller, body: Body) {
    if let Some(key) = &caller.key {
        app.keys.note_use(key);
    }
    let stated: Attribution = serde_json::from_slice(&beginning(body).await).unwrap_or_default();
    let who = stated.who.map(|who| cut(&who, WHO_MAX_CHARS));
    let why = stated.why.map(|why| cut(&why, WHY_MAX_CHARS));
    let context = ActionContext { run: None, who: who.as_deref(), why: why.as_deref() };
    // A failure of the log is reported there; the stop is in effect.
    let _ = app.logged(&caller, "estop", context, Ok(())).await;
}

/// Returns the first bytes of a body that arrive in time. Further bytes are received and dropped,
/// so that a client that sends them can read the response.
async fn beginning(body: Body) -> Vec<u8> {
    let mut kept = Vec::new();
    let mut pieces = body.into_data_stream();
    let take = async {
        while let Some(Ok(piece)) = pieces.next().await {
            let room = BODY_MAX_BYTES - kept.len();
            kept.extend_from_slice(&piece[..piece.len().min(room)]);
        }
    };
    // After the deadline the received part counts as the body.
    let _ = tokio::time::timeout(BODY_WAIT, take).await;
    kept
}

fn cut(text: &str, max_chars: usize) -> String {
    text.chars().take(max_chars).collect()
}
