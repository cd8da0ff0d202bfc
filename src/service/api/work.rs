//! Handles requests on other threads than the door's, and returns their responses to it.
//! Uses: the router, a runtime. Never: more than a few pieces of a response ahead of its client.

use std::io;

use axum::Router;
use axum::body::{Body, HttpBody};
use axum::http::{Request, Response};
use futures::StreamExt;
use hyper::body::Incoming;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio_stream::wrappers::ReceiverStream;
use tower_service::Service;
use tracing::{Instrument, Span};

/// Largest number of pieces of a response that wait for the door.
const PIECES_AHEAD: usize = 2;

/// The task that produces a response; it is aborted when this value is dropped, unless it halts what moves.
pub struct Work {
    _task: JoinSet<()>,
}

/// Handles a request on a runtime. A streamed body is also produced there, at the pace of its
/// client. `halts`: whether it may pause or end what moves: once its body has arrived it is carried out, also if its
/// client disconnects.
///
/// # Errors
/// If the handler panics, or the runtime has ended.
pub async fn handle(
    runtime: &Handle,
    mut router: Router,
    request: Request<Incoming>,
    halts: bool,
) -> io::Result<(Response<Body>, Work)> {
    let (answer, answered) = oneshot::channel();
    let mut task = JoinSet::new();
    let work = async move {
        let Ok(response) = router.call(request).await;
        if response.body().size_hint().exact().is_some() {
            // The body is complete. The caller may have been dropped.
            let _ = answer.send(response);
            return;
        }
        let (mut head, body) = response.into_parts();
        let span = head.extensions.remove::<Span>().unwrap_or_else(Span::none);
        let (pieces, taken) = mpsc::channel(PIECES_AHEAD);
        let streamed = Body::from_stream(ReceiverStream::new(taken));
        if answer.send(Response::from_parts(head, streamed)).is_err() {
            return;
        }
        let mut body = body.into_data_stream();
        let streaming = async {
            while let Some(piece) = body.next().await {
                if pieces.send(piece).await.is_err() {
                    return;
                }
            }
        };
        streaming.instrument(span).await;
    };
    if halts {
        runtime.spawn(work);
    } else {
        task.spawn_on(work, runtime);
    }
    let response =
        answered.await.map_err(|_| io::Error::other("a request ended without a response"))?;
    Ok((response, Work { _task: task }))
}
