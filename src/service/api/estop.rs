//! The emergency stop by HTTP: latch first, then read who and why, then write it down.
//! Uses: `auth` (the keys in memory), `campaign::shown::command`. Never, before the latch: the body, a
//! lock, a queue, the store, a log, any wait at all.

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
use super::auth::{self, Asker};
use super::problem::{ApiError, ProblemBody};
use super::runs::Asked;

/// The part of a body that is looked at, bytes.
const BODY_MAX_BYTES: usize = 4096;
/// Longest time that a body is taken in for.
const BODY_WAIT: Duration = Duration::from_secs(1);
/// Longest name that is kept; the rest is cut off.
const WHO_MAX_CHARS: usize = 100;
/// Longest reason that is kept; the rest is cut off.
const WHY_MAX_CHARS: usize = 500;

/// The stop is latched.
#[derive(Debug, Serialize, ToSchema)]
pub struct Latched {
    /// Always true.
    pub latched: bool,
}

/// Stops every axis at once and latches. One call, no lock, idempotent; any valid key. The body is
/// for the log of actions alone: with none, or with one that cannot be read, the stop is the same.
#[utoipa::path(post, path = "/api/v1/estop", tag = "rig", request_body = Option<Asked>,
    responses((status = 200, body = Latched), (status = 401, body = ProblemBody)))]
pub async fn estop(
    State(app): State<App>,
    request: Request,
) -> Result<impl IntoResponse, ApiError> {
    let asker = auth::identify(&app, request.headers(), request.uri().query())?;
    let name = cut(&asker.name(None), WHO_MAX_CHARS);
    app.campaign.estop(&format!("emergency stop ({name})"));
    let threads = app.facts.threads.clone();
    threads.spawn(log(app, asker, request.into_body()));
    // A body that is still to come must not hold the answer up, nor be taken for another request.
    Ok(([(header::CONNECTION, "close")], Json(Latched { latched: true })))
}

/// Writes down who stopped, and why as far as they say so.
async fn log(app: App, asker: Asker, body: Body) {
    if let Some(key) = &asker.key {
        app.keys.note_use(key);
    }
    let asked: Asked = serde_json::from_slice(&beginning(body).await).unwrap_or_default();
    let who = asked.who.map(|who| cut(&who, WHO_MAX_CHARS));
    let why = asked.why.map(|why| cut(&why, WHY_MAX_CHARS));
    let about = (None, who.as_deref(), why.as_deref());
    // A failure is logged there; the stop holds.
    let _ = app.logged(&asker, "estop", about, Ok(())).await;
}

/// The first bytes of a body, as far as they come in time. What is beyond them is taken in too, and
/// dropped: a client that sends it all the same can then read its answer.
async fn beginning(body: Body) -> Vec<u8> {
    let mut kept = Vec::new();
    let mut pieces = body.into_data_stream();
    let take = async {
        while let Some(Ok(piece)) = pieces.next().await {
            let room = BODY_MAX_BYTES - kept.len();
            kept.extend_from_slice(&piece[..piece.len().min(room)]);
        }
    };
    // A body that is late is as good as one that has ended.
    let _ = tokio::time::timeout(BODY_WAIT, take).await;
    kept
}

fn cut(text: &str, max_chars: usize) -> String {
    text.chars().take(max_chars).collect()
}
