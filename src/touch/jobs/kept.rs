//! The checkpoints of the trainings that were stopped or killed last: the same request again resumes from one.
//! Uses: the folders of jobs. Never: a checkpoint of another order, or of a job that may still run.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::Jobs;
use crate::learn::order::{CHECKPOINT, LOSSES, ORDER};
use crate::new_file;
use crate::store::TaskState;

/// Name of the file that marks the folder of a stopped or killed training.
const KILLED: &str = "killed";

/// Name of the file with the warnings of a training, JSON: they are in its result, also if it resumed.
pub const WARNINGS: &str = "warnings.json";

/// Checkpoints of other trainings that are kept.
const OTHERS_KEPT: usize = 2;

/// Keeps the checkpoint of a stopped or killed training beyond the end of its job, with the last two of others:
/// checkpoints are large. False if it has none.
pub fn keep(folder: &Path) -> bool {
    if !folder.join(CHECKPOINT).exists() {
        return false;
    }
    let mut others = marked(folder.parent().unwrap_or(folder));
    // Their names are in the order of their requests.
    others.sort();
    for other in others.iter().rev().filter(|other| *other != folder).skip(OTHERS_KEPT) {
        fs::remove_file(other.join(CHECKPOINT)).ok();
        fs::remove_file(other.join(KILLED)).ok();
    }
    if let Err(error) = new_file::write(folder, KILLED, "") {
        tracing::warn!(%error, "the checkpoint of a training is not kept");
    }
    is_kept(folder)
}

/// Whether the checkpoint in a folder is to be kept.
pub fn is_kept(folder: &Path) -> bool {
    folder.join(KILLED).exists()
}

/// A job that starts has not been killed, whatever an earlier start of it left.
pub fn unmark(folder: &Path) {
    fs::remove_file(folder.join(KILLED)).ok();
}

/// Moves the checkpoint of an ended job with an equal order into a job's folder.
pub async fn adopt(jobs: &Jobs, folder: &Path, order: &str) {
    for other in marked(&jobs.inner.data.join("jobs")) {
        if fs::read_to_string(other.join(ORDER)).ok().as_deref() != Some(order) {
            continue;
        }
        let name = other.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Ok(id) = name.parse() else { continue };
        let job = jobs.inner.store.task(id).await.ok().flatten();
        let ended = [TaskState::Failed, TaskState::Stopped];
        if job.is_some_and(|job| ended.contains(&job.state)) && take(&other, folder).is_ok() {
            tracing::info!(from = name, "the training resumes from an earlier one's checkpoint");
        }
    }
}

/// Marked folders among those of the jobs.
fn marked(jobs: &Path) -> Vec<PathBuf> {
    let folders = fs::read_dir(jobs).into_iter().flatten().flatten();
    folders.map(|folder| folder.path()).filter(|folder| is_kept(folder)).collect()
}

/// Losses and warnings are copied first: the model's curve would begin at the checkpoint, and a training that resumes
/// does not repeat its warnings.
fn take(from: &Path, to: &Path) -> io::Result<()> {
    if !from.join(CHECKPOINT).exists() {
        return Err(io::ErrorKind::NotFound.into());
    }
    let losses = fs::read(from.join(LOSSES)).unwrap_or_default();
    new_file::write(to, LOSSES, losses)?;
    if let Ok(warnings) = fs::read(from.join(WARNINGS)) {
        new_file::write(to, WARNINGS, warnings)?;
    }
    fs::rename(from.join(CHECKPOINT), to.join(CHECKPOINT))?;
    fs::remove_file(from.join(KILLED))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_checkpoints_are_kept_and_move_with_their_losses() {
        let folder = tempfile::tempdir().unwrap();
        let jobs = folder.path();
        let [first, second, third, fourth, new] =
            ["a", "b", "c", "d", "new"].map(|name| jobs.join(name));
        for (folder, text) in [(&first, "1"), (&second, "2"), (&third, "3"), (&fourth, "4")] {
            new_file::write(folder, CHECKPOINT, text).unwrap();
            new_file::write(folder, LOSSES, text).unwrap();
            new_file::write(folder, WARNINGS, text).unwrap();
            assert!(keep(folder));
        }
        let mut kept = marked(jobs);
        kept.sort();
        assert_eq!(kept, [second.as_path(), &third, &fourth]);
        assert!(!first.join(CHECKPOINT).exists() && first.join(LOSSES).exists());
        take(&second, &new).unwrap();
        let read = |name: &str| fs::read_to_string(new.join(name)).unwrap();
        assert_eq!([CHECKPOINT, LOSSES, WARNINGS].map(read), ["2"; 3]);
        assert!(!is_kept(&second) && second.join(LOSSES).exists());
        assert!(take(&second, &new).is_err());
        assert!(!keep(&second), "it has no checkpoint");
        keep(&new);
        unmark(&new);
        assert!(!is_kept(&new) && new.join(CHECKPOINT).exists());
    }
}
