//! Things that two people may edit: entity tags of what is shown, and changes that are refused if the
//! thing is no longer what their client saw.
//! Uses: `access`, `tags`, the handlers that show the things. Never: a wait of a stop, a pause or the end of a run.

use axum::extract::Request;
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::Mutex;

use super::access::{Edited, Needs};
use super::problem::{ApiError, ApiResult};
use super::tags::{lists, tagged, unless_known};
use super::{App, models, people, queue};

/// For each thing a mutex that is held from the comparison to the end of its change.
#[derive(Debug, Default)]
pub struct Edits {
    lock: Mutex<()>,
    queue: Mutex<()>,
    serving: Mutex<()>,
}

impl Edits {
    fn of(&self, thing: Edited) -> &Mutex<()> {
        match thing {
            Edited::Lock => &self.lock,
            Edited::Queue => &self.queue,
            Edited::Serving => &self.serving,
        }
    }
}

impl Edited {
    /// Address at which the thing is shown.
    fn path(self) -> &'static str {
        match self {
            Edited::Lock => "/api/v1/lock",
            Edited::Queue => "/api/v1/queue",
            Edited::Serving => "/api/v1/serving",
        }
    }

    /// The response that shows the thing as it is now.
    async fn shown(self, app: &App) -> Response {
        let app = app.clone();
        match self {
            Edited::Lock => people::lock(app).await.into_response(),
            Edited::Queue => queue::list(app).await.into_response(),
            Edited::Serving => models::serving(app).await.into_response(),
        }
    }

    /// Checks that the thing is what the client saw.
    ///
    /// The conductor takes runs from the queue without the mutex, because no start waits for an editor.
    /// After the comparison this is harmless: the conductor refuses to edit or remove a run that it took, the store
    /// to move one, in the transaction of the change, and a position counts in the queue as it is then.
    ///
    /// # Errors
    /// 412 if it is not; 500 if the store fails.
    async fn check(self, app: &App, headers: &HeaderMap) -> ApiResult<()> {
        if !headers.contains_key(header::IF_MATCH) {
            return Ok(());
        }
        let (_, tag) = tagged(self.shown(app).await).await?;
        match tag {
            // The thing cannot be read: the change would be blind.
            None => Err(ApiError::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                format!("{} could not be read for the comparison with If-Match", self.path()),
            )),
            Some(tag) if lists(headers, &header::IF_MATCH, &tag) => Ok(()),
            Some(_) => {
                let words = format!(
                    "If-Match: it has changed meanwhile: GET {} shows it with its new entity tag",
                    self.path()
                );
                Err(ApiError::new(StatusCode::PRECONDITION_FAILED, words))
            }
        }
    }
}

/// Lets a handler answer: what it shows gets an entity tag; what it changes is compared with `If-Match`.
pub async fn carry_out(app: &App, needs: Needs, request: Request, next: Next) -> Response {
    let Some(thing) = needs.edited else { return next.run(request).await };
    if matches!(*request.method(), Method::GET | Method::HEAD) {
        let headers = request.headers().clone();
        return match tagged(next.run(request).await).await {
            Ok((shown, tag)) => unless_known(&headers, shown, tag),
            Err(error) => error.into_response(),
        };
    }
    let _alone = app.facts.edits.of(thing).lock().await;
    match thing.check(app, request.headers()).await {
        Ok(()) => next.run(request).await,
        Err(refused) => refused.into_response(),
    }
}
