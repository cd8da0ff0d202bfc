//! Sim-Random (paper IV-B): free trials in bulk, as Parquet shards whose bytes are determined by
//! their definition alone.
//! Uses: sim-core, `simulate::schema`, threads. Never: a clock, the order in which threads finish.
//!
//! `draw -> simulate -> encode` makes a row group on one thread; the calling thread appends row
//! groups in order and makes each complete shard durable (`folder`). Row group n is made by thread
//! n mod threads and waits in that thread's bounded queue: memory depends on the number of threads
//! alone, and no reordering is needed.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use sim_core::batch::{BatchModel, BatchWork};
use sim_core::sensor::Sensor;

pub mod draw;
pub mod encode;
pub mod error;
pub mod folder;
pub mod manifest;

use encode::{Encoder, Layout, RowGroup, Trials};
use error::RandomError;
use folder::{Folder, Look};
use manifest::{Definition, Manifest, Shard, ShardRow};

/// Number of row groups that a thread may be ahead of the file.
const GROUPS_AHEAD: usize = 2;

/// Progress of the generation.
#[derive(Debug, Clone, Copy)]
pub enum Progress<'a> {
    /// Result of the check of existing shards, before the first new trial.
    Found {
        /// Number of trials in valid shards.
        trials: u64,
        /// Number of shards whose files are missing or damaged, and which are repeated.
        damaged: u64,
    },
    /// Number of further trials that are made.
    Made(u64),
    /// A shard is durable.
    Shard(&'a ShardRow),
}

/// End of the generation.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// All shards exist.
    Complete(Manifest),
    /// It was stopped on request; the same call resumes it.
    Stopped(Manifest),
}

/// Resources of the generation: they do not change a byte.
#[derive(Debug, Clone, Copy)]
pub struct Means<'a> {
    /// Number of threads that simulate.
    pub threads: NonZeroUsize,
    /// Depth of the check of existing shards.
    pub look: Look,
    /// Set by another thread to stop after the current shard.
    pub stop: &'a AtomicBool,
}

/// Makes the shards of a definition that are not in the folder.
///
/// `model` must be the one of the definition, for this sensor. If the process is killed at any
/// instant, the same call resumes after the last shard in the manifest.
///
/// # Errors
/// `RandomError` if the folder is in use or of another definition, or a shard cannot be made.
pub fn generate(
    definition: &Definition,
    sensor: &Sensor,
    model: &BatchModel,
    folder: &Path,
    means: Means<'_>,
    tell: &mut dyn FnMut(Progress<'_>),
) -> Result<Outcome, RandomError> {
    let folder = Folder::take(folder)?;
    let mut manifest = folder.manifest(definition)?;
    if manifest.sensor_file.is_none() {
        manifest.sensor_file = Some(sensor.file.clone());
        folder.write_manifest(&manifest)?;
    }
    let missing = missing(definition, &manifest, &folder, means.look, tell)?;
    let columns_failed =
        |source| RandomError::Encode { file: "the shards' columns".into(), source };
    let layout = Layout::new(definition, sensor.channels(), sensor.file.tip_diameter_mm)
        .map_err(columns_failed)?;
    let encoder = layout.encoder().map_err(columns_failed)?;
    let maker = Maker { definition, sensor, model, encoder };
    let complete = thread::scope(|scope| -> Result<bool, RandomError> {
        let threads = means.threads.get();
        let queues: Vec<Receiver<Made>> = (0..threads)
            .map(|thread| {
                let (give, take) = sync_channel(GROUPS_AHEAD);
                let share =
                    missing.iter().flat_map(|s| s.row_groups()).skip(thread).step_by(threads);
                let maker = &maker;
                scope.spawn(move || maker.make_all(share, &give));
                take
            })
            .collect();
        let mut made = queues.iter().cycle();
        for shard in &missing {
            if means.stop.load(Ordering::Relaxed) {
                return Ok(false);
            }
            let row = keep(shard, &folder, &layout, &mut made, tell)?;
            reproduced(manifest.row(shard), &row)?;
            manifest.set(row.clone());
            folder.write_manifest(&manifest)?;
            tell(Progress::Shard(&row));
        }
        Ok(true)
    })?;
    Ok(if complete { Outcome::Complete(manifest) } else { Outcome::Stopped(manifest) })
}

/// The shards that are missing or do not match their rows.
fn missing(
    definition: &Definition,
    manifest: &Manifest,
    folder: &Folder,
    look: Look,
    tell: &mut dyn FnMut(Progress<'_>),
) -> Result<Vec<Shard>, RandomError> {
    let (mut missing, mut trials, mut damaged) = (Vec::new(), 0, 0);
    for shard in definition.shards() {
        match manifest.row(&shard) {
            Some(row) if folder.holds(row, look)? => trials += shard.trials,
            row => {
                damaged += u64::from(row.is_some());
                missing.push(shard);
            }
        }
    }
    tell(Progress::Found { trials, damaged });
    Ok(missing)
}

/// Writes a shard from the next row groups, and makes it durable.
fn keep<'q>(
    shard: &Shard,
    folder: &Folder,
    layout: &Layout,
    made: &mut impl Iterator<Item = &'q Receiver<Made>>,
    tell: &mut dyn FnMut(Progress<'_>),
) -> Result<ShardRow, RandomError> {
    let failed = |source| RandomError::Encode { file: shard.file_name(), source };
    let mut file = layout.file(folder.begin()?).map_err(failed)?;
    // In this order: when the shard is complete, no queue has been skipped.
    for ((_, trials), queue) in shard.row_groups().zip(made) {
        // A sender is only dropped early if its thread panics; the scope then panics as well.
        let group = queue.recv().expect("a thread makes all of its row groups")?;
        encode::append(&mut file, group).map_err(failed)?;
        tell(Progress::Made(trials));
    }
    folder.finish(shard, file.into_inner().map_err(failed)?)
}

/// Checks that a repeated shard has the same bytes.
fn reproduced(before: Option<&ShardRow>, now: &ShardRow) -> Result<(), RandomError> {
    match before {
        Some(before) if before.sha256 != now.sha256 => Err(RandomError::NotReproduced {
            file: now.file.clone(),
            before: before.sha256.clone(),
            now: now.sha256.clone(),
        }),
        _ => Ok(()),
    }
}

/// A row group, or its error.
type Made = Result<RowGroup, RandomError>;

/// Data shared by all threads.
struct Maker<'a> {
    definition: &'a Definition,
    sensor: &'a Sensor,
    model: &'a BatchModel,
    encoder: Encoder,
}

impl Maker<'_> {
    /// Makes row groups until all are done, one fails, or the receiver is dropped.
    fn make_all(&self, row_groups: impl Iterator<Item = (u64, u64)>, give: &SyncSender<Made>) {
        let mut work = BatchWork::default();
        for (first, count) in row_groups {
            let made = self.make(first, count, &mut work);
            let failed = made.is_err();
            if give.send(made).is_err() || failed {
                return;
            }
        }
    }

    fn make(&self, first: u64, count: u64, work: &mut BatchWork) -> Made {
        let trials = self.simulate(first, count, work)?;
        self.encoder.encode(trials).map_err(|source| RandomError::Encode {
            file: format!("trials {first} to {}", first + count - 1),
            source,
        })
    }

    /// Draws and simulates consecutive trials.
    fn simulate(
        &self,
        first: u64,
        count: u64,
        work: &mut BatchWork,
    ) -> Result<Trials, RandomError> {
        let (mut contacts, mut ends) = (Vec::new(), Vec::with_capacity(count as usize));
        for index in first..first + count {
            self.definition.draws.trial(self.sensor.points(), index, &mut contacts);
            ends.push(contacts.len());
        }
        let mut trials = Trials { first, contacts, ends, voltages_v: Vec::new() };
        let mut voltages_v = vec![0.0; trials.ends.len() * self.sensor.channels()];
        self.model
            .voltages(&trials.each(), &mut voltages_v, work)
            .map_err(|source| RandomError::Simulate { first, last: first + count - 1, source })?;
        trials.voltages_v = voltages_v;
        Ok(trials)
    }
}
