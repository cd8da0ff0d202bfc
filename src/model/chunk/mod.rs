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

/// What makes the chunks of one work order.
pub trait MakeChunks: Send {
    /// Writes the bytes of a chunk to `out`; returns it with the number of rows. While rows are written `tell`
    /// receives their number; if it breaks off, none is returned.
    ///
    /// # Errors
    /// The failure of the kind.
    fn write(
        &mut self,
        index: u64,
        out: NewFile,
        tell: &mut dyn FnMut(u64) -> ControlFlow<()>,
    ) -> Result<Option<(NewFile, u64)>, MakeFailure>;
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
        let mut rows = Vec::with_capacity(inputs.len());
        for thread in making {
            let panicked = |_| Err("a thread that makes a chunk panicked".to_owned());
            rows.extend(thread.join().unwrap_or_else(panicked)?);
        }
        Ok(rows)
    })
}
