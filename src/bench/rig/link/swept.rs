//! A port that discards stale bytes before a request is sent, and does not wait until the request is on the line.
//! Uses: tokio's io traits. Never: waits, frames.
//!
//! RTU replies have no number. If a reply came so late that its repetition was answered too, the
//! second answer would be taken for the reply to the next request, and every later reading would be
//! delayed by one. Bytes that have arrived before a request is written are therefore dropped.
//!
//! The flush of a serial port blocks its thread until the last byte is on the line: 8 ms for a read at 9600 baud, and
//! without an end if the adapter hangs. All wires share this thread with the stops: nothing is flushed, and the
//! deadline of the reply counts from the write.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::port::Port;

/// A port that discards stale bytes at the first write after a read.
#[derive(Debug)]
pub(super) struct Swept {
    port: Box<dyn Port>,
    /// Whether the bytes were discarded for the request that is being written.
    swept: bool,
}

impl Swept {
    /// Wraps a port.
    pub(super) fn new(port: Box<dyn Port>) -> Self {
        Self { port, swept: false }
    }

    /// Drops the bytes that can be read without waiting.
    fn sweep(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        let mut scrap = [0; 256];
        loop {
            let mut stale = ReadBuf::new(&mut scrap);
            match Pin::new(&mut self.port).poll_read(cx, &mut stale) {
                Poll::Pending => return Ok(()),
                Poll::Ready(Ok(())) if stale.filled().is_empty() => {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                Poll::Ready(Ok(())) => {}
                Poll::Ready(Err(error)) => return Err(error),
            }
        }
    }
}

impl AsyncRead for Swept {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.swept = false;
        Pin::new(&mut self.port).poll_read(cx, buf)
    }
}

impl AsyncWrite for Swept {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<io::Result<usize>> {
        if !self.swept {
            self.sweep(cx)?;
            self.swept = true;
        }
        Pin::new(&mut self.port).poll_write(cx, buf)
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};

    /// A port whose flush would block the thread.
    #[derive(Debug)]
    struct Blocking(DuplexStream);

    impl AsyncRead for Blocking {
        fn poll_read(
            mut self: Pin<&mut Self>,
            cx: &mut Context<'_>,
            buf: &mut ReadBuf<'_>,
        ) -> Poll<io::Result<()>> {
            Pin::new(&mut self.0).poll_read(cx, buf)
        }
    }

    impl AsyncWrite for Blocking {
        fn poll_write(
            mut self: Pin<&mut Self>,
            cx: &mut Context<'_>,
            buf: &[u8],
        ) -> Poll<io::Result<usize>> {
            Pin::new(&mut self.0).poll_write(cx, buf)
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            panic!("the thread is blocked");
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            panic!("the thread is blocked");
        }
    }

    #[tokio::test]
    async fn a_request_blocks_no_thread_until_its_bytes_are_sent() {
        let (ours, mut theirs) = tokio::io::duplex(64);
        let mut port = Swept::new(Box::new(Blocking(ours)));
        port.write_all(b"request").await.unwrap();
        port.flush().await.unwrap();
        let mut request = [0; 7];
        theirs.read_exact(&mut request).await.unwrap();
        assert_eq!(&request, b"request");
    }

    #[tokio::test]
    async fn what_came_unasked_is_dropped_and_what_answers_is_read() {
        let (ours, mut theirs) = tokio::io::duplex(64);
        let mut port = Swept::new(Box::new(ours));
        theirs.write_all(b"stale").await.unwrap();
        port.write_all(b"request").await.unwrap();
        theirs.write_all(b"reply").await.unwrap();
        let mut answer = [0; 5];
        port.read_exact(&mut answer).await.unwrap();
        assert_eq!(&answer, b"reply");
        drop(theirs);
        assert!(port.write_all(b"request").await.is_err());
    }
}
