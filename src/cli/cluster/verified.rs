//! Progress of the verification of chunks.
//! Uses: `progress`, indicatif. Never: a chunk.

use indicatif::ProgressBar;

use crate::cli::progress::{LogLines, progress_bar};

/// Number of verified chunks, on a bar or as lines.
pub struct Verified {
    bar: ProgressBar,
    lines: LogLines,
    verified: u64,
    chunks: u64,
}

impl Verified {
    /// None of these chunks.
    pub fn of(chunks: u64) -> Self {
        let bar = progress_bar("chunks");
        bar.set_length(chunks);
        Self { lines: LogLines::instead_of(&bar), bar, verified: 0, chunks }
    }

    /// Counts a chunk.
    pub fn one(&mut self) {
        self.verified += 1;
        self.bar.inc(1);
        let (verified, chunks) = (self.verified, self.chunks);
        self.lines.say(|| format!("{verified}/{chunks} chunks"));
    }
}

impl Drop for Verified {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
