//! The door: takes connections in, bounds how many there are and how long they may wait, and keeps
//! places that nobody can fill but who wants to stop the rig.
//! Uses: hyper for each connection, the router for each request. Never: a connection that is cut
//! while its request is under way; an end because a connection could not be taken.
//!
//! ```text
//! accept -> seat -> hyper -> router
//!   full: the connection that has waited longest without a request makes room (`seat`);
//!   all busy: some more are taken in, which reach only the stop and /health
//! ```

use std::convert::Infallible;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::http::{HeaderValue, Request, Response, StatusCode, header};
use axum::response::IntoResponse;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, sleep};
use tower_service::Service;

use super::line::{Line, Sent};
use super::problem::ApiError;
use super::seat::{Asking, Seat, Seats};

/// How often those that have waited too long are looked for.
const SWEEP: Duration = Duration::from_secs(1);
/// Wait after a connection could not be taken: the process or the machine has no more files.
const RETRY: Duration = Duration::from_millis(20);
/// Files that the process may have open, where the system lets it: connections, and what reads them.
const FILES: u64 = 4096;

/// Raises the number of files that this process may have open towards `FILES`, as far as the system
/// allows; a failure is only logged.
pub fn raise_file_limit() {
    let now = getrlimit(Resource::Nofile);
    let wanted = now.maximum.map_or(FILES, |most| most.min(FILES));
    if now.current.is_some_and(|current| current < wanted)
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), ..now })
    {
        tracing::warn!(%error, wanted, "the limit of open files stays as it is");
    }
}

/// Answers until `ending` says so, then lets requests that are under way be answered. Whoever drops
/// the future cuts what is left.
pub async fn serve(listener: TcpListener, router: Router, mut ending: watch::Receiver<bool>) {
    let mut seats = Seats::default();
    let mut connections = JoinSet::new();
    let mut sweep = interval(SWEEP);
    sweep.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let until = ending.clone();
    let mut refused = false;
    loop {
        let room = seats.have_room();
        tokio::select! {
            () = ended(&mut ending) => break,
            taken = listener.accept(), if room => match taken {
                Ok((stream, _)) => {
                    refused = false;
                    let seat = seats.take();
                    connections.spawn(attend(stream, seat, router.clone(), until.clone()));
                }
                // The client has gone again.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Err(error) => {
                    if !std::mem::replace(&mut refused, true) {
                        tracing::warn!(%error, "a connection could not be taken");
                    }
                    seats.make_room();
                    sleep(RETRY).await;
                }
            },
            Some(_) = connections.join_next() => {}
            () = seats.one_is_freed(), if !room => {}
            _ = sweep.tick() => seats.sweep(),
        }
    }
    drop(listener);
    loop {
        tokio::select! {
            gone = connections.join_next() => if gone.is_none() { return },
            _ = sweep.tick() => seats.sweep(),
        }
    }
}

async fn ended(ending: &mut watch::Receiver<bool>) {
    // A service that has gone has ended, too.
    let _ = ending.wait_for(|ended| *ended).await;
}

/// One connection until its end, or until it has become a WebSocket.
async fn attend(
    stream: TcpStream,
    seat: Arc<Seat>,
    router: Router,
    mut ending: watch::Receiver<bool>,
) {
    // Without it answers are only a little later.
    let _ = stream.set_nodelay(true);
    let answering = seat.clone();
    let service = service_fn(move |request| answer(router.clone(), answering.clone(), request));
    let io = TokioIo::new(Line { stream, seat: seat.clone() });
    let mut connection = pin!(http1::Builder::new().serve_connection(io, service).with_upgrades());
    let mut told = false;
    loop {
        tokio::select! {
            outcome = connection.as_mut() => {
                if let Err(error) = outcome {
                    tracing::trace!(%error, "a connection failed");
                }
                return;
            }
            // A request may have come in the meantime: it is answered.
            () = seat.dismissed() => if seat.is_leaving() { return },
            () = ended(&mut ending), if !told => {
                told = true;
                connection.as_mut().graceful_shutdown();
            }
        }
    }
}

async fn answer(
    mut router: Router,
    seat: Arc<Seat>,
    request: Request<Incoming>,
) -> Result<Response<Sent>, Infallible> {
    let asking = Asking::begin(seat.clone());
    let mut response = if seat.reserved() && !is_for_all_seats(request.uri().path()) {
        let words = "all connections are in use; this one reaches only the stop and /health";
        ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words).into_response()
    } else {
        router.call(request).await?
    };
    if seat.reserved() {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if response.status() == StatusCode::SWITCHING_PROTOCOLS {
        seat.keep();
    }
    Ok(response.map(|body| Sent::new(body, asking)))
}

fn is_for_all_seats(path: &str) -> bool {
    matches!(path, "/estop" | "/api/v1/estop" | "/health/live" | "/health/ready")
}
