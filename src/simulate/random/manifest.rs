//! The manifest of a folder of shards: what defines their bytes, and which are done.
//! PURE. Uses: serde. Never: files, rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use sim_core::batch::Kernel;
use sim_core::forward::ForwardModel;

use super::draw::{DRAW_VERSION, Draws};
use crate::problem::{Checks, Problem};

/// Name of the experiment.
pub const SIM_RANDOM: &str = "sim-random";
/// Version of the shards' columns and settings: a change that gives other bytes raises it.
const FORMAT_VERSION: u32 = 1;
/// Trials of a row group: what one thread makes at a time.
pub const ROW_GROUP_TRIALS: u64 = 1000;
/// Most trials of a shard.
pub const SHARD_TRIALS_MAX: u64 = 1_000_000;
/// Most trials under one seed.
pub const TRIALS_MAX: u64 = 10_000_000_000;
/// Locked versions of the crates that make bytes.
const LOCK: &str = include_str!("../../../Cargo.lock");
/// The crates that make bytes, one version of each. (Draws are held by a test of their own.)
const BYTE_MAKERS: [&str; 3] = ["arrow-ipc", "parquet", "zstd-sys"];

/// What the bytes of all shards follow from. Equal definitions, equal bytes: on any machine, with
/// any number of threads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Definition {
    /// Always [`SIM_RANDOM`].
    pub experiment: String,
    /// Version of columns and settings.
    pub format_version: u32,
    /// Version of the way of drawing.
    pub draw_version: u32,
    /// What the contacts are drawn from.
    pub draws: Draws,
    /// Trials of all shards.
    pub trials: u64,
    /// Trials of a shard; the last one may have fewer.
    pub shard_trials: u64,
    /// Trials of a row group.
    pub row_group_trials: u64,
    /// Name of the sensor.
    pub sensor: String,
    /// Hash of the model.
    pub model: String,
    /// Id of the calibration, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<String>,
    /// Kernel that solved the frames.
    pub kernel: String,
    /// Version of this program.
    pub palpate: String,
    /// Versions of the libraries that make bytes.
    pub libraries: BTreeMap<String, String>,
}

/// What a person asks for, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    draws: Draws,
    trials: u64,
    shard_trials: u64,
}

impl Order {
    /// An order for a skin with so many points, or what is wrong with it; keys as the command line
    /// names them.
    pub fn new(
        draws: Draws,
        trials: u64,
        shard_trials: u64,
        points: usize,
    ) -> Result<Self, Vec<Problem>> {
        let mut checks = Checks::of("command line");
        let limit = format!("must be from 1 to {TRIALS_MAX}");
        checks.require((1..=TRIALS_MAX).contains(&trials), "trials", trials, &limit);
        let limit = format!("must be from 1 to {SHARD_TRIALS_MAX}");
        let fits = (1..=SHARD_TRIALS_MAX).contains(&shard_trials);
        checks.require(fits, "shard-trials", shard_trials, &limit);
        draws.check(points, &mut checks);
        checks.done().map(|()| Self { draws, trials, shard_trials })
    }
}

impl Definition {
    /// The definition of an order on a model of the same skin.
    pub fn new(order: Order, model: &ForwardModel, kernel: Kernel) -> Self {
        let Order { draws, trials, shard_trials } = order;
        Self {
            experiment: SIM_RANDOM.into(),
            format_version: FORMAT_VERSION,
            draw_version: DRAW_VERSION,
            draws,
            trials,
            shard_trials,
            row_group_trials: ROW_GROUP_TRIALS,
            sensor: model.sensor().file.name.clone(),
            model: model.model_hash().into(),
            calibration: model.sensor().calibration().map(str::to_owned),
            kernel: kernel.name().into(),
            palpate: env!("CARGO_PKG_VERSION").into(),
            libraries: BYTE_MAKERS
                .iter()
                .filter_map(|name| Some(((*name).to_owned(), locked_version(LOCK, name)?)))
                .collect(),
        }
    }

    /// All shards, in order.
    pub fn shards(&self) -> impl Iterator<Item = Shard> + use<> {
        let (trials, each) = (self.trials, self.shard_trials);
        (0..trials.div_ceil(each)).map(move |number| {
            let first = number * each;
            Shard { number, first, trials: each.min(trials - first) }
        })
    }
}

/// The version of a crate in a lock file's text.
fn locked_version(lock: &str, name: &str) -> Option<String> {
    let (_, rest) = lock.split_once(&format!("name = \"{name}\"\nversion = \""))?;
    Some(rest.split_once('"')?.0.to_owned())
}

/// A shard: consecutive trials that share a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Its position among the shards.
    pub number: u64,
    /// Number of its first trial.
    pub first: u64,
    /// How many trials it has.
    pub trials: u64,
}

impl Shard {
    /// Its file's name.
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

/// A shard that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardRow {
    /// Its file's name.
    pub file: String,
    /// Number of its first trial.
    pub first: u64,
    /// How many trials it has.
    pub trials: u64,
    /// Its length.
    pub bytes: u64,
    /// sha256 of its bytes.
    pub sha256: String,
    /// Commit of the program that made it, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

/// The manifest as it stands in its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// What the bytes follow from.
    pub definition: Definition,
    /// The shards that are done, in order.
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

/// Where two JSON values first differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Dotted key.
    pub field: String,
    /// The first one's value; `nothing` where it has none.
    pub there: String,
    /// The other's.
    pub here: String,
}

/// The first leaf at which two values differ, by key in alphabetical order.
pub fn first_difference(there: &Value, here: &Value) -> Option<Difference> {
    fn walk(path: &str, there: &Value, here: &Value) -> Option<Difference> {
        if there == here {
            return None;
        }
        if let (Value::Object(a), Value::Object(b)) = (there, here) {
            let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            return keys.into_iter().find_map(|key| {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                let of = |map: &serde_json::Map<String, Value>| map.get(key).cloned();
                walk(&path, &of(a).unwrap_or(Value::Null), &of(b).unwrap_or(Value::Null))
            });
        }
        let shown = |value: &Value| match value {
            Value::Null => "nothing".to_owned(),
            value => value.to_string(),
        };
        Some(Difference { field: path.into(), there: shown(there), here: shown(here) })
    }
    walk("", there, here)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

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
    fn the_field_that_differs_is_named() {
        let there = json!({ "draws": { "seed": 1, "contacts": [1, 6] }, "kernel": "f64" });
        assert_eq!(first_difference(&there, &there), None);
        let mut here = there.clone();
        here["draws"]["seed"] = json!(2);
        let found = first_difference(&there, &here).unwrap();
        assert_eq!((found.field.as_str(), found.there.as_str()), ("draws.seed", "1"));
        let mut here = there.clone();
        here["calibration"] = json!("cal-1");
        let found = first_difference(&there, &here).unwrap();
        assert_eq!((found.field.as_str(), found.there.as_str()), ("calibration", "nothing"));
        assert_eq!(found.here, "\"cal-1\"");
    }

    #[test]
    fn row_groups_cover_a_shard_once() {
        let shard = Shard { number: 3, first: 7500, trials: 2500 };
        let groups: Vec<_> = shard.row_groups().collect();
        assert_eq!(groups, [(7500, 1000), (8500, 1000), (9500, 500)]);
    }
}
