//! Events: as a page, or as server-sent events with sequence numbers and `?since=`.
//! Uses: `store`. Never: a queue per client (each reads the table at its own pace).

use std::convert::Infallible;
use std::time::Duration;

use axum::http::{HeaderMap, header};
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::stream::{self, Stream, StreamExt};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::App;
use super::pages::{Page, PageParams, PageRequest};
use super::problem::{ApiResult, Params};
use super::runs::find;
use crate::event::{self, Importance};
use crate::ids::RunUid;
use crate::journal::{self, error_chain};
use crate::store::StoreError;

/// Number of events per reading of a live stream.
const PIECE_EVENTS: u32 = 200;
/// Interval of reading the table for a live client.
const LIVE_EVENTS_POLL: Duration = Duration::from_millis(200);

/// A record of something that happened, for people: numbered without gaps in the order of storage.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Event {
    /// Number of the event, from 1.
    pub seq: i64,
    /// Run that the event belongs to; null outside a run.
    pub run: Option<RunUid>,
    /// Wall time of the event.
    pub at: Timestamp,
    /// Kind, one of those of `GET /api/v1/vocabulary`: `state`, `trip`, `skipped`, ...
    pub kind: String,
    /// Details, depending on the kind.
    pub data: serde_json::Value,
    /// How much it matters to a person.
    pub importance: Importance,
    /// The event as a sentence.
    pub words: String,
}

impl From<journal::Event> for Event {
    fn from(stored: journal::Event) -> Self {
        let journal::Event { seq, run, at, kind, data } = stored;
        let importance = event::importance(&kind, &data);
        let words = event::words(&kind, &data);
        Self { seq, run, at, kind, data, importance, words }
    }
}

/// Selection of events.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct EventParams {
    /// Only events after this number; a negative number counts from the end of the selected events. Absent: all events
    /// in pages, only new events of a live stream.
    pub since: Option<i64>,
    /// Only events of this run: uid or scan_id.
    pub run: Option<String>,
    /// Only events of these kinds, separated by commas, such as `trip,skipped`. A kind that does not
    /// exist selects nothing.
    pub kind: Option<String>,
}

impl EventParams {
    /// The selected kinds; empty for all.
    fn kinds(&self) -> Vec<String> {
        let listed = self.kind.iter().flat_map(|kinds| kinds.split(','));
        listed.map(str::trim).filter(|kind| !kind.is_empty()).map(str::to_owned).collect()
    }
}

/// Returns a page of events in the order of their numbers, or a live stream.
///
/// With `Accept: text/event-stream` the response is a live stream of server-sent events. Their `id`
/// is the number of the event, with which a reconnecting client continues.
#[utoipa::path(get, path = "/api/v1/events", tag = "events", params(EventParams, PageParams),
    responses((status = 200, body = Page<Event>),
        (status = 404, description = "no run has this uid or scan_id")))]
pub async fn events(
    app: App,
    Params(params): Params<EventParams>,
    asked: PageRequest,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let run = match &params.run {
        Some(run) => Some(find(&app, run).await?.uid),
        None => None,
    };
    let kinds = params.kinds();
    let text = |name| headers.get(name).and_then(|v| v.to_str().ok());
    let live = text(header::ACCEPT).is_some_and(|a| a.contains("text/event-stream"));
    if live {
        let last = text(header::HeaderName::from_static("last-event-id"));
        let since = match last.and_then(|id| id.parse().ok()).or(params.since) {
            Some(since) => resolved(&app, since, run, &kinds).await?,
            None => app.store.last_event_seq().await?,
        };
        let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
        return Ok(Sse::new(follow(app, since, run, kinds)).keep_alive(keep_alive).into_response());
    }
    let since = match asked.after()? {
        Some(last) => last,
        None => resolved(&app, params.since.unwrap_or(0), run, &kinds).await?,
    };
    let events = app.store.events_since(since, asked.limit + 1, run, &kinds).await?;
    let events: Vec<Event> = events.into_iter().map(Event::from).collect();
    Ok(asked.first(events, |event| event.seq).into_response())
}

/// Resolves a negative number, which counts from the end: -30 selects the last 30 events of this run and these kinds.
async fn resolved(app: &App, since: i64, run: Option<RunUid>, kinds: &[String]) -> ApiResult<i64> {
    if since >= 0 {
        return Ok(since);
    }
    Ok(app.store.seq_before_newest(since.unsigned_abs(), run, kinds).await?)
}

/// Polls the table until the service ends or the store fails.
fn follow(
    app: App,
    since: i64,
    run: Option<RunUid>,
    kinds: Vec<String>,
) -> impl Stream<Item = Result<sse::Event, Infallible>> {
    let ending = app.facts.ending.clone();
    stream::unfold(
        (app, since, kinds, ending),
        move |(app, mut since, kinds, mut ending)| async move {
            loop {
                let read = async {
                    // Events that are not of these kinds are not read again.
                    let last = match kinds.is_empty() {
                        true => since,
                        false => app.store.last_event_seq().await?,
                    };
                    Ok((last, app.store.events_since(since, PIECE_EVENTS, run, &kinds).await?))
                };
                let (last, events) = match read.await {
                    Ok(read) => read,
                    Err(error) => {
                        let error: StoreError = error;
                        let error = error_chain(&error);
                        tracing::warn!(error, "an event stream was ended: the store failed");
                        return None;
                    }
                };
                if let Some(last) = events.last() {
                    let next = last.seq;
                    return Some((
                        stream::iter(events.into_iter().map(out)),
                        (app, next, kinds, ending),
                    ));
                }
                since = since.max(last);
                tokio::select! {
                    ended = ending.wait_for(|e| *e) => { let _ = ended; return None; }
                    () = tokio::time::sleep(LIVE_EVENTS_POLL) => {}
                }
            }
        },
    )
    .flatten()
}

fn out(stored: journal::Event) -> Result<sse::Event, Infallible> {
    let event = Event::from(stored);
    let sse = sse::Event::default().id(event.seq.to_string()).event(event.kind.clone());
    // An event is plain JSON: serialisation does not fail.
    Ok(sse.json_data(&event).unwrap_or_default())
}
