//! The door: takes connections in, bounds how many there are and how long they may wait, and keeps
//! places that nobody can fill but who wants to stop the rig.
//! Uses: hyper for each connection, the router for each request. Never: a connection that is cut
//! while its request is under way; an end because a connection could not be taken; work on this
//! thread that a stop would wait for.
//!
//! ```text
//! this thread: accept -> seat -> hyper -> router: the stop
//!                                   |
//! the others:                       +---> router: all else (`work`)
//! ```
//! When it is full, the connection that has waited longest without a request makes room (`seat`);
//! when all are busy, some more are taken in, which reach only the stop and /health.

use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use axum::Router;
use axum::http::{HeaderValue, Request, Response, StatusCode, header};
use axum::response::IntoResponse;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use rustix::process::{Resource, Rlimit, Signal, getrlimit, setrlimit};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tower_service::Service;

use super::line::{Line, Sent};
use super::problem::ApiError;
use super::seat::{Asking, Seat, Seats};
use super::work;

/// How often those that have waited too long are looked for.
const SWEEP: Duration = Duration::from_secs(1);
/// Wait after a connection could not be taken: the process or the machine has no more files.
const RETRY: Duration = Duration::from_millis(20);
/// Files that the process may have open, where the system lets it: connections, and what reads them.
const FILES: u64 = 4096;

/// Longest wait for requests that are under way when the service ends.
const FAREWELL: Duration = Duration::from_secs(5);

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

/// From now on a write beyond a limit of file sizes fails with an error, as on a full disk, instead of
/// ending the process with tips pressed. Needs a runtime; a failure is only logged.
pub fn outlive_file_size_limit() {
    if let Err(error) = signal(SignalKind::from_raw(Signal::XFSZ.as_raw())) {
        tracing::warn!(%error, "a limit of file sizes would end the process");
    }
}

/// What carries requests out.
#[derive(Clone)]
struct House {
    router: Router,
    threads: runtime::Handle,
}

/// Starts the door's thread: it answers until `ending` says so, then lets requests that are under
/// way be answered and cuts the rest. All but the stop is carried out on the caller's runtime.
pub fn open(
    listener: std::net::TcpListener,
    router: Router,
    ending: watch::Receiver<bool>,
) -> io::Result<thread::JoinHandle<()>> {
    let house = House { router, threads: runtime::Handle::current() };
    let own = runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = {
        let _inside = own.enter();
        TcpListener::from_std(listener)
    };
    let listener = match listener {
        Ok(listener) => listener,
        Err(error) => {
            own.shutdown_background();
            return Err(error);
        }
    };
    thread::Builder::new().name("door".into()).spawn(move || {
        own.block_on(serve(listener, house, ending));
        own.shutdown_background();
    })
}

async fn serve(listener: TcpListener, house: House, mut ending: watch::Receiver<bool>) {
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
                    connections.spawn(attend(stream, seat, house.clone(), until.clone()));
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
            now = sweep.tick() => seats.sweep(now),
        }
    }
    drop(listener);
    if timeout(FAREWELL, async { while connections.join_next().await.is_some() {} }).await.is_err()
    {
        tracing::warn!("some connections were cut");
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
    house: House,
    mut ending: watch::Receiver<bool>,
) {
    // Without it answers are only a little later.
    let _ = stream.set_nodelay(true);
    let answering = seat.clone();
    let service = service_fn(move |request| answer(house.clone(), answering.clone(), request));
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
    house: House,
    seat: Arc<Seat>,
    request: Request<Incoming>,
) -> io::Result<Response<Sent>> {
    let asking = Asking::begin(seat.clone());
    let House { mut router, threads } = house;
    let path = request.uri().path();
    let mut response = if is_stop(path) {
        let Ok(response) = router.call(request).await;
        response.map(|body| Sent::new(body, asking, None))
    } else if seat.reserved() && !path.starts_with("/health/") {
        let words = "all connections are in use; this one reaches only the stop and /health";
        let response = ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words).into_response();
        response.map(|body| Sent::new(body, asking, None))
    } else {
        let (response, work) = work::carry_out(&threads, router, request).await?;
        response.map(|body| Sent::new(body, asking, Some(work)))
    };
    if seat.reserved() {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if response.status() == StatusCode::SWITCHING_PROTOCOLS {
        seat.keep();
    }
    Ok(response)
}

fn is_stop(path: &str) -> bool {
    matches!(path, "/estop" | "/api/v1/estop")
}
