//! The Modbus wires: TCP listeners and pseudo-terminals in front of the lab.
//! Uses: tokio's sockets, tokio-serial, `modbus`, `lab`. Never: meanings of registers.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tokio_serial::SerialStream;

use crate::fault::{Part, WireFault};
use crate::lab::Lab;
use crate::modbus::{Exception, rtu, tcp};

/// Largest number of simultaneous connections of one TCP line.
const CONNECTIONS_MAX: usize = 64;
/// Silence after which the buffer contains the whole frame.
const SILENCE: Duration = Duration::from_millis(20);
/// Pause before the next check whether a process has opened the pseudo-terminal.
const NOBODY: Duration = Duration::from_millis(10);
/// Time without progress after which a client is disconnected.
const WRITE_PATIENCE: Duration = Duration::from_secs(5);

/// Serves one TCP line until the task is aborted.
pub async fn serve_tcp(lab: Arc<Lab>, line: String, listener: TcpListener) {
    let seats = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(NOBODY).await;
            continue;
        };
        let cut = lab.bench().disconnected(&line, lab.clock.process_s());
        let seat = Arc::clone(&seats).try_acquire_owned();
        let Ok(seat) = seat.map_err(|e| tracing::debug!(%peer, error = %e, "no seat")) else {
            continue;
        };
        if cut || stream.set_nodelay(true).is_err() {
            continue;
        }
        let (lab, line) = (Arc::clone(&lab), line.clone());
        tokio::spawn(async move {
            if let Err(error) = serve_connection(&lab, &line, stream).await {
                tracing::debug!(%peer, line, %error, "connection ended");
            }
            drop(seat);
        });
    }
}

async fn serve_connection(lab: &Lab, line: &str, mut stream: TcpStream) -> io::Result<()> {
    let mut buffer = Vec::with_capacity(512);
    loop {
        while let Some(adu) = tcp::take(&mut buffer).map_err(io::Error::other)? {
            let served = lab.serve(line, adu.unit, &adu.pdu);
            // An address without a device is reported by the gateway.
            let function = adu.pdu.first().copied().unwrap_or(0);
            let nobody = || vec![function | 0x80, Exception::NoTarget.code()];
            let reply = tcp::frame(&adu, &served.answer.unwrap_or_else(nobody));
            if !deliver(&mut stream, reply, served.fault, garble_tcp).await? {
                return Ok(());
            }
        }
        if stream.read_buf(&mut buffer).await? == 0 {
            return Ok(());
        }
    }
}

/// Sends a reply as a fault of the wire leaves it; returns whether the connection continues.
async fn deliver(
    wire: &mut (impl AsyncWriteExt + Unpin),
    mut reply: Vec<u8>,
    fault: Option<WireFault>,
    garble: fn(&mut Vec<u8>, Part),
) -> io::Result<bool> {
    match fault {
        None | Some(WireFault::Exception(_)) => {}
        Some(WireFault::Late { delay_ms }) => {
            tokio::time::sleep(Duration::from_millis(delay_ms)).await;
        }
        Some(WireFault::NoReply { .. }) => return Ok(true),
        Some(WireFault::Disconnect { .. }) => return Ok(false),
        Some(WireFault::Garbled(part)) => garble(&mut reply, part),
    }
    timeout(WRITE_PATIENCE, wire.write_all(&reply)).await.map_err(io::Error::other)??;
    Ok(true)
}

fn garble_tcp(frame: &mut Vec<u8>, part: Part) {
    match part {
        Part::Header => frame[1] ^= 0x55,
        Part::Payload => flip_last(frame, 0),
        Part::Cut => frame.truncate(frame.len() - 1),
    }
}

fn garble_rtu(frame: &mut Vec<u8>, part: Part) {
    match part {
        Part::Header => flip_last(frame, 0),
        Part::Payload => flip_last(frame, 2),
        Part::Cut => frame.truncate(frame.len() - 1),
    }
}

/// Flips a bit of the byte at `before_end` before the last one.
fn flip_last(bytes: &mut [u8], before_end: usize) {
    let at = bytes.len().saturating_sub(1 + before_end);
    bytes[at] ^= 0x10;
}

/// Serves one bus on a pseudo-terminal until the task is aborted.
pub async fn serve_rtu(lab: Arc<Lab>, line: String, mut master: SerialStream) {
    let mut buffer = Vec::with_capacity(512);
    let mut quiet = false;
    loop {
        let read = match timeout(SILENCE, master.read_buf(&mut buffer)).await {
            Ok(read) => Some(read),
            Err(_) if buffer.is_empty() && !quiet => Some(master.read_buf(&mut buffer).await),
            Err(_) => None,
        };
        match read {
            // No process has opened the other end.
            Some(Err(_) | Ok(0)) => {
                buffer.clear();
                tokio::time::sleep(NOBODY).await;
                continue;
            }
            // After a garbled frame a device receives again after a silence of the line.
            Some(Ok(_)) if quiet => {
                buffer.clear();
                continue;
            }
            Some(Ok(_)) => {}
            None => quiet = false,
        }
        let line_state = match read {
            Some(_) => rtu::LineState::Receiving,
            None => rtu::LineState::Silent,
        };
        loop {
            match rtu::take(&mut buffer, line_state) {
                rtu::Taken::Incomplete => break,
                rtu::Taken::Garbled => {
                    quiet = read.is_some();
                    break;
                }
                rtu::Taken::Request(adu) => {
                    let served = lab.serve(&line, adu.unit, &adu.pdu);
                    let Some(pdu) = served.answer else { continue };
                    let reply = rtu::frame(adu.unit, &pdu);
                    let sent = deliver(&mut master, reply, served.fault, garble_rtu).await;
                    if let Err(error) = sent {
                        tracing::debug!(line, %error, "answer not delivered");
                    }
                }
            }
        }
    }
}
