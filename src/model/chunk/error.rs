//! Errors of work orders and of their chunks.
//! Uses: thiserror. Never: exit codes, logging.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use super::MakeFailure;
use super::order::ranges;
use crate::plain::{counted, system_words};
use crate::problem::Problem;

/// Why the folder of a work order could not be written or read, or a chunk could not be made.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ChunkError {
    #[error(
        "{folder}: has no order.json; name a folder that `palpate cluster sbatch` has written",
        folder = folder.display()
    )]
    NoOrder { folder: PathBuf },
    /// The work order is invalid, or this program does not make its chunks.
    #[error("{folder}: {problem}", folder = folder.display())]
    Order { folder: PathBuf, problem: Box<Problem> },
    #[error(
        "{folder} contains another work order: {field} = {there}, requested {here}; name another \
         folder, or use the same options",
        folder = folder.display()
    )]
    OtherOrder { folder: PathBuf, field: String, there: String, here: String },
    #[error("index = {index}: must be from 0 to {last}")]
    Index { index: u64, last: u64 },
    #[error("{operation} {path}: {}", system_words(source), path = path.display())]
    File { operation: &'static str, path: PathBuf, source: io::Error },
    #[error("chunk {index}: {source}")]
    Make { index: u64, source: MakeFailure },
    #[error(
        "chunk {index} was repeated and has sha256 {now}, but {path} states {before}: the same order must \
         give the same bytes; if that file is wrong, remove it",
        path = path.display()
    )]
    NotReproduced { index: u64, path: PathBuf, before: String, now: String },
    #[error("{folder} is not complete\n{gaps}\n{}", gaps.remedy(folder), folder = folder.display())]
    Incomplete { folder: PathBuf, gaps: Box<Gaps> },
}

impl ChunkError {
    /// Returns a conversion from an I/O error of an operation on a file.
    pub fn file(
        operation: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { operation, path, source }
    }

    /// Error of the work order in a folder.
    pub fn order(folder: &Path, problem: Problem) -> Self {
        Self::Order { folder: folder.into(), problem: Box::new(problem) }
    }

    /// Whether it concerns one chunk, so that others may still be made.
    pub fn is_of_one_chunk(&self) -> bool {
        matches!(self, Self::File { .. } | Self::Make { .. } | Self::NotReproduced { .. })
    }
}

/// What keeps a work order from being gathered.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Gaps {
    /// Indexes of the chunks that were not made, ascending.
    pub missing: Vec<u64>,
    /// Chunks whose results are damaged: index, and what is wrong.
    pub damaged: Vec<(u64, String)>,
    /// Files among the results that belong to no chunk of the order.
    pub foreign: Vec<String>,
}

/// Largest number of damaged results or foreign files that are listed one by one.
const LISTED_GAPS: usize = 20;

impl Gaps {
    /// Whether nothing is missing, damaged or foreign.
    pub fn is_empty(&self) -> bool {
        self.missing.is_empty() && self.damaged.is_empty() && self.foreign.is_empty()
    }

    /// The commands that close them.
    fn remedy(&self, folder: &Path) -> String {
        let folder = folder.display();
        let damaged: String = self.damaged.iter().map(|(index, _)| format!(" {index}")).collect();
        match (self.missing.is_empty(), self.damaged.is_empty()) {
            (_, false) => {
                format!("make again what is damaged: palpate cluster make {folder}{damaged}")
            }
            (false, true) => {
                format!("how to make what is missing: palpate cluster status {folder}")
            }
            (true, true) => "then gather again".into(),
        }
    }
}

impl fmt::Display for Gaps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines = Vec::new();
        if !self.missing.is_empty() {
            let count = counted(self.missing.len() as u64, "chunk is", "chunks are");
            lines.push(format!("{count} missing: {}", ranges(&self.missing)));
        }
        for (index, why) in self.damaged.iter().take(LISTED_GAPS) {
            lines.push(format!("chunk {index} is damaged: {why}"));
        }
        for name in self.foreign.iter().take(LISTED_GAPS) {
            lines.push(format!(
                "{name} belongs to no chunk of this order: it is of another order or of other code; remove it"
            ));
        }
        let unlisted = [self.damaged.len(), self.foreign.len()];
        let unlisted: usize = unlisted.map(|count| count.saturating_sub(LISTED_GAPS)).iter().sum();
        if unlisted > 0 {
            lines.push(format!("{unlisted} more"));
        }
        f.write_str(&lines.join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_named_and_long_lists_are_cut() {
        let damaged = (0..22).map(|index| (index, "too short".to_owned())).collect();
        let gaps = Gaps { missing: vec![3, 7, 8, 9], damaged, foreign: vec!["results/a".into()] };
        let text = gaps.to_string();
        assert!(text.starts_with("4 chunks are missing: 3,7-9\nchunk 0 is damaged: too short\n"));
        assert!(text.contains("\nresults/a belongs to no chunk"), "{text}");
        assert!(text.ends_with("\n2 more"), "{text}");
        assert_eq!(text.lines().count(), 1 + 20 + 1 + 1);
        assert!(Gaps::default().is_empty() && !gaps.is_empty());
    }
}
