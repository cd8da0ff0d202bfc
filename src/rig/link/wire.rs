//! Opening a wire: Modbus TCP with its small packets sent at once, or a serial port whose old bytes
//! are read away first.
//! Uses: tokio, tokio-serial, tokio-modbus. Never: requests, retries.

use std::fmt;
use std::io;
use std::pin::Pin;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite};
use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio_modbus::client::Context;
use tokio_serial::{SerialPort, SerialPortBuilderExt};

use super::swept::Swept;
use crate::rig::config::Parity;

/// Silence after which a serial line counts as drained. The late rest of a reply comes within it.
const DRAINED_AFTER: Duration = Duration::from_millis(5);

/// A byte stream in both directions.
pub trait Port: AsyncRead + AsyncWrite + Unpin + Send + fmt::Debug {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send + fmt::Debug> Port for T {}

/// A future that opens a port.
pub type Opening = Pin<Box<dyn Future<Output = io::Result<Box<dyn Port>>> + Send>>;

/// Opens the same port again and again.
pub type Opener = Box<dyn FnMut() -> Opening + Send>;

/// How Modbus wraps its requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Framing {
    /// With a transaction number and a length.
    Tcp,
    /// With an address and a checksum.
    Rtu,
}

/// A serial port's settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialSettings {
    /// Device path.
    pub path: String,
    /// Bits per second.
    pub baud: u32,
    /// Parity.
    pub parity: Parity,
}

/// Opens a TCP connection with TCP_NODELAY.
pub fn tcp_opener(address: String) -> Opener {
    Box::new(move || {
        let address = address.clone();
        Box::pin(async move {
            let stream = TcpStream::connect(address).await?;
            stream.set_nodelay(true)?;
            Ok(Box::new(stream) as Box<dyn Port>)
        })
    })
}

/// Opens a TCP connection for a stream that is read only, with a receive buffer of `bytes`: what
/// does not fit is the sender's to drop, instead of growing old in ours.
pub fn tcp_stream_opener(address: String, bytes: u32) -> Opener {
    Box::new(move || {
        let address = address.clone();
        Box::pin(async move {
            let mut failed = io::Error::from(io::ErrorKind::NotFound);
            for at in lookup_host(address).await? {
                let socket = if at.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
                socket.set_recv_buffer_size(bytes)?;
                match socket.connect(at).await {
                    Ok(stream) => return Ok(Box::new(stream) as Box<dyn Port>),
                    Err(error) => failed = error,
                }
            }
            Err(failed)
        })
    })
}

/// Opens a serial port. The port is not claimed exclusively: on a pseudo-terminal that claim
/// outlives the process that made it, and the rig's lock file already keeps others away.
pub fn serial_opener(settings: SerialSettings) -> Opener {
    Box::new(move || {
        let settings = settings.clone();
        Box::pin(async move {
            let parity = match settings.parity {
                Parity::None => tokio_serial::Parity::None,
                Parity::Even => tokio_serial::Parity::Even,
                Parity::Odd => tokio_serial::Parity::Odd,
            };
            let builder = tokio_serial::new(settings.path, settings.baud).parity(parity);
            #[cfg_attr(not(unix), expect(unused_mut, reason = "only unix claims ports"))]
            let mut port = builder.open_native_async()?;
            #[cfg(unix)]
            port.set_exclusive(false)?;
            port.clear(tokio_serial::ClearBuffer::All)?;
            Ok(Box::new(port) as Box<dyn Port>)
        })
    })
}

/// A Modbus client on a fresh port. On RTU, which numbers nothing, what is still coming in answer
/// to an older request is read away first; `limit` bounds that.
pub(super) async fn attach(
    mut port: Box<dyn Port>,
    framing: Framing,
    limit: Duration,
) -> io::Result<Context> {
    match framing {
        Framing::Tcp => Ok(tokio_modbus::client::tcp::attach(port)),
        Framing::Rtu => {
            let drain = drain(&mut port);
            tokio::time::timeout(limit, drain).await.map_err(|_| {
                io::Error::new(io::ErrorKind::InvalidData, "the line does not fall silent")
            })??;
            Ok(tokio_modbus::client::rtu::attach(Swept::new(port)))
        }
    }
}

async fn drain(port: &mut Box<dyn Port>) -> io::Result<()> {
    let mut scrap = [0_u8; 256];
    loop {
        match tokio::time::timeout(DRAINED_AFTER, port.read(&mut scrap)).await {
            Err(_silent) => return Ok(()),
            Ok(Ok(0)) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(Ok(_)) => {}
            Ok(Err(e)) => return Err(e),
        }
    }
}
