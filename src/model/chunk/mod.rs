//! Bulk work in chunks: parts whose bytes follow from their work order and their index alone, made by any process
//! on any machine, each written once under a key of its contents.
//! Uses: `difference`, `digest`, `new_file`, threads. Never: what a chunk contains (its kind knows it), a queue, the network.
//!
//! A kind of chunks has a definition (a JSON value that determines every byte), a number of chunks, and a
//! [`MakeChunks`]. Sim-Random's is `simulate::random::chunks`, that of twins `simulate::twins::chunks`.

use std::error::Error;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::thread;

pub mod error;
pub mod order;
pub mod skin;
pub mod folder;

use crate::new_file::NewFile;

/// Why the bytes of a chunk could not be made.
pub type MakeFailure = Box<dyn Error + Send + Sync>;

/// Receives the number of rows, or of other parts, that are done; what it breaks off is not made.
pub type Tell<'a> = dyn FnMut(u64) -> ControlFlow<()> + 'a;

/// A chunk that was written, with its number of rows; none if it was broken off.
pub type WrittenChunk = Result<Option<(NewFile, u64)>, MakeFailure>;

/// What makes the chunks of one work order.
pub trait MakeChunks: Send {
    /// Writes the bytes of a chunk to `out`; returns it with the number of rows. While rows are written `tell`
    /// receives their number; if it breaks off, none is returned.
    ///
    /// # Errors
    /// The failure of the kind.
    fn write(&mut self, index: u64, out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk;
}

/// Makes the rows of some inputs, a share of them on each thread; returns the rows in the order of the inputs.
///
/// # Errors
/// The first error of `make`, as text; another one if it panics.
pub fn in_shares<I: Sync, R: Send>(
    inputs: &[I],
    threads: NonZeroUsize,
    make: impl Fn(&[I]) -> Result<Vec<R>, String> + Sync,
) -> Result<Vec<R>, String> {
    let (share, make) = (inputs.len().div_ceil(threads.get()).max(1), &make);
    thread::scope(|scope| {
        let making: Vec<_> =
            inputs.chunks(share).map(|inputs| scope.spawn(move || make(inputs))).collect();
        // All are joined, also after an error: else the scope would panic if a later one has.
        let shares: Vec<_> = making.into_iter().map(|thread| thread.join()).collect();
        let mut rows = Vec::with_capacity(inputs.len());
        for share in shares {
            let panicked = |_| Err("a thread that makes a chunk panicked".to_owned());
            rows.extend(share.unwrap_or_else(panicked)?);
        }
        Ok(rows)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_in_the_order_of_the_inputs_and_a_panic_is_an_error() {
        let threads = NonZeroUsize::new(3).unwrap();
        let make = |inputs: &[u32]| -> Result<Vec<u32>, String> {
            match inputs[0] {
                10 => Err("refused".to_owned()),
                20 => panic!("a thread of this test"),
                _ => Ok(inputs.to_vec()),
            }
        };
        let numbers: Vec<u32> = (0..8).collect();
        assert_eq!(in_shares(&numbers, threads, make), Ok(numbers));
        assert_eq!(in_shares(&[], threads, make), Ok(vec![]));
        // The first of them is stated.
        assert_eq!(in_shares(&[10, 20], threads, make), Err("refused".to_owned()));
        let panicked = in_shares(&[20, 10], threads, make).unwrap_err();
        assert!(panicked.contains("panicked"), "{panicked}");
    }
}
