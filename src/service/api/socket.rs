//! Opens the WebSockets of live data: a limited number of clients for each kind of data; ends slow ones.
//! Uses: `guard`, `limits`. Never: what is sent.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::rejection::ExtensionRejection;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts, State};
use axum::http::StatusCode;
use axum::response::Response;
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tracing::{Instrument, Span};

use super::App;
use super::auth::Caller;
use super::guard::Place;
use super::limits::MESSAGE_MAX_BYTES;
use super::problem::{ApiError, ApiResult};

/// Longest time for sending a message; a slower client is disconnected.
const MESSAGE_WITHIN: Duration = Duration::from_secs(5);

/// Sends a message; returns `false` if the client has gone or was too slow: the socket must be dropped.
pub(super) async fn is_sent(socket: &mut WebSocket, text: Utf8Bytes) -> bool {
    matches!(timeout(MESSAGE_WITHIN, socket.send(Message::Text(text))).await, Ok(Ok(())))
}

/// Extractor of a client that requests live data; a request for no WebSocket is answered with a problem body.
#[derive(FromRequestParts)]
#[from_request(state(App), rejection(ApiError))]
pub struct LiveClient {
    /// The service.
    #[from_request(via(State))]
    pub app: App,
    #[from_request(via(Extension))]
    caller: Caller,
    /// Its place among all connections.
    #[from_request(via(Extension))]
    counted: Option<Place>,
    upgrade: WebSocketUpgrade,
}

impl LiveClient {
    /// Opens the socket and runs `send` on it until it returns, or until the caller's key is revoked.
    ///
    /// # Errors
    /// 503 if `places` has none left; `limit` is their number, `kind` what the clients receive.
    pub(super) fn open<S: Future<Output = ()> + Send>(
        self,
        places: &Arc<Semaphore>,
        (limit, kind): (usize, &str),
        send: impl FnOnce(App, WebSocket) -> S + Send + 'static,
    ) -> ApiResult<Response> {
        let Self { app, caller, counted, upgrade } = self;
        let place = places.clone().try_acquire_owned().map_err(|_| {
            let words = format!("{limit} clients of the {kind} are connected, the limit");
            ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words)
        })?;
        let span = Span::current();
        Ok(upgrade.max_message_size(MESSAGE_MAX_BYTES).on_upgrade(async move |socket| {
            tokio::select! {
                () = send(app.clone(), socket).instrument(span) => {}
                () = app.until_revoked(&caller) => {}
            }
            drop((place, counted));
        }))
    }
}

impl From<ExtensionRejection> for ApiError {
    fn from(rejection: ExtensionRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

impl From<Infallible> for ApiError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}
