//! The trials of a run without a current dataset, as Parquet files of 1000 trials, which are kept: a query
//! writes only those whose trials or twins have changed.
//! Uses: `store`, `dataset::{batch, format}`. Never: a piece that changes (its name is a hash of what is
//! in it).

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::dataset::background::background;
use crate::dataset::batch::{self, Row};
use crate::dataset::error::DatasetError;
use crate::dataset::format::{Format, Stream};
use crate::dataset::schema::{self, BATCH_ROWS};
use crate::digest::sha256_hex;
use crate::ids::TrialId;
use crate::new_file::NewFile;
use crate::store::{RunRow, Store, TrialRow};

/// Time for which a piece is kept after it was last used.
const PIECE_KEPT: Duration = Duration::from_secs(3600);
/// Hexadecimal digits of the hash in a name.
const PIECE_DIGITS: usize = 16;

/// Returns the files with the trials of a run, in the order of storing; those that are missing are
/// written to `folder`.
///
/// # Errors
/// `DatasetError` if the store cannot be read, or a file not be written.
pub async fn of_run(
    store: &Store,
    folder: &Path,
    run: &RunRow,
) -> Result<Vec<PathBuf>, DatasetError> {
    let trials = store.newest_twins(run.uid, TrialId(0), u32::MAX).await?;
    let mut files = Vec::new();
    for piece in trials.chunks(BATCH_ROWS) {
        let key = &sha256_hex(format!("{piece:?}"))[..PIECE_DIGITS];
        let name = format!("run-{}-{key}.parquet", run.scan_id);
        let path = folder.join(&name);
        // Used now: it is kept.
        let touched =
            std::fs::File::open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        if touched.is_err() {
            let ids: Vec<TrialId> = piece.iter().map(|(trial, _)| *trial).collect();
            let trials = store.trials_with_voltages(&ids).await?;
            let (folder, name) = (folder.to_owned(), name.clone());
            background(move || write(&folder, &name, trials)).await??;
        }
        files.push(path);
    }
    Ok(files)
}

/// Returns a file with the columns of the table of trials and no rows.
///
/// # Errors
/// `DatasetError` if it cannot be written.
pub fn empty(folder: &Path) -> Result<PathBuf, DatasetError> {
    const EMPTY_PIECE: &str = "no-trials.parquet";
    if !folder.join(EMPTY_PIECE).is_file() {
        write(folder, EMPTY_PIECE, Vec::new())?;
    }
    Ok(folder.join(EMPTY_PIECE))
}

fn write(folder: &Path, name: &str, trials: Vec<TrialRow>) -> Result<(), DatasetError> {
    let frame = trials.iter().find_map(|trial| trial.voltages_v.as_ref().map(Vec::len));
    let table = schema::stored(frame.map_or(schema::PAPER_CHANNELS, |channels| channels as i32));
    let failed = DatasetError::file("writing", &folder.join(name));
    let file = NewFile::create(folder).map_err(&failed)?;
    let mut stream = Stream::new(Format::Parquet, &table, file)?;
    let rows: Vec<Row> = trials.into_iter().map(|trial| Row { trial, part: None }).collect();
    stream.push(&batch::of_trials(&table, &rows)?)?;
    stream.finish()?.finish(name).map_err(failed)?;
    Ok(())
}

/// Removes the pieces that were not used for an hour. Those that cannot be removed now stay.
pub fn trim(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let modified = entry.metadata().and_then(|file| file.modified());
        if modified.is_ok_and(|at| at.elapsed().is_ok_and(|age| age > PIECE_KEPT)) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}
