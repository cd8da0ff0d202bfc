//! Requests carried out on other threads than the door's, and their answers on the way back to it.
//! Uses: the router, a runtime. Never: more than a few pieces of an answer ahead of its client.

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

/// Pieces of an answer that may wait for the door.
const PIECES_AHEAD: usize = 2;

/// The task that makes an answer; it ends when this is dropped.
pub struct Work {
    _task: JoinSet<()>,
}

/// Carries a request out on a runtime. A body that is made piece by piece is made there, too, as
/// its client takes it. Fails when the handler panicked, or the runtime has ended.
pub async fn carry_out(
    runtime: &Handle,
    mut router: Router,
    request: Request<Incoming>,
) -> io::Result<(Response<Body>, Work)> {
    let (answer, answered) = oneshot::channel();
    let mut task = JoinSet::new();
    let work = async move {
        let Ok(response) = router.call(request).await;
        if response.body().size_hint().exact().is_some() {
            // It is all there. The asker may have gone.
            let _ = answer.send(response);
            return;
        }
        let (head, body) = response.into_parts();
        let (pieces, taken) = mpsc::channel(PIECES_AHEAD);
        let body_there = Body::from_stream(ReceiverStream::new(taken));
        if answer.send(Response::from_parts(head, body_there)).is_err() {
            return;
        }
        let mut body = body.into_data_stream();
        while let Some(piece) = body.next().await {
            if pieces.send(piece).await.is_err() {
                return;
            }
        }
    };
    task.spawn_on(work, runtime);
    let response = answered.await.map_err(|_| io::Error::other("a request was given up"))?;
    Ok((response, Work { _task: task }))
}
