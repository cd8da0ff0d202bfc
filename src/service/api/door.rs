//! The door: accepts connections, limits their number and idle time, and reserves some for the
//! e-stop.
//! Uses: hyper for each connection, the router for each request. Never: a connection that is closed
//! while its request is in progress; an exit because a connection could not be accepted; work on
//! this thread that would delay the e-stop.
//!
//! ```text
//! this thread:    accept -> seat -> TLS -> hyper -> router: the e-stop
//!                                             |
//! other threads:            handshakes         +---> router: all other requests (`work`)
//! ```
//! If all seats are taken, the connection that has been idle for longest is closed (`seat`). If all
//! connections are busy, a limited number of further ones is accepted, for the e-stop and /health
//! only.

use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
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
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio::task::{JoinSet, yield_now};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tower_service::Service;

use super::auth::Peer;
use super::limits::{HYPER_FIELDS, YOUNG};
use super::line::{Line, Sent};
use super::problem::ApiError;
use super::seat::{InFlight, Seat, Seats};
use super::work;
use crate::priority;

/// Interval of closing connections that have been idle for too long.
const SWEEP: Duration = Duration::from_secs(1);
/// Wait after a connection could not be accepted because no more files may be open.
const ACCEPT_RETRY: Duration = Duration::from_millis(20);
/// Wanted limit of open files of the process.
const FILES: u64 = 4096;

/// Longest wait for requests in progress when the service ends.
const REQUESTS_END_WAIT: Duration = Duration::from_secs(5);

/// Raises the limit of open files of this process to `FILES`, or as far as the system allows. A
/// failure is only logged.
pub fn raise_file_limit() {
    let now = getrlimit(Resource::Nofile);
    let wanted = now.maximum.map_or(FILES, |most| most.min(FILES));
    if now.current.is_some_and(|current| current < wanted)
        && let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), ..now })
    {
        tracing::warn!(%error, wanted, "the limit of open files was not raised");
    }
}

/// Makes a write beyond the limit of file sizes return an error, as on a full disk, instead of
/// ending the process while tips press. Needs a runtime. A failure is only logged.
pub fn outlive_file_size_limit() {
    if let Err(error) = signal(SignalKind::from_raw(Signal::XFSZ.as_raw())) {
        tracing::warn!(%error, "a write beyond the limit of file sizes would end the process");
    }
}

/// The router, the runtime for requests other than the e-stop, and TLS if it is used.
#[derive(Clone)]
struct Handlers {
    router: Router,
    tls: Option<TlsAcceptor>,
    threads: runtime::Handle,
}

/// Starts the door's thread. It serves until `ending` is true, then waits for requests in progress,
/// at most 5 s, and closes all connections. Requests other than the e-stop run on the current
/// runtime.
///
/// # Errors
/// If the thread or its runtime cannot be started, or the listener cannot be used.
pub fn open(
    listener: std::net::TcpListener,
    router: Router,
    tls: Option<TlsAcceptor>,
    ending: watch::Receiver<bool>,
) -> io::Result<thread::JoinHandle<()>> {
    let handlers = Handlers { router, tls, threads: runtime::Handle::current() };
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
        priority::raise();
        own.block_on(serve(listener, handlers, ending));
        own.shutdown_background();
    })
}

async fn serve(listener: TcpListener, handlers: Handlers, mut ending: watch::Receiver<bool>) {
    let mut seats = Seats::default();
    let mut connections = JoinSet::new();
    let mut sweep = interval(SWEEP);
    sweep.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let until = ending.clone();
    let mut refused = false;
    loop {
        let room = seats.have_room(Instant::now());
        tokio::select! {
            () = ended(&mut ending) => break,
            taken = listener.accept(), if room => match taken {
                Ok((stream, _)) => {
                    refused = false;
                    let seat = seats.take(Instant::now());
                    connections.spawn(attend(stream, seat, handlers.clone(), until.clone()));
                }
                // The client has disconnected already.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Err(error) => {
                    if !std::mem::replace(&mut refused, true) {
                        tracing::warn!(%error, "a connection could not be accepted");
                    }
                    seats.make_room(Instant::now());
                    sleep(ACCEPT_RETRY).await;
                }
            },
            Some(_) = connections.join_next() => {}
            () = seats.one_is_freed(), if !room => {}
            // An idle connection is no longer young.
            () = sleep(YOUNG / 4), if !room => {}
            now = sweep.tick() => seats.sweep(now),
        }
    }
    drop(listener);
    if timeout(REQUESTS_END_WAIT, async { while connections.join_next().await.is_some() {} })
        .await
        .is_err()
    {
        tracing::warn!("connections were closed while a request was in progress");
    }
}

async fn ended(ending: &mut watch::Receiver<bool>) {
    // A dropped sender also means the end of the service.
    let _ = ending.wait_for(|ended| *ended).await;
}

/// Completes when the connection must be closed (`Seat::ends_now`), after one turn of the event loop:
/// before it the runtime may not know yet of bytes that have arrived, and a stop would not be answered.
async fn closed(seat: &Seat) {
    seat.closed().await;
    yield_now().await;
}

/// Serves one connection until its end, or until it has become a WebSocket.
async fn attend(
    stream: TcpStream,
    seat: Arc<Seat>,
    handlers: Handlers,
    mut ending: watch::Receiver<bool>,
) {
    // Without it responses are only delayed slightly.
    let _ = stream.set_nodelay(true);
    let peer = stream.peer_addr().ok().map(|address| Peer(address.ip()));
    let line = Line::new(stream, seat.clone());
    let Some(tls) = handlers.tls.clone() else {
        return converse(line, peer, seat, handlers, ending).await;
    };
    // The cryptography of a handshake takes up to a millisecond: other threads do it. Until its first
    // request the connection is idle: who does not complete the handshake is closed like one who does
    // not complete the head of a request.
    let mut shaking = JoinSet::new();
    shaking.spawn_on(tls.accept(line), &handlers.threads);
    let shaken = tokio::select! {
        biased;
        Some(shaken) = shaking.join_next() => shaken,
        () = seat.closed() => return,
        () = ended(&mut ending) => return,
    };
    match shaken {
        Ok(Ok(line)) => converse(line, peer, seat, handlers, ending).await,
        Ok(Err(error)) => tracing::trace!(%error, "a TLS handshake failed"),
        Err(error) => tracing::error!(%error, "a TLS handshake panicked"),
    }
}

/// Answers the requests of a connection.
async fn converse(
    line: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    peer: Option<Peer>,
    seat: Arc<Seat>,
    handlers: Handlers,
    mut ending: watch::Receiver<bool>,
) {
    let answering = seat.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        if let Some(peer) = peer {
            request.extensions_mut().insert(peer);
        }
        let path = request.uri().path();
        let halts = is_stop(path) || is_halt(path);
        begun(answer(handlers.clone(), answering.clone(), request), halts)
    });
    let mut http = http1::Builder::new();
    http.max_headers(HYPER_FIELDS);
    let connection = http.serve_connection(TokioIo::new(line), service);
    let mut connection = pin!(connection.with_upgrades());
    let mut ends = false;
    loop {
        tokio::select! {
            // In this order: a request that has arrived is answered before the connection closes.
            biased;
            outcome = connection.as_mut() => {
                if let Err(error) = outcome {
                    tracing::trace!(%error, "a connection failed");
                }
                return;
            }
            () = closed(&seat) => if seat.ends_now() { return },
            () = ended(&mut ending), if !ends => {
                ends = true;
                connection.as_mut().graceful_shutdown();
            }
        }
    }
}

/// An answer. That of a request which stops, pauses or ends something is begun `at_once`: hyper drops an answer that it
/// has not polled yet if the client has closed the connection, although head and body have arrived.
fn begun<T>(answer: impl Future<Output = T>, at_once: bool) -> impl Future<Output = T> {
    let mut answer = Box::pin(answer);
    let first = at_once.then(|| answer.as_mut().poll(&mut Context::from_waker(Waker::noop())));
    async move {
        match first {
            Some(Poll::Ready(answered)) => answered,
            Some(Poll::Pending) | None => answer.await,
        }
    }
}

async fn answer(
    handlers: Handlers,
    seat: Arc<Seat>,
    request: Request<Incoming>,
) -> io::Result<Response<Sent>> {
    let request_guard = InFlight::begin(seat.clone());
    let only_for_stops = seat.only_for_stops();
    let Handlers { mut router, threads, .. } = handlers;
    let path = request.uri().path();
    let mut response = if is_stop(path) {
        let Ok(response) = router.call(request).await;
        response.map(|body| Sent::new(body, (request_guard, None)))
    } else if only_for_stops && !path.starts_with("/health/") {
        let words = "all connections are in use: only the e-stop and /health are available; retry";
        let response = ApiError::new(StatusCode::SERVICE_UNAVAILABLE, words).into_response();
        response.map(|body| Sent::new(body, (request_guard, None)))
    } else {
        let halts = is_halt(path);
        let (response, work) = work::handle(&threads, router, request, halts).await?;
        response.map(|body| Sent::new(body, (request_guard, Some(work))))
    };
    if only_for_stops {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if response.status() == StatusCode::SWITCHING_PROTOCOLS {
        seat.upgrade();
    }
    Ok(response)
}

fn is_stop(path: &str) -> bool {
    matches!(path, "/estop" | "/api/v1/estop")
}

/// Whether a request to this address may pause or end a run or a motion.
fn is_halt(path: &str) -> bool {
    let of_run = path.strip_prefix("/api/v1/runs/");
    path == "/api/v1/rig/abort" || of_run.is_some_and(|rest| rest.ends_with("/actions"))
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net;
    use std::sync::atomic::{AtomicBool, Ordering};

    use axum::routing::post;

    use super::*;
    use crate::api::access::Lock;
    use crate::api::limits::HEAD_WITHIN;
    use crate::api::routes::{AllNeeds, table};

    #[test]
    fn what_halts_is_what_waits_for_no_other_request() {
        let all = AllNeeds::of(&table());
        for (_, path, needs) in all.iter() {
            let halts = matches!(needs.lock, Lock::RefusesSome | Lock::Stops);
            assert_eq!(is_halt(path), halts, "{path}");
        }
    }

    #[tokio::test]
    async fn a_stop_and_an_abort_are_carried_out_although_the_client_disconnects_at_once() {
        for (path, body) in [("/estop", ""), ("/api/v1/rig/abort", "{}")] {
            let listener = net::TcpListener::bind("127.0.0.1:0").unwrap();
            let mut client = net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
            let length = format!("content-length: {}", body.len());
            let head = format!("POST {path} HTTP/1.1\r\nhost: localhost\r\n{length}\r\n\r\n");
            client.write_all(format!("{head}{body}").as_bytes()).unwrap();
            let (accepted, _) = listener.accept().unwrap();
            drop(client);
            accepted.set_nonblocking(true).unwrap();
            let carried_out = Arc::<AtomicBool>::default();
            let noted = carried_out.clone();
            let act = move |_: String| async move { noted.store(true, Ordering::SeqCst) };
            let router = Router::new().route(path, post(act));
            let handlers = Handlers { router, tls: None, threads: runtime::Handle::current() };
            let seat = Seats::default().take(Instant::now());
            let (_ending, ends) = watch::channel(false);
            attend(TcpStream::from_std(accepted).unwrap(), seat, handlers, ends).await;
            let is_done = async {
                while !carried_out.load(Ordering::SeqCst) {
                    sleep(Duration::from_millis(1)).await;
                }
            };
            timeout(Duration::from_secs(10), is_done).await.expect(path);
        }
    }

    #[tokio::test]
    async fn a_stop_that_has_arrived_is_answered_although_its_connection_is_closed_unread() {
        let listener = net::TcpListener::bind("127.0.0.1:0").unwrap();
        let mut client = net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        client.write_all(b"POST /estop HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        let (accepted, _) = listener.accept().unwrap();
        accepted.set_nonblocking(true).unwrap();
        let mut seats = Seats::default();
        let seat = seats.take(Instant::now());
        seats.sweep(Instant::now() + 2 * HEAD_WITHIN);
        assert!(seat.ends_now());
        let router = Router::new().route("/estop", post(|| async { "latched" }));
        let handlers = Handlers { router, tls: None, threads: runtime::Handle::current() };
        let (_ending, ends) = watch::channel(false);
        // The runtime has not noticed the request yet: nothing has been awaited.
        attend(TcpStream::from_std(accepted).unwrap(), seat, handlers, ends).await;
        let mut answer = String::new();
        client.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("latched"), "{answer}");
    }
}
