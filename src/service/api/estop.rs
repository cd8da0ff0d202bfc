//! The e-stop by HTTP: latch first, then read name and reason from the body, then log.
//! Uses: `auth` (the keys in memory), `campaign::shown`; after the latch `trace`, `conductor`. Never,
//! before the latch: the body, a lock, a queue, the store, a log, a span, any other wait.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::Json;
use axum::body::Body;
use axum::extract::{MatchedPath, Request};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use parking_lot::Mutex;
use serde::Serialize;
use tracing::Instrument;
use utoipa::ToSchema;

use super::App;
use super::audit::{Act, Outcome, cut};
use super::auth::{self, Caller};
use super::limits::WHO_MAX_CHARS;
use super::problem::ApiResult;
use super::runs::Attribution;
use super::trace::RequestId;
use crate::campaign::shown::status::Status;
use crate::conductor::Conductor;
use crate::journal::error_chain;

/// Part of the body that is read, bytes.
const ESTOP_BODY_BYTES: usize = 4096;
/// Longest time for receiving the body.
const BODY_WAIT: Duration = Duration::from_secs(1);

/// Response of the e-stop.
#[derive(Debug, Serialize, ToSchema)]
pub struct Latched {
    /// Always true: the stop is latched.
    pub latched: bool,
}

/// Who latched the e-stop last. The latch has only the name of the key; the body, which is read later, may name a
/// person.
#[derive(Debug, Default)]
pub struct Stopper {
    requests: AtomicU64,
    noted: Mutex<Option<Named>>,
}

/// Words of a latch, without and with the person.
#[derive(Debug)]
struct Named {
    request: u64,
    latched: String,
    named: String,
}

impl Stopper {
    /// Returns the number of a new request, whose person is not known yet. Takes no lock.
    fn count(&self) -> u64 {
        self.requests.fetch_add(1, Ordering::SeqCst) + 1
    }

    fn is_last(&self, request: u64) -> bool {
        self.requests.load(Ordering::SeqCst) == request
    }

    /// Notes the person of a request, unless another one has followed while its body arrived.
    fn note(&self, request: u64, latched: String, named: String) {
        let mut noted = self.noted.lock();
        if self.is_last(request) {
            *noted = Some(Named { request, latched, named });
        }
    }

    /// Names the person of the last request in a status that has the words of the latch.
    pub fn name(&self, status: &mut Status) {
        let noted = self.noted.lock();
        let Some(Named { request, latched, named }) = &*noted else { return };
        if !self.is_last(*request) {
            return;
        }
        let cause = status.rig.trip.as_mut().map(|trip| &mut trip.detail);
        let waits_for = status.run.as_mut().and_then(|run| run.waiting_for.as_mut());
        for words in [cause, waits_for].into_iter().flatten().filter(|words| **words == *latched) {
            words.clone_from(named);
        }
    }
}

fn latch_words(name: &str) -> String {
    format!("emergency stop ({})", cut(name, WHO_MAX_CHARS))
}

/// Stops all axes immediately and latches the e-stop.
///
/// Any valid key permits it, for every role and every holder of the lock; it may be repeated. The
/// body only states who stopped, and why: without one, or with an invalid one, the stop is the
/// same.
#[utoipa::path(post, path = "/api/v1/estop", tag = "rig",
    request_body(content = Option<serde_json::Value>, description = "`who` and `why`, as in Attribution, for \
        the status and the log of actions; whatever it is, the stop is the same"),
    responses((status = 200, body = Latched),
        (status = 401, description = "the key is missing, unknown or revoked")))]
pub async fn estop(app: App, request: Request) -> Response {
    let began = Instant::now();
    let latched = latch(&app, &request);
    let latched_after = began.elapsed();
    // The stop is latched. From here on nothing can delay it.
    let id = RequestId::of(request.headers());
    let mut response = match latched {
        Ok(caller) => {
            let number = app.facts.memory.stopper.count();
            let (threads, id) = (app.facts.threads.clone(), id.clone());
            // The span is made there, too: the door's thread never waits for the log.
            threads.spawn(async move {
                let span = id.span(request.method(), request.extensions().get::<MatchedPath>());
                span.record("caller", caller.name(None));
                span.in_scope(|| {
                    let latched_ms = latched_after.as_secs_f64() * 1e3;
                    tracing::warn!(latched_ms, "the e-stop was requested and is latched");
                });
                let conductor = app.conductor.clone();
                let logged = log(app, caller, number, request.into_body());
                async { tokio::join!(note(&conductor), logged) }.instrument(span).await;
            });
            // A body that arrives later must not delay the response, nor be read as another request.
            ([(header::CONNECTION, "close")], Json(Latched { latched: true })).into_response()
        }
        Err(refused) => {
            let (detail, stated) = (refused.detail().to_owned(), id.clone());
            app.facts.threads.spawn(async move {
                let request = stated.text();
                tracing::warn!(request, detail, "an e-stop was refused: nothing is latched");
            });
            refused.into_response()
        }
    };
    id.stamp(&mut response);
    response
}

/// Latches the e-stop for a caller with a valid key. Neither waits nor writes.
///
/// # Errors
/// As [`auth::identify_stop`]; nothing is latched then.
fn latch(app: &App, request: &Request) -> ApiResult<Caller> {
    let peer = request.extensions().get().copied();
    let caller = auth::identify_stop(app, request.headers(), peer)?;
    app.campaign.estop(&latch_words(&caller.name(None)));
    Ok(caller)
}

/// Stores that a person is at the rig: after a crash, too, no run is driven by itself.
async fn note(conductor: &Conductor) {
    if let Err(error) = conductor.note_stop().await {
        let error = error_chain(&error);
        tracing::error!(error, "after a crash a run may be driven again in spite of the e-stop");
    }
}

/// Logs who stopped, and the reason, if the body states it. `request`: its number.
async fn log(app: App, caller: Caller, request: u64, body: Body) {
    if let Some(key) = &caller.key {
        app.keys.note_use(key);
    }
    let stated: Attribution = serde_json::from_slice(&beginning(body).await).unwrap_or_default();
    let latched = latch_words(&caller.name(None));
    let act = Act::new(caller, "estop");
    act.stated(stated.who.as_deref(), stated.why.as_deref());
    app.facts.memory.stopper.note(request, latched, latch_words(&act.name()));
    act.log(&app, Outcome { accepted: true, refused: None }).await;
}

/// Returns the first bytes of a body that arrive in time. Further bytes are received and dropped,
/// so that a client that sends them can read the response.
async fn beginning(body: Body) -> Vec<u8> {
    let mut kept = Vec::new();
    let mut pieces = body.into_data_stream();
    let take = async {
        while let Some(Ok(piece)) = pieces.next().await {
            let room = ESTOP_BODY_BYTES - kept.len();
            kept.extend_from_slice(&piece[..piece.len().min(room)]);
        }
    };
    // After the deadline the received part counts as the body.
    let _ = tokio::time::timeout(BODY_WAIT, take).await;
    kept
}

#[cfg(test)]
mod tests {
    use super::super::needs::tests::{status, waiting};
    use super::*;
    use crate::campaign::bench::interlock::{Trip, TripKind};
    use crate::campaign::bench::rig_state::RigState;
    use crate::state::PausedWhy;

    #[test]
    fn a_latched_stop_is_shown_with_the_person_until_another_is_requested() {
        let latched = latch_words("local");
        let mut stopped = status(RigState::Tripped);
        stopped.rig.trip = Some(Trip { kind: TripKind::Estop, detail: latched.clone() });
        let mut run = waiting(PausedWhy::Trip);
        run.waiting_for = Some(latched.clone());
        stopped.run = Some(run);
        let stopper = Stopper::default();
        let shown = |status: &Status| {
            let mut shown = status.clone();
            stopper.name(&mut shown);
            (shown.rig.trip.map(|trip| trip.detail), shown.run.and_then(|run| run.waiting_for))
        };
        let of_both = |words: &str| (Some(words.to_owned()), Some(words.to_owned()));
        assert_eq!(shown(&stopped), of_both("emergency stop (local)"));
        let first = stopper.count();
        stopper.note(first, latched.clone(), latch_words("ada (local)"));
        assert_eq!(shown(&stopped), of_both("emergency stop (ada (local))"));
        let mut other = stopped.clone();
        other.rig.trip = Some(Trip { kind: TripKind::Force, detail: "81.0 N over 80.0 N".into() });
        assert_eq!(shown(&other).0.as_deref(), Some("81.0 N over 80.0 N"));
        let second = stopper.count();
        assert_eq!(shown(&stopped), of_both("emergency stop (local)"), "its body is not read yet");
        stopper.note(second, latched.clone(), latch_words("eve (local)"));
        stopper.note(first, latched, latch_words("ada (local)"));
        assert_eq!(shown(&stopped), of_both("emergency stop (eve (local))"), "a late body");
    }
}
