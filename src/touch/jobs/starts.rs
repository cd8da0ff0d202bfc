//! Number of starts of a job without progress: a job that crashes the service must not do so
//! forever.
//! Uses: a file in the job's folder. Never: the store, a clock.

use std::path::{Path, PathBuf};

use crate::new_file;

/// Name of the file with the number of starts since the last progress.
const STARTS: &str = "starts";
/// Number of starts without progress after which a job fails.
pub const STARTS_MAX: u32 = 5;

/// The starts of one job.
#[derive(Debug, Clone)]
pub struct Starts {
    folder: PathBuf,
}

impl Starts {
    /// Starts of the job whose files are in a folder.
    pub fn of(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// Counts a start; returns `false` if the limit was reached. If the count cannot be written,
    /// the job starts nevertheless.
    pub fn begin(&self) -> bool {
        let path = self.folder.join(STARTS);
        let known = std::fs::read_to_string(&path).ok().and_then(|text| text.trim().parse().ok());
        let before: u32 = known.unwrap_or(0);
        let kept = new_file::write(&self.folder, STARTS, (before + 1).to_string());
        if let Err(error) = kept {
            tracing::warn!(%error, path = %path.display(), "a job's start was not counted");
        }
        before < STARTS_MAX
    }

    /// Resets the count: the job made progress, has ended, or was stopped in order.
    pub fn got_on(&self) {
        std::fs::remove_file(self.folder.join(STARTS)).ok();
        // Removes the folder only if it is empty.
        std::fs::remove_dir(&self.folder).ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_that_never_gets_on_is_given_up_and_one_that_does_is_not() {
        let folder = std::env::temp_dir().join(format!("palpate-starts-{}", std::process::id()));
        let begin = || Starts::of(&folder).begin();
        for _ in 0..STARTS_MAX {
            assert!(begin());
        }
        assert!(!begin());
        std::fs::write(folder.join("checkpoint.bin"), "kept").expect("a file");
        Starts::of(&folder).got_on();
        assert!(begin());
        assert!(folder.join("checkpoint.bin").exists());
        std::fs::remove_file(folder.join("checkpoint.bin")).expect("the file");
        Starts::of(&folder).got_on();
        assert!(!folder.exists());
    }
}
