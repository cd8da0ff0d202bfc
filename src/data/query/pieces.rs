//! The trials of a run without a current dataset, as Parquet files of 1000 trials and for the rest of 100,
//! which are kept: a query writes only those whose trials or twins have changed. During a run that is the
//! last one, and a trial's commit must not wait for it: no piece is synced to the disk.
//! Uses: `store`, `dataset::{batch, format, space}`. Never: a piece that changes (its name is a hash of what is
//! in it), a piece of an earlier process (one that a power failure has cut would be read as it is).

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::dataset::background::background;
use crate::dataset::batch::{self, Row};
use crate::dataset::error::{DatasetError, DatasetResult, Product};
use crate::dataset::format::{Format, Stream};
use crate::dataset::schema::{self, BATCH_ROWS};
use crate::dataset::space::{Space, row_bytes};
use crate::digest::sha256_hex;
use crate::ids::TrialId;
use crate::new_file::NewFile;
use crate::store::{RunRow, Store, TrialRow};

/// Rows of a piece of the rest.
const REST_ROWS: usize = 100;
/// Time for which a piece of 1000 trials is kept after it was last used.
const PIECE_KEPT: Duration = Duration::from_secs(3600);
/// Time for which another file is kept: longer than a query, which may still open it. During a run each
/// further trial makes another one.
const REST_KEPT: Duration = Duration::from_secs(180);
/// Start of the names of the pieces of 1000 trials.
const WHOLE: &str = "run-";
/// Hexadecimal digits of the hash in a name.
const PIECE_DIGITS: usize = 16;

/// Returns the files with the trials of a run, in the order of storing; those that are missing are
/// written to `folder`.
///
/// # Errors
/// `DatasetError` if the store cannot be read, or a file not be written without the space that is reserved for runs.
pub async fn of_run(store: &Store, folder: &Path, run: &RunRow) -> DatasetResult<Vec<PathBuf>> {
    let trials = store.newest_twins(run.uid, TrialId(0), u32::MAX).await?;
    let mut files = Vec::new();
    for piece in cut(&trials) {
        let numbers = piece.iter().flat_map(|(trial, model)| [trial.0, *model]);
        let bytes: Vec<u8> = numbers.flat_map(i64::to_le_bytes).collect();
        let key = &sha256_hex(bytes)[..PIECE_DIGITS];
        let start = if piece.len() == BATCH_ROWS { WHOLE } else { "rest-of-run-" };
        let name = format!("{start}{}-{key}.parquet", run.scan_id);
        let path = folder.join(&name);
        // Used now: it is kept.
        let touched =
            std::fs::File::open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        if touched.is_err() {
            let ids: Vec<TrialId> = piece.iter().map(|(trial, _)| *trial).collect();
            let trials = store.trials_with_voltages(&ids).await?;
            let (folder, name, free) = (folder.to_owned(), name.clone(), store.free_bytes().await?);
            background(move || write(&folder, &name, trials, free)).await??;
        }
        files.push(path);
    }
    Ok(files)
}

/// Cuts a list into pieces of 1000, and the rest into pieces of 100.
fn cut<T>(list: &[T]) -> impl Iterator<Item = &[T]> {
    let (whole, rest) = list.split_at(list.len() - list.len() % BATCH_ROWS);
    whole.chunks(BATCH_ROWS).chain(rest.chunks(REST_ROWS))
}

/// Returns a file with the columns of the table of trials and no rows.
///
/// # Errors
/// `DatasetError` if it cannot be written.
pub fn empty(folder: &Path) -> DatasetResult<PathBuf> {
    const EMPTY_PIECE: &str = "no-trials.parquet";
    // Without rows it needs no room.
    write(folder, EMPTY_PIECE, Vec::new(), u64::MAX)?;
    Ok(folder.join(EMPTY_PIECE))
}

/// Writes a piece. `free` is the free space of the disk, bytes.
fn write(folder: &Path, name: &str, trials: Vec<TrialRow>, free: u64) -> DatasetResult<()> {
    let frame = trials.iter().find_map(|trial| trial.voltages_v.as_ref().map(Vec::len));
    let table = schema::stored(frame.map_or(schema::PAPER_CHANNELS, |channels| channels as i32));
    let needed = trials.len() as u64 * row_bytes(&table, Format::Parquet);
    Space { needed, free }.check(Product::Piece)?;
    let failed = DatasetError::file("writing", &folder.join(name));
    let file = NewFile::create(folder).map_err(&failed)?;
    let mut stream = Stream::new(Format::Parquet, &table, file)?;
    let rows: Vec<Row> = trials.into_iter().map(|trial| Row { trial, part: None }).collect();
    stream.push(&batch::of_trials(&table, &rows)?)?;
    stream.finish()?.finish_unsynced(name).map_err(failed)
}

/// Removes the files of an earlier process.
pub fn clear(folder: &Path) {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            tracing::warn!(%error, folder = %folder.display(), "files of queries were not removed");
        }
        _ => {}
    }
}

/// Removes the files that were not used for an hour, and the short ones that were not used for three
/// minutes. Those that cannot be removed now stay.
pub fn trim(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let is_whole = entry.file_name().to_string_lossy().starts_with(WHOLE);
        let kept = if is_whole { PIECE_KEPT } else { REST_KEPT };
        let modified = entry.metadata().and_then(|file| file.modified());
        if modified.is_ok_and(|at| at.elapsed().is_ok_and(|age| age > kept)) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::space::KEPT_FREE_BYTES;

    #[test]
    fn no_piece_is_written_into_the_space_of_runs() {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("pieces");
        let written = |free| write(&folder, "run-1-a.parquet", Vec::new(), free);
        let full = written(KEPT_FREE_BYTES - 1).unwrap_err();
        assert!(matches!(full, DatasetError::DiskFull { .. }), "{full}");
        assert!(!folder.exists());
        written(KEPT_FREE_BYTES).unwrap();
        assert!(folder.join("run-1-a.parquet").is_file());
    }

    #[test]
    fn a_further_trial_changes_a_short_piece_only() {
        let lengths = |trials: usize| -> Vec<usize> {
            let list: Vec<usize> = (0..trials).collect();
            let pieces: Vec<&[usize]> = cut(&list).collect();
            assert_eq!(pieces.concat(), list);
            pieces.iter().map(|piece| piece.len()).collect()
        };
        assert_eq!(lengths(2245), [1000, 1000, 100, 100, 45]);
        assert_eq!(lengths(2246), [1000, 1000, 100, 100, 46]);
        assert_eq!(lengths(1000), [1000]);
        assert!(lengths(0).is_empty());
    }

    #[test]
    fn unused_pieces_go_the_short_ones_first() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        for (name, age_s) in [
            ("run-1-a.parquet", 0),
            ("run-1-b.parquet", 600),
            ("run-1-c.parquet", 4000),
            ("rest-of-run-1-a.parquet", 100),
            ("rest-of-run-1-b.parquet", 600),
        ] {
            let file = std::fs::File::create(folder.join(name)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
        }
        trim(folder);
        let entries = std::fs::read_dir(folder).unwrap();
        let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut left: Vec<String> = entries.map(|entry| name(entry.unwrap())).collect();
        left.sort();
        assert_eq!(left, ["rest-of-run-1-a.parquet", "run-1-a.parquet", "run-1-b.parquet"]);
        clear(folder);
        assert!(!folder.exists());
        clear(folder);
    }
}
