//! A reader that ends with an error when a line of a text is too long.
//! Uses: std, the error of this folder. Never: a text that grows in memory without a bound.
//!
//! The parser of lines holds a whole line, and a quotation mark without its pair makes the rest of a file one
//! line. The owner renews the allowance after each line.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::invalid;

/// Largest length of a line, bytes: 65 536 voltages of 25 characters, twice, fit.
pub(super) const LINE_MAX_BYTES: u64 = 16 << 20;

/// Number of bytes that may be read until the next line begins.
#[derive(Debug, Clone)]
pub(super) struct Allowance(Arc<AtomicU64>);

impl Allowance {
    /// Allows a whole line again.
    pub(super) fn renew(&self) {
        self.0.store(LINE_MAX_BYTES, Ordering::Relaxed);
    }
}

/// A reader with an allowance.
#[derive(Debug)]
pub(super) struct LineLimit<R> {
    inner: R,
    left: Allowance,
}

impl<R: Read> LineLimit<R> {
    /// Returns the reader and its allowance, of one line.
    pub(super) fn new(inner: R) -> (Self, Allowance) {
        let left = Allowance(Arc::new(AtomicU64::new(LINE_MAX_BYTES)));
        (Self { inner, left: left.clone() }, left)
    }
}

impl<R: Read> Read for LineLimit<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(into)?;
        let left = self.left.0.load(Ordering::Relaxed);
        let left = left.checked_sub(read as u64).ok_or_else(|| {
            invalid(format!(
                "a line is longer than {LINE_MAX_BYTES} bytes; is a quotation mark without its pair?"
            ))
        })?;
        self.left.0.store(left, Ordering::Relaxed);
        Ok(read)
    }
}
