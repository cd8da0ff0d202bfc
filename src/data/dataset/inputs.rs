//! The current inputs of a definition: its runs, its shards, and a hash of their state.
//! Uses: `store`, `dataset::shards`. Never: rows.

use std::path::Path;

use serde_json::json;

use super::definition::{Definition, SplitBy, Task};
use super::error::{DatasetError, DatasetResult};
use super::schema;
use super::shards::{self, ShardFolder};
use crate::digest::sha256_hex;
use crate::problem::Problem;
use crate::state::StoredState;
use crate::store::{Label, RunExtent, RunRow, Store};

/// Version of the code that makes rows of stored trials; part of the hash.
const BUILD_VERSION: u32 = 1;

/// The current inputs of a definition.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Definition that selects, labels and splits the rows.
    pub definition: Definition,
    /// The selected runs by scan id, each with the extent of its trials.
    pub runs: Vec<(RunRow, RunExtent)>,
    /// The selected folders of shards, by name.
    pub folders: Vec<ShardFolder>,
    /// sha256 over everything that the rows depend on, in hexadecimal digits.
    pub key: String,
}

impl Inputs {
    /// Finds the current runs and shards of a definition. `data` is the data folder.
    ///
    /// # Errors
    /// `DatasetError::Problems` if the definition is invalid, `NoRun` if it names an unknown run,
    /// `Labels` if the runs have different labels, `Shards` if a folder cannot be read, `Store` if
    /// the store fails.
    pub async fn find(store: &Store, data: &Path, definition: &Definition) -> DatasetResult<Self> {
        definition.check(&definition.name).map_err(DatasetError::Problems)?;
        let mut runs = Vec::new();
        for run in select_runs(store, definition).await? {
            let extent = store.run_extent(run.uid).await?;
            runs.push((run, extent));
        }
        check_labels(definition, &runs)?;
        check_test_runs(definition, &runs)?;
        let folders = shards::find(data, &definition.sim_random)?;
        let text = json!({
            "version": BUILD_VERSION,
            "definition": definition,
            "runs": runs.iter().map(|(run, extent)| json!([run.uid, extent])).collect::<Vec<_>>(),
            "shards": folders.iter().map(|f| json!([f.name, f.manifest])).collect::<Vec<_>>(),
        });
        let key = sha256_hex(text.to_string());
        Ok(Self { definition: definition.clone(), runs, folders, key })
    }

    /// Number of rows before filtering.
    pub fn candidates(&self) -> u64 {
        let trials: u64 = self.runs.iter().map(|(_, e)| e.trials.unsigned_abs()).sum();
        trials + self.folders.iter().map(ShardFolder::trials).sum::<u64>()
    }

    /// Simulation id of the run with the newest trial; `None` if it has no twins.
    pub fn model(&self) -> Option<&str> {
        let newest = self.runs.iter().max_by_key(|(_, extent)| extent.newest)?;
        newest.1.model.as_deref()
    }

    /// Returns the number of voltages per frame, which must be equal in all runs; 784 without
    /// frames.
    ///
    /// # Errors
    /// `DatasetError::Channels` if runs have frames of different lengths, `Store` if the store
    /// fails.
    pub async fn channels(&self, store: &Store) -> DatasetResult<i32> {
        let mut found: Option<(usize, String)> = None;
        for (run, extent) in &self.runs {
            if extent.trials == 0 {
                continue;
            }
            let Some(frame) = store.trial_voltages(crate::ids::TrialId(extent.last)).await? else {
                continue;
            };
            let who = format!("run {}", run.scan_id);
            match &found {
                Some((channels, other)) if *channels != frame.len() => {
                    return Err(DatasetError::Channels {
                        one: format!("{other} has {channels} voltages per frame"),
                        other: format!("{who} has {}", frame.len()),
                    });
                }
                _ => found = Some((frame.len(), who)),
            }
        }
        let channels = found.map_or(schema::PAPER_CHANNELS as usize, |(channels, _)| channels);
        i32::try_from(channels).map_err(|_| DatasetError::Channels {
            one: format!("{channels} voltages per frame"),
            other: format!("limit {}", i32::MAX),
        })
    }
}

async fn select_runs(store: &Store, definition: &Definition) -> DatasetResult<Vec<RunRow>> {
    let all = store.all_runs().await?;
    let labelled = |run: &RunRow| definition.label.is_none_or(|label| run.label == label);
    if definition.runs.is_empty() {
        let kinds = definition.task.kinds();
        let matches = |run: &RunRow| {
            run.state == StoredState::Ended && kinds.contains(&run.kind) && labelled(run)
        };
        return Ok(all.into_iter().filter(matches).collect());
    }
    for wanted in &definition.runs {
        if !all.iter().any(|run| names(run, wanted)) {
            return Err(DatasetError::NoRun(wanted.clone()));
        }
    }
    let named = |run: &RunRow| definition.runs.iter().any(|wanted| names(run, wanted));
    Ok(all.into_iter().filter(|run| named(run) && labelled(run)).collect())
}

/// True if an entry of `runs` in a definition names this run.
fn names(run: &RunRow, wanted: &str) -> bool {
    run.scan_id.to_string() == wanted || run.uid.to_string() == wanted || run.experiment == wanted
}

/// Checks that each test run is one of the selected runs, and that another one remains.
fn check_test_runs(definition: &Definition, runs: &[(RunRow, RunExtent)]) -> DatasetResult<()> {
    let wrong = |value: &str, limit: String| {
        let problem = Problem::new(&definition.name, "split.test_runs", value, limit);
        Err(DatasetError::Problems(vec![problem]))
    };
    let selected: Vec<String> = runs.iter().map(|(run, _)| run.scan_id.to_string()).collect();
    let selected = selected.join(", ");
    for wanted in &definition.split.test_runs {
        if !runs.iter().any(|(run, _)| names(run, wanted)) {
            return wrong(wanted, format!("must be one of the selected runs: {selected}"));
        }
    }
    let split = &definition.split;
    let is_test = |run: &RunRow| split.tests(&run.uid.to_string(), run.scan_id, &run.experiment);
    if split.by == SplitBy::Run && !runs.is_empty() && runs.iter().all(|(run, _)| is_test(run)) {
        let limit =
            format!("must leave at least one of the selected runs for training: {selected}");
        return wrong(&split.test_runs.join(", "), limit);
    }
    Ok(())
}

/// Checks that the runs with trials have one label; labels are only combined on request.
fn check_labels(definition: &Definition, runs: &[(RunRow, RunExtent)]) -> DatasetResult<()> {
    if definition.task == Task::S2sRecon {
        return Ok(());
    }
    let of = |label: Label| {
        let (run, _) = runs.iter().find(|(run, extent)| run.label == label && extent.trials > 0)?;
        Some(format!("run {} is {}", run.scan_id, label.as_str()))
    };
    let labels = [Label::Measured, Label::Virtual, Label::Simulated];
    let found: Vec<String> = labels.into_iter().filter_map(of).collect();
    if found.len() > 1 { Err(DatasetError::Labels(found.join(", "))) } else { Ok(()) }
}
