//! Sim-Random (paper IV-B): free trials in bulk, as Parquet shards whose bytes are determined by
//! their definition alone.
//! Uses: sim-core, `simulate::schema`. Never: a clock, the order in which threads finish.
//!
//! `shards` makes a shard on threads. [`generate`] makes all shards of a definition in a folder (`folder`), each
//! durable as soon as it is complete; `chunks` makes any of them on any machine, and gathers them into the same
//! folder.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use sim_core::batch::BatchModel;
use sim_core::sensor::Sensor;

pub mod draw;
pub mod encode;
pub mod error;
pub mod manifest;
pub mod folder;
pub mod shards;
pub mod chunks;

use error::RandomError;
use folder::Folder;
use manifest::{Definition, Manifest, Shard, ShardRow};
use shards::ShardMaker;

use crate::new_file::Look;

/// Progress of the generation.
#[derive(Debug, Clone, Copy)]
pub enum Progress<'a> {
    /// Number of further trials whose shard was checked, or is missing.
    Checked(u64),
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
    let (folder, mut manifest) = Folder::take_for(folder, definition, &sensor.file)?;
    let missing = missing(definition, &manifest, &folder, means.look, tell)?;
    let maker = ShardMaker::new(definition, sensor, model)?;
    let complete =
        maker.row_groups(&missing, means.threads, |made| -> Result<bool, RandomError> {
            for shard in &missing {
                if means.stop.load(Ordering::Relaxed) {
                    return Ok(false);
                }
                let mut tell_made = |trials| {
                    tell(Progress::Made(trials));
                    ControlFlow::Continue(())
                };
                let (out, name) = (folder.begin()?, shard.file_name());
                let Some(out) = maker.write(shard, out, &name, made, &mut tell_made)? else {
                    return Ok(false);
                };
                let row = folder.finish(shard, out)?;
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
        tell(Progress::Checked(shard.trials));
    }
    tell(Progress::Found { trials, damaged });
    Ok(missing)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::paper::SENSOR;

    #[test]
    fn the_trials_of_each_shard_are_counted_as_it_is_checked() {
        let definition = chunks::tests::definition();
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let outer = tempfile::tempdir().unwrap();
        let path = outer.path().join("shards");
        let (folder, manifest) = Folder::take_for(&path, &definition, &sensor.file).unwrap();
        let mut told = Vec::new();
        let mut tell = |progress: Progress<'_>| told.push(format!("{progress:?}"));
        let found = missing(&definition, &manifest, &folder, Look::Sha256, &mut tell).unwrap();
        assert_eq!(found.len(), 3);
        let found = "Found { trials: 0, damaged: 0 }";
        assert_eq!(told, ["Checked(1000)", "Checked(1000)", "Checked(500)", found]);
    }
}
