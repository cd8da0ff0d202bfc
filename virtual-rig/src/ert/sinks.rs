//! Receivers of the stream: the clients of a TCP listener, or the process that has opened the
//! pseudo-terminal. The stream never blocks: a slow reader loses packets, a stuck one is
//! disconnected.
//! Uses: std's sockets, tokio-serial. Never: contents of packets, blocking.

use std::io::{ErrorKind, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use tokio_serial::SerialStream;

/// Time without progress after which a client is disconnected.
const STUCK: Duration = Duration::from_secs(5);
/// Largest number of simultaneous clients.
const CLIENTS_MAX: usize = 16;

/// The readers of the stream.
pub enum Sinks {
    /// Clients of a non-blocking listener.
    Tcp {
        /// Listener that accepts the clients.
        listener: TcpListener,
        /// Clients that are connected and receive the stream.
        clients: Vec<Client>,
    },
    /// Master side of a pseudo-terminal.
    Pty(PtySink),
}

/// One TCP reader.
pub struct Client {
    stream: TcpStream,
    tail: Tail,
}

/// Sink that writes to the master side of a pseudo-terminal.
pub struct PtySink {
    master: SerialStream,
    tail: Tail,
}

impl PtySink {
    /// Creates a sink for the master side.
    pub fn new(master: SerialStream) -> Self {
        Self { master, tail: Tail::default() }
    }
}

/// Unsent rest of a batch, so that packets stay complete.
#[derive(Default)]
struct Tail {
    rest: Vec<u8>,
    stuck_since: Option<Instant>,
}

impl Tail {
    /// Writes as much as possible; returns false if the reader is disconnected or stuck.
    fn send(
        &mut self,
        batch: &[u8],
        mut write: impl FnMut(&[u8]) -> std::io::Result<usize>,
    ) -> bool {
        if !self.rest.is_empty() {
            let rest = std::mem::take(&mut self.rest);
            if !self.push(&rest, &mut write) {
                return false;
            }
            if !self.rest.is_empty() {
                let since = *self.stuck_since.get_or_insert_with(Instant::now);
                return self.rest.len() < rest.len() || since.elapsed() < STUCK;
            }
        }
        self.stuck_since = None;
        self.push(batch, &mut write)
    }

    fn push(
        &mut self,
        bytes: &[u8],
        write: &mut impl FnMut(&[u8]) -> std::io::Result<usize>,
    ) -> bool {
        let mut at = 0;
        while at < bytes.len() {
            match write(&bytes[at..]) {
                Ok(0) => return false,
                Ok(n) => at += n,
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        self.rest.extend_from_slice(&bytes[at..]);
        true
    }
}

impl Sinks {
    /// Accepts new readers.
    pub fn accept(&mut self) {
        let Sinks::Tcp { listener, clients } = self else { return };
        while let Ok((stream, _)) = listener.accept() {
            let ready = stream.set_nonblocking(true).and(stream.set_nodelay(true)).is_ok();
            if ready && clients.len() < CLIENTS_MAX {
                clients.push(Client { stream, tail: Tail::default() });
            }
        }
    }

    /// Rejects new readers: the wire is disconnected.
    pub fn reject(&mut self) {
        if let Sinks::Tcp { listener, .. } = self {
            while listener.accept().is_ok() {}
        }
    }

    /// Disconnects every reader.
    pub fn disconnect(&mut self) {
        if let Sinks::Tcp { clients, .. } = self {
            clients.clear();
        }
    }

    /// Number of connected readers.
    pub fn readers(&mut self) -> usize {
        match self {
            Sinks::Tcp { clients, .. } => clients.len(),
            // A pseudo-terminal that no process has opened returns an input error.
            Sinks::Pty(sink) => match sink.master.try_read(&mut [0; 64]) {
                Ok(_) => 1,
                Err(e) => usize::from(e.kind() == ErrorKind::WouldBlock),
            },
        }
    }

    /// Sends complete packets to all readers that can accept them.
    pub fn send(&mut self, batch: &[u8]) {
        match self {
            Sinks::Tcp { clients, .. } => {
                clients.retain_mut(|c| c.tail.send(batch, |bytes| (&c.stream).write(bytes)));
            }
            Sinks::Pty(sink) => {
                let PtySink { master, tail } = sink;
                if !tail.send(batch, |bytes| master.try_write(bytes)) {
                    *tail = Tail::default();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lagging_reader_misses_batches_but_gets_whole_ones() {
        let mut room = 5;
        let mut got = Vec::new();
        let mut tail = Tail::default();
        for (batch, gain) in [(b"aaaa", 0), (b"bbbb", 0), (b"cccc", 2), (b"dddd", 3), (b"eeee", 9)]
        {
            room += gain;
            let alive = tail.send(batch, |bytes| {
                let n = bytes.len().min(room);
                if n == 0 {
                    return Err(ErrorKind::WouldBlock.into());
                }
                room -= n;
                got.extend_from_slice(&bytes[..n]);
                Ok(n)
            });
            assert!(alive);
        }
        assert_eq!(got, b"aaaabbbbddddeeee");
    }
}
