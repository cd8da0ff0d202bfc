//! Bodies of requests: their announced length, and the pace at which they must arrive.
//! Uses: axum, `limits`. Never: what a body means.

use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::http::{HeaderMap, header};
use futures::StreamExt;
use tokio::time::{Instant, timeout_at};

use super::limits::BODY_STALL;

/// Returns the length of the body, bytes, if the head of the request announces it.
pub fn announced_bytes(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// A body that fails if no byte arrives for `BODY_STALL`, or if it is not complete in time.
pub fn paced(body: Body, within: Duration) -> Body {
    if body.is_end_stream() {
        return body;
    }
    let until = Instant::now() + within;
    let pieces = futures::stream::try_unfold(body.into_data_stream(), move |mut body| async move {
        let deadline = until.min(Instant::now() + BODY_STALL);
        match timeout_at(deadline, body.next()).await {
            Ok(piece) => Ok(piece.transpose()?.map(|piece| (piece, body))),
            Err(_) => Err(axum::Error::new(TooSlow)),
        }
    });
    Body::from_stream(pieces)
}

/// A body arrived too slowly.
#[derive(Debug, thiserror::Error)]
#[error("the body arrived too slowly: its next bytes are due within {} s", BODY_STALL.as_secs())]
pub struct TooSlow;
