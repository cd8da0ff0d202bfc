//! Import of trials measured elsewhere: a file (Parquet, CSV, NPZ, MAT) becomes a separate run.
//! Uses: `store::imports`, `source`. Never: HTTP; an incomplete import that counts as a run.

pub mod coordinates;
pub mod extent;
pub mod sensor;
pub mod rows;
mod columns;
mod foreign;
mod pages;
pub mod source;
pub mod summary;

use std::fs::File;
use std::path::Path;
use std::sync::atomic::Ordering::Relaxed;

use tokio::sync::mpsc;

use super::background::background;
use super::build::Progress;
use super::error::{DatasetError, DatasetResult, Product};
use super::space::Space;
use crate::digest::{Hashing, ID_DIGITS, sha256_hex};
use crate::ids::RunUid;
use crate::journal::error_chain;
use crate::problem::Problem;
use crate::store::{
    IMPORTED_MODEL, ImportedTrial, Label, NewRun, NewTwinModel, RunKind, RunRow, Store, TwinModelId,
};
use coordinates::Coordinates;
use rows::Reader;
use sensor::ImportedSensor;
use source::Source;
use summary::Summary;

/// Number of trials per transaction.
const BATCH_TRIALS: usize = 500;

/// Request for an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Import {
    /// Name of the experiment.
    pub name: String,
    /// Origin of the data.
    pub label: Label,
    /// Name of the file in messages.
    pub file: String,
    /// Name of the sensor file in messages.
    pub sensor_file: String,
    /// Text of the sensor file.
    pub sensor: String,
    /// Map from the coordinates of the file to those of the skin.
    pub coordinates: Coordinates,
    /// Name of the person or key that requested the import.
    pub submitted_by: String,
}

/// Result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The run that holds the trials.
    pub run: RunRow,
    /// Number of trials.
    pub trials: u64,
    /// Columns of the file that were ignored.
    pub columns_left_out: Vec<String>,
}

/// Imports a file as a run. The file is read twice: it is checked completely before the first trial
/// is stored. If it fails later, no trial of it stays. `free`: free space of the disk, bytes. `progress`: the trials
/// stored, and all, once they are counted.
///
/// # Errors
/// `DatasetError::Problems` if sensor file, columns or values are invalid, or the file has no
/// trials; `Imported` if it was imported before; `DiskFull` if its trials would need the space that is reserved for runs; `File` or
/// `Parquet` if the file cannot be read; `Store` if the store fails.
pub async fn import(
    store: &Store,
    path: &Path,
    import: Import,
    free: u64,
    progress: &Progress,
) -> DatasetResult<Imported> {
    let sensor = ImportedSensor::from_toml(&import.sensor_file, &import.sensor)
        .map_err(DatasetError::Problems)?;
    let checked = {
        let (path, file, sensor) = (path.to_owned(), import.file.clone(), sensor.clone());
        let map = import.coordinates;
        background(move || check(&path, &file, &sensor, map, free, &Progress::default())).await??
    };
    let new = new_run(&import, &sensor, &checked);
    if let Some(run) = store.imported_as(&new).await? {
        return Err(DatasetError::Imported(run));
    }
    let begun = store.begin_import(new).await?;
    progress.total.store(checked.summary.rows, Relaxed);
    let stored: DatasetResult<RunRow> = async {
        let model = match checked.simulated {
            true => Some(model(store, &checked.sha256, &begun).await?),
            false => None,
        };
        store_trials(store, path, &import, &sensor, begun.uid, model, progress).await?;
        let ended = store.end_import(begun.uid).await?;
        // The file was imported twice at once.
        if ended.uid == begun.uid { Ok(ended) } else { Err(DatasetError::Imported(ended.scan_id)) }
    }
    .await;
    if stored.is_err()
        && let Err(error) = store.discard_import(begun.uid).await
    {
        let error = error_chain(&error);
        tracing::warn!(error, "the trials of a failed import are removed at the next start");
    }
    Ok(Imported {
        run: stored?,
        trials: checked.summary.rows,
        columns_left_out: checked.summary.columns_left_out,
    })
}

/// Checks a file as an import does, and returns what it understood; nothing is stored. `sensor` is the text
/// of the sensor file; `file` and `sensor_file` are names in messages. `progress`: the trials read, and all.
///
/// # Errors
/// As [`import`], except those of the store and the disk.
pub fn preview(
    path: &Path,
    file: &str,
    sensor_file: &str,
    sensor: &str,
    coordinates: Coordinates,
    progress: &Progress,
) -> DatasetResult<Summary> {
    let sensor = ImportedSensor::from_toml(sensor_file, sensor).map_err(DatasetError::Problems)?;
    let checked = check(path, file, &sensor, coordinates, u64::MAX, progress)?;
    Ok(checked.summary)
}

/// Result of the first reading of a file.
struct Checked {
    summary: Summary,
    simulated: bool,
    sha256: String,
}

fn check(
    path: &Path,
    file: &str,
    sensor: &ImportedSensor,
    map: Coordinates,
    free: u64,
    progress: &Progress,
) -> DatasetResult<Checked> {
    let source = Source::open(path, file)?;
    let mut reader = Reader::new(file, sensor, map);
    reader.check(source.schema()).map_err(DatasetError::Problems)?;
    // A few bytes of a compressed file may stand for any number of values.
    let rows = source.extent().rows();
    progress.total.store(rows, Relaxed);
    let needed = source.extent().needed(file, sensor).map_err(DatasetError::Problems)?;
    Space { needed, free }.check(Product::Import)?;
    let mut hashing = Hashing::default();
    let mut bytes = File::open(path).map_err(DatasetError::file("opening", path))?;
    std::io::copy(&mut bytes, &mut hashing).map_err(DatasetError::file("reading", path))?;
    let (columns, columns_left_out) = rows::columns(source.schema());
    let summary = Summary { columns, columns_left_out, ..Summary::default() };
    let mut checked = Checked { summary, simulated: false, sha256: hashing.finish() };
    for batch in source.batches()? {
        let trials = reader.read(&batch?).map_err(DatasetError::Problems)?;
        trials.iter().for_each(|trial| checked.summary.add(trial));
        checked.simulated |= trials.iter().any(|trial| trial.sim_voltages_v.is_some());
        progress.done.store(checked.summary.rows, Relaxed);
        if checked.summary.rows > rows {
            return Err(whole(file, "must not hold more rows than its footer states"));
        }
    }
    if checked.summary.rows == 0 {
        return Err(whole(file, "must hold at least one trial"));
    }
    Ok(checked)
}

fn whole(file: &str, limit: impl Into<String>) -> DatasetError {
    DatasetError::Problems(vec![Problem::whole(file, limit)])
}

fn new_run(import: &Import, sensor: &ImportedSensor, checked: &Checked) -> NewRun {
    let mut definition = serde_json::json!({
        "imported": import.file, "sha256": checked.sha256, "trials": checked.summary.rows,
        "sensor": sensor.name, "columns_left_out": checked.summary.columns_left_out,
    });
    // An import without a map has the definition that it had before there were maps.
    if import.coordinates != Coordinates::default() {
        definition["coordinates"] = serde_json::json!(import.coordinates);
    }
    NewRun {
        uid: RunUid::new(),
        experiment: import.name.clone(),
        kind: RunKind::Imported,
        definition: definition.to_string(),
        seed: None,
        rig: None,
        sensor: import.sensor.clone(),
        calibration_id: None,
        label: import.label,
        version: env!("CARGO_PKG_VERSION").into(),
        git_commit: crate::commit::known().map(Into::into),
        // Contacts are used as they are in the file.
        deadband_n: 0.0,
        tip_diameter_mm: sensor.tip_diameter_mm,
        plan: None,
        trials_planned: checked.summary.rows,
        auto_resume: false,
        not_before: None,
        submitted_by: import.submitted_by.clone(),
    }
}

/// Stores a model that stands for the origin of the file's simulated frames, and returns its id.
async fn model(store: &Store, sha256: &str, run: &RunRow) -> DatasetResult<TwinModelId> {
    let digest = sha256_hex(format!("{IMPORTED_MODEL} {sha256}"));
    let new = NewTwinModel {
        hash: format!("sim-{}", &digest[..ID_DIGITS]),
        sensor_sha256: run.sensor_sha256.clone(),
        calibration_id: None,
        version: IMPORTED_MODEL.into(),
        git_commit: None,
    };
    Ok(store.twin_model(new).await?)
}

/// Stores the trials of a file in a run; `model`: that of the simulated frames, if the file has some.
async fn store_trials(
    store: &Store,
    path: &Path,
    import: &Import,
    sensor: &ImportedSensor,
    run: RunUid,
    model: Option<TwinModelId>,
    progress: &Progress,
) -> DatasetResult<()> {
    let (sender, mut pages) = mpsc::channel::<Vec<ImportedTrial>>(2);
    let (path, file, sensor) = (path.to_owned(), import.file.clone(), sensor.clone());
    let map = import.coordinates;
    let reading = background(move || -> DatasetResult<()> {
        let mut reader = Reader::new(&file, &sensor, map);
        for batch in Source::open(&path, &file)?.batches()? {
            let trials = reader.read(&batch?).map_err(DatasetError::Problems)?;
            if sender.blocking_send(trials).is_err() {
                break;
            }
        }
        Ok(())
    });
    let storing = async {
        while let Some(trials) = pages.recv().await {
            let stored = trials.len() as u64;
            store.import_trials(run, model, trials).await?;
            progress.done.fetch_add(stored, Relaxed);
        }
        // Dropped here, so that the reader also ends if storing fails.
        drop(pages);
        Ok::<(), DatasetError>(())
    };
    let (read, stored) = futures::join!(reading, storing);
    stored?;
    read?
}
