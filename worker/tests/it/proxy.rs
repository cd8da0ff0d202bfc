//! A network between worker and queue that can be cut and stalled.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{sleep, spawn};
use std::time::Duration;

/// A proxy in front of a port of this machine.
pub struct Proxy {
    pub port: u16,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    /// Number of cuts: a connection that began before the last one ends.
    cuts: AtomicU64,
    /// Whether bytes wait.
    stalled: AtomicBool,
}

impl Proxy {
    /// Starts a proxy, which ends with the process.
    pub fn start(to: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let state = Arc::new(State::default());
        let of_proxy = state.clone();
        spawn(move || {
            for client in listener.incoming().flatten() {
                let state = of_proxy.clone();
                let Ok(server) = TcpStream::connect(("127.0.0.1", to)) else { continue };
                let (back, forth) = (server.try_clone().unwrap(), client.try_clone().unwrap());
                let of_forth = state.clone();
                spawn(move || pass(client, server, &of_forth));
                spawn(move || pass(back, forth, &state));
            }
        });
        Self { port, state }
    }

    /// Ends all connections.
    pub fn cut(&self) {
        self.state.cuts.fetch_add(1, Ordering::SeqCst);
    }

    /// Holds all bytes for a time, without an end of the connections.
    pub fn stall(&self, time: Duration) {
        self.state.stalled.store(true, Ordering::SeqCst);
        sleep(time);
        self.state.stalled.store(false, Ordering::SeqCst);
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, state: &State) {
    let began = state.cuts.load(Ordering::SeqCst);
    from.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let mut buffer = [0; 16 << 10];
    while state.cuts.load(Ordering::SeqCst) == began {
        if state.stalled.load(Ordering::SeqCst) {
            sleep(Duration::from_millis(20));
            continue;
        }
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(length) => {
                while state.stalled.load(Ordering::SeqCst) {
                    sleep(Duration::from_millis(20));
                }
                if to.write_all(&buffer[..length]).is_err() {
                    break;
                }
            }
            // Nothing was sent for a moment.
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    drop(from.shutdown(Shutdown::Both));
    drop(to.shutdown(Shutdown::Both));
}
