//! The manifest of a folder of shards: the definition of their bytes, and the completed ones.
//! PURE. Uses: serde. Never: files, rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sim_core::batch::Kernel;
use sim_core::forward::ForwardModel;
use sim_core::sensor::SensorFile;

use super::draw::{DRAW_VERSION, Draws};
use crate::ids::CalibrationId;
use crate::problem::{Checks, Problem};

/// Name of the experiment.
pub const SIM_RANDOM: &str = "sim-random";
/// Version of the shards' columns and settings: increased by a change that produces other bytes.
const SHARDS_VERSION: u32 = 1;
/// Number of trials of a row group, the unit of work of a thread.
pub const ROW_GROUP_TRIALS: u64 = 1000;
/// Largest number of trials of a shard.
pub const SHARD_TRIALS_MAX: u64 = 1_000_000;
/// Largest number of trials with one seed.
pub const SEED_TRIALS_MAX: u64 = 10_000_000_000;
/// Cargo.lock, for the versions of the crates that produce bytes.
const LOCK: &str = include_str!("../../../../Cargo.lock");
/// The crates that produce bytes, one version of each. (A separate test covers the draws.)
const BYTE_MAKERS: [&str; 3] = ["arrow-ipc", "parquet", "zstd-sys"];

/// Everything that determines the bytes of all shards. Equal definitions give equal bytes on any
/// machine, with any number of threads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Definition {
    /// Always [`SIM_RANDOM`].
    pub experiment: String,
    /// Version of columns and settings.
    pub format_version: u32,
    /// Version of the draws.
    pub draw_version: u32,
    /// Distribution of the contacts.
    pub draws: Draws,
    /// Number of trials of all shards.
    pub trials: u64,
    /// Number of trials of a shard; the last one may have fewer.
    pub shard_trials: u64,
    /// Number of trials of a row group.
    pub row_group_trials: u64,
    /// Name of the sensor.
    pub sensor: String,
    /// Hash of the model.
    pub model: String,
    /// Id of the calibration, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationId>,
    /// Kernel that solved the frames.
    pub kernel: String,
    /// Version of this program.
    pub palpate: String,
    /// Versions of the libraries that produce bytes.
    pub libraries: BTreeMap<String, String>,
}

/// Returns the kernel of this name.
///
/// # Errors
/// The names of the kernels that this processor supports, if it is none of them.
pub fn kernel(name: &str) -> Result<Kernel, String> {
    let here = || Kernel::ALL.into_iter().filter(|kernel| kernel.is_here());
    here().find(|kernel| kernel.name() == name).ok_or_else(|| {
        let names: Vec<_> = here().map(Kernel::name).collect();
        format!("this processor has {}", names.join(", "))
    })
}

/// A checked request of a person.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    draws: Draws,
    trials: u64,
    shard_trials: u64,
}

impl Order {
    /// Checks a request for a skin with `points` points; keys are those of the command line.
    ///
    /// # Errors
    /// All problems of the values.
    pub fn new(
        draws: Draws,
        trials: u64,
        shard_trials: u64,
        points: usize,
    ) -> Result<Self, Vec<Problem>> {
        let mut checks = Checks::of("command line");
        let limit = format!("must be from 1 to {SEED_TRIALS_MAX}");
        checks.require((1..=SEED_TRIALS_MAX).contains(&trials), "trials", trials, &limit);
        let limit = format!("must be from 1 to {SHARD_TRIALS_MAX}");
        let fits = (1..=SHARD_TRIALS_MAX).contains(&shard_trials);
        checks.require(fits, "shard-trials", shard_trials, &limit);
        draws.check(points, &mut checks);
        checks.done().map(|()| Self { draws, trials, shard_trials })
    }
}

impl Definition {
    /// The definition of a request on a model of the same skin.
    pub fn new(order: Order, model: &ForwardModel, kernel: Kernel) -> Self {
        let Order { draws, trials, shard_trials } = order;
        Self {
            experiment: SIM_RANDOM.into(),
            format_version: SHARDS_VERSION,
            draw_version: DRAW_VERSION,
            draws,
            trials,
            shard_trials,
            row_group_trials: ROW_GROUP_TRIALS,
            sensor: model.sensor().file.name.clone(),
            model: model.model_hash().into(),
            calibration: model.sensor().calibration().map(CalibrationId::unchecked),
            kernel: kernel.name().into(),
            palpate: env!("CARGO_PKG_VERSION").into(),
            libraries: byte_makers(),
        }
    }

    /// Number of shards.
    pub fn shard_count(&self) -> u64 {
        self.trials.div_ceil(self.shard_trials)
    }

    /// The shard of this number, below [`Self::shard_count`].
    pub fn shard(&self, number: u64) -> Shard {
        let first = number * self.shard_trials;
        Shard { number, first, trials: self.shard_trials.min(self.trials - first) }
    }

    /// All shards, in order.
    pub fn shards(&self) -> impl Iterator<Item = Shard> {
        (0..self.shard_count()).map(|number| self.shard(number))
    }
}

/// Versions of the libraries that produce the bytes of a Parquet file, by name.
pub fn byte_makers() -> BTreeMap<String, String> {
    let version = |name: &&str| Some(((*name).to_owned(), locked_version(LOCK, name)?));
    BYTE_MAKERS.iter().filter_map(version).collect()
}

/// The version of a crate in a lock file's text.
fn locked_version(lock: &str, name: &str) -> Option<String> {
    let (_, rest) = lock.split_once(&format!("name = \"{name}\"\nversion = \""))?;
    Some(rest.split_once('"')?.0.to_owned())
}

/// A shard: consecutive trials that share a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Index among the shards, from 0.
    pub number: u64,
    /// Number of its first trial.
    pub first: u64,
    /// Number of trials.
    pub trials: u64,
}

impl Shard {
    /// Name of its file.
    pub fn file_name(&self) -> String {
        format!("shard-{:05}.parquet", self.number)
    }

    /// Its row groups, as number of the first trial and count.
    pub fn row_groups(&self) -> impl Iterator<Item = (u64, u64)> + use<> {
        let (first, end) = (self.first, self.first + self.trials);
        (first..end)
            .step_by(ROW_GROUP_TRIALS as usize)
            .map(move |at| (at, ROW_GROUP_TRIALS.min(end - at)))
    }
}

/// A completed shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardRow {
    /// Name of its file.
    pub file: String,
    /// Number of its first trial.
    pub first: u64,
    /// Number of trials.
    pub trials: u64,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// sha256 of the file.
    pub sha256: String,
    /// Commit of the program that made it, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

/// Contents of the manifest file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Definition of the bytes.
    pub definition: Definition,
    /// The sensor, for datasets.
    pub sensor_file: SensorFile,
    /// The completed shards, in order.
    pub shards: Vec<ShardRow>,
}

impl Manifest {
    /// Adds a row, or replaces the one of the same trials.
    pub fn set(&mut self, row: ShardRow) {
        match self.shards.binary_search_by_key(&row.first, |r| r.first) {
            Ok(at) => self.shards[at] = row,
            Err(at) => self.shards.insert(at, row),
        }
    }

    /// The row of a shard.
    pub fn row(&self, shard: &Shard) -> Option<&ShardRow> {
        let at = self.shards.binary_search_by_key(&shard.first, |r| r.first).ok()?;
        Some(&self.shards[at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crates_that_make_bytes_are_in_the_lock_file() {
        for name in BYTE_MAKERS {
            assert!(locked_version(LOCK, name).is_some(), "{name}");
            let entries = LOCK.matches(&format!("name = \"{name}\"\n")).count();
            assert_eq!(entries, 1, "{name}");
        }
        let lock = "[[package]]\nname = \"a-b\"\nversion = \"2.0.0\"\n[[package]]\nname = \"b\"\n\
                    version = \"1.0.0\"\n";
        assert_eq!(locked_version(lock, "b").as_deref(), Some("1.0.0"));
        assert_eq!(locked_version(lock, "c"), None);
    }

    #[test]
    fn row_groups_cover_a_shard_once() {
        let shard = Shard { number: 3, first: 7500, trials: 2500 };
        let groups: Vec<_> = shard.row_groups().collect();
        assert_eq!(groups, [(7500, 1000), (8500, 1000), (9500, 500)]);
    }
}
