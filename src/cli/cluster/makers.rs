//! The makers of the chunks of work orders, and a request to stop them.
//! Uses: `chunk`, `kind`. Never: a line of output, a decision about a byte of a chunk.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use super::kind::{ChunkKind, ChunkMeans};
use crate::chunk::MakeChunks;
use crate::chunk::folder::{ChunkState, OrderFolder};
use crate::chunk::order::ChunkRow;
use crate::cli::error::CliResult;
use crate::new_file::Look;

/// What was requested of the work.
#[derive(Debug, Default)]
pub struct StopRequest {
    pub(super) after_chunk: AtomicBool,
    pub(super) within_chunk: AtomicBool,
}

impl StopRequest {
    /// Whether no further chunk must be started.
    pub fn is_after_chunk(&self) -> bool {
        self.after_chunk.load(Ordering::Relaxed)
    }

    /// Whether the present chunk continues.
    pub fn flow(&self) -> ControlFlow<()> {
        match self.within_chunk.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// What makes the chunks of the last work order; it is opened when the first chunk needs it.
pub struct Makers {
    means: ChunkMeans,
    /// Id of the work order, and its maker.
    open: Option<(String, Box<dyn MakeChunks>)>,
}

/// A chunk that is done.
pub struct MadeChunk {
    /// Row of its result in the folder.
    pub row: ChunkRow,
    /// Whether it was made now.
    pub is_new: bool,
}

impl Makers {
    /// Opens nothing yet.
    pub fn new(means: ChunkMeans) -> Self {
        Self { means, open: None }
    }

    /// Makes a chunk, unless it is done and whole; none if it was stopped within it.
    ///
    /// # Errors
    /// `CliError` if there is no such chunk, or it cannot be made or stored.
    pub fn make(
        &mut self,
        folder: &OrderFolder,
        index: u64,
        stop: &StopRequest,
    ) -> CliResult<Option<MadeChunk>> {
        if let ChunkState::Done(row) = folder.state(index, Look::Sha256)? {
            return Ok(Some(MadeChunk { row, is_new: false }));
        }
        let id = &folder.order().id;
        let maker = match self.open.take().filter(|(of, _)| of == id) {
            Some((_, maker)) => maker,
            None => ChunkKind::of(folder)?.open(folder, &self.means)?,
        };
        let (_, maker) = self.open.insert((id.clone(), maker));
        let row = folder.make(index, maker.as_mut(), &mut |_| stop.flow())?;
        Ok(row.map(|row| MadeChunk { row, is_new: true }))
    }
}
