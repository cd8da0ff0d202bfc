//! Opening of a wire: Modbus TCP without delay of small packets, or a serial port whose stale bytes
//! are read and dropped.
//! Uses: tokio, tokio-serial, tokio-modbus. Never: requests, retries.

use std::io;
use std::pin::Pin;
use std::time::Duration;

use tokio::io::AsyncReadExt;
use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio::time::Instant;
use tokio_modbus::client::Context;
use tokio_serial::{SerialPort, SerialPortBuilderExt};

use super::port::Port;
use super::swept::Swept;
use crate::plain::system_words;
use crate::rig::wires::Parity;

/// Silence after which a serial line counts as drained. The rest of a late reply arrives within it.
const DRAINED_AFTER: Duration = Duration::from_millis(5);

/// Future that opens a port.
pub type Opening = Pin<Box<dyn Future<Output = io::Result<Box<dyn Port>>> + Send>>;

/// Opens the same port each time it is called.
pub type Opener = Box<dyn FnMut() -> Opening + Send>;

/// Framing of Modbus requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Framing {
    /// With a transaction number and a length.
    Tcp,
    /// With an address and a checksum.
    Rtu,
}

/// What may still arrive on a serial line, and would be taken for the answer to the next request.
#[derive(Debug, Clone, Copy)]
pub(super) struct LateReply {
    /// When it does not arrive any more.
    pub(super) until: Instant,
    /// Whether no other reply is awaited, so that what arrives is this one.
    pub(super) is_only: bool,
}

/// Settings of a serial port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialSettings {
    /// Path of the serial device.
    pub path: String,
    /// Baud rate, bits per second.
    pub baud: u32,
    /// Parity of the line.
    pub parity: Parity,
}

/// Opens a TCP connection with TCP_NODELAY.
pub fn tcp_opener(address: String) -> Opener {
    Box::new(move || {
        let address = address.clone();
        Box::pin(async move {
            let stream = TcpStream::connect(&address).await.map_err(|e| named(&address, &e))?;
            stream.set_nodelay(true)?;
            Ok(Box::new(stream) as Box<dyn Port>)
        })
    })
}

/// Opens a TCP connection for a read-only stream, with a receive buffer of `bytes`. A sender that
/// is faster must drop data, so that buffered data do not become old.
pub fn tcp_stream_opener(address: String, bytes: u32) -> Opener {
    Box::new(move || {
        let address = address.clone();
        Box::pin(async move {
            let mut failed = io::Error::from(io::ErrorKind::NotFound);
            for at in lookup_host(&address).await.map_err(|e| named(&address, &e))? {
                let socket = if at.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
                socket.set_recv_buffer_size(bytes)?;
                match socket.connect(at).await {
                    Ok(stream) => return Ok(Box::new(stream) as Box<dyn Port>),
                    Err(error) => failed = error,
                }
            }
            Err(named(&address, &failed))
        })
    })
}

/// The error of a port, with its address or path.
fn named(port: &str, error: &io::Error) -> io::Error {
    // The library of serial ports has the system's words as its own.
    let words = match error.kind() {
        kind @ (io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied) => {
            system_words(&kind.into())
        }
        _ => system_words(error),
    };
    io::Error::new(error.kind(), format!("{port}: {words}"))
}

/// Opens a serial port. The port is not claimed exclusively: on a pseudo-terminal this claim
/// outlives the process that made it, and the lock file of the rig already excludes other
/// processes.
pub fn serial_opener(settings: SerialSettings) -> Opener {
    Box::new(move || {
        let settings = settings.clone();
        Box::pin(async move {
            let parity = match settings.parity {
                Parity::None => tokio_serial::Parity::None,
                Parity::Even => tokio_serial::Parity::Even,
                Parity::Odd => tokio_serial::Parity::Odd,
            };
            let builder = tokio_serial::new(&settings.path, settings.baud).parity(parity);
            #[cfg_attr(not(unix), expect(unused_mut, reason = "only unix claims ports"))]
            let mut port = builder
                .open_native_async()
                .map_err(|error| named(&settings.path, &io::Error::from(error)))?;
            #[cfg(unix)]
            port.set_exclusive(false)?;
            port.clear(tokio_serial::ClearBuffer::All)?;
            Ok(Box::new(port) as Box<dyn Port>)
        })
    })
}

/// Attaches a Modbus client to a new port. On RTU, where replies have no number, bytes that still
/// arrive in reply to an older request are dropped first, for at most `limit`, and `late` is awaited.
///
/// # Errors
/// A port error, or data that keep arriving.
pub(super) async fn attach(
    mut port: Box<dyn Port>,
    framing: Framing,
    limit: Duration,
    late: Option<LateReply>,
) -> io::Result<Context> {
    match framing {
        Framing::Tcp => Ok(tokio_modbus::client::tcp::attach(port)),
        Framing::Rtu => {
            let wait = late.map_or(Duration::ZERO, |late| left(late.until));
            let drain = drain(&mut port, late);
            tokio::time::timeout(limit + wait, drain).await.map_err(|_| {
                io::Error::new(io::ErrorKind::InvalidData, "data keep arriving on the line")
            })??;
            Ok(tokio_modbus::client::rtu::attach(Swept::new(port)))
        }
    }
}

fn left(until: Instant) -> Duration {
    until.saturating_duration_since(Instant::now())
}

async fn drain(port: &mut Box<dyn Port>, mut late: Option<LateReply>) -> io::Result<()> {
    let mut scrap = [0_u8; 256];
    loop {
        let silence = late.map_or(DRAINED_AFTER, |late| left(late.until).max(DRAINED_AFTER));
        match tokio::time::timeout(silence, port.read(&mut scrap)).await {
            Err(_silent) => return Ok(()),
            Ok(Ok(0)) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(Ok(_)) => late = late.filter(|late| !late.is_only),
            Ok(Err(e)) => return Err(e),
        }
    }
}
