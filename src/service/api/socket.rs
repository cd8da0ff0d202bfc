//! Opens the WebSockets of live data: a limited number of clients for each kind of data; ends slow ones.
//! Uses: `guard`, `limits`. Never: what is sent.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::rejection::ExtensionRejection;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts, State};
use axum::response::Response;
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tracing::{Instrument, Span};

use super::App;
use super::auth::Caller;
use super::guard::Place;
use super::limits::MESSAGE_MAX_BYTES;
use super::problem::{ApiError, ApiResult};
use super::turns::place;

/// Longest time for sending a message; a slower client is disconnected.
const MESSAGE_WITHIN: Duration = Duration::from_secs(5);

/// Sends a message; returns `false` if the client has gone or was too slow: the socket must be dropped.
pub(super) async fn is_sent(socket: &mut WebSocket, text: Utf8Bytes) -> bool {
    matches!(timeout(MESSAGE_WITHIN, socket.send(Message::Text(text))).await, Ok(Ok(())))
}

/// Completes when the client closes the socket; its other messages are ignored.
pub(super) async fn closed(socket: &mut WebSocket) {
    while let Some(Ok(message)) = socket.recv().await {
        if matches!(message, Message::Close(_)) {
            return;
        }
    }
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
    /// As [`place`].
    pub(super) fn open<S: Future<Output = ()> + Send>(
        self,
        places: &Arc<Semaphore>,
        clients: (usize, &str),
        send: impl FnOnce(App, WebSocket) -> S + Send + 'static,
    ) -> ApiResult<Response> {
        let Self { app, caller, counted, upgrade } = self;
        let place = place(places, clients)?;
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
