//! The definition of a dataset: which runs, how they are labelled, filtered and split.
//! PURE. Uses: `carried`, `problem`, `syntax`, `store`'s conditions and labels. Never: files, rows.
//!
//! The four datasets of the paper (Table II) are ordinary definition files, built into the binary.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::carried::{self, DATASETS};
use crate::ids::DatasetId;
use crate::problem::{Checks, Problem};
use crate::store::{Condition, Label, RunKind};
use crate::syntax::parse_toml;

/// Largest number of runs, counts, conditions or folders of one definition.
const DEFINITION_LIST_MAX: usize = 1000;

/// Longest name of a licence, characters.
const LICENSE_MAX: usize = 100;

/// Input and output that a dataset is made for (paper, Table II).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// All trials of its runs with all columns, for no particular task.
    Trials,
    /// Measured voltages to force maps.
    Real,
    /// Measured voltages to simulated voltages.
    R2sTransfer,
    /// Simulated voltages to force maps, from the twins and Sim-Random.
    S2sRecon,
    /// Measured voltages to force maps, of freely placed contacts (Real-Random).
    RealUnseen,
}

impl Task {
    /// Kinds of runs that are selected if the definition names none. Imports must be named.
    pub fn kinds(self) -> &'static [RunKind] {
        match self {
            Self::Trials => &[RunKind::RealHex, RunKind::RealRandom],
            Self::Real | Self::R2sTransfer | Self::S2sRecon => &[RunKind::RealHex],
            Self::RealUnseen => &[RunKind::RealRandom],
        }
    }

    /// True if each row needs a simulated twin.
    pub fn needs_twin(self) -> bool {
        matches!(self, Self::R2sTransfer | Self::S2sRecon)
    }

    /// True if the rows have measured voltages.
    pub fn has_measured(self) -> bool {
        self != Self::S2sRecon
    }

    /// True if the rows may have simulated voltages.
    pub fn has_simulated(self) -> bool {
        matches!(self, Self::Trials | Self::R2sTransfer | Self::S2sRecon)
    }
}

/// Treatment of the trials with a certain property.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// These trials are excluded, and counted in the report.
    #[default]
    LeaveOut,
    /// These trials are included.
    Keep,
    /// Only these trials are included.
    Only,
}

/// Unit of a split: its rows are all in the same part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SplitBy {
    /// All depths of equal configurations, across runs.
    #[default]
    Configuration,
    /// A trial, as in the paper's tables. Neighbouring depths may be in different parts.
    Trial,
    /// The part that the imported file states (`imported_split`). Rows without one are excluded.
    Imported,
    /// All trials with the same tag of their imported files (`imported_tag`), across runs. Rows without one
    /// are excluded.
    Tag,
    /// The runs of `test_runs` are the test part; the configurations of the others are divided into
    /// train and validation (leave-one-batch-out).
    Run,
    /// No split: the rows have no part.
    None,
}

/// Division of the rows into train, validation and test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Split {
    /// Unit of the split.
    pub by: SplitBy,
    /// Shares of train, validation and test (paper V-A: 3:1:1).
    pub ratio: [u32; 3],
    /// Seed of the random order.
    pub seed: u64,
    /// Split each number of contacts separately, so that all parts have similar shares of each.
    pub stratify: bool,
    /// With `by = "run"`: the runs of the test part, each by uid, scan id or experiment.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub test_runs: Vec<String>,
}

impl Split {
    /// Shares of train, validation and test in what is drawn: with `by = "run"` no row is drawn as test.
    pub fn drawn_ratio(&self) -> [u32; 3] {
        let [train, validation, test] = self.ratio;
        [train, validation, if self.by == SplitBy::Run { 0 } else { test }]
    }

    /// Whether a run is one of `test_runs`.
    pub fn tests(&self, uid: &str, scan_id: i64, experiment: &str) -> bool {
        let scan_id = scan_id.to_string();
        self.test_runs.iter().any(|name| *name == uid || *name == scan_id || *name == experiment)
    }
}

impl Default for Split {
    fn default() -> Self {
        Self {
            by: SplitBy::default(),
            ratio: [3, 1, 1],
            seed: 1,
            stratify: false,
            test_runs: Vec::new(),
        }
    }
}

/// Definition of a dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// Name: 1 to 60 lower-case letters, digits and hyphens.
    pub name: String,
    /// Input and output that the dataset is made for.
    pub task: Task,
    /// Runs, each by uid, scan id or experiment; empty: all ended runs of the kinds of the task.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub runs: Vec<String>,
    /// Only runs with this label; required if the selected runs have different labels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<Label>,
    /// Deadband, N: in Real-Hex and imported runs, contacts below this force are removed from labels and
    /// counts. Absent: the deadband of each run's experiment (5 N by default), 0 for an imported run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadband_n: Option<f64>,
    /// Treatment of trials with a flag.
    #[serde(default)]
    pub flagged: Choice,
    /// Treatment of trials without contact.
    #[serde(default)]
    pub untouched: Choice,
    /// Only trials with one of these numbers of contacts; empty: any number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contact_counts: Vec<u32>,
    /// Further conditions, each `COLUMN__gt=VALUE`, on the labelled rows. All must hold.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Folders of Sim-Random shards under `sim-random` in the data folder; `*` selects all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sim_random: Vec<String>,
    /// Division into train, validation and test.
    #[serde(default)]
    pub split: Split,
    /// Licence under which the rows may be used, as an SPDX identifier or as text; for the card.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
}

impl Definition {
    /// The built-in definition of this name.
    pub fn built_in(name: &str) -> Option<Self> {
        toml::from_str(carried::text(DATASETS, name)?).ok()
    }

    /// Names of the built-in definitions.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        carried::names(DATASETS)
    }

    /// The definition of all trials of one run with all columns, made when the run ends.
    pub fn of_run(scan_id: i64) -> Self {
        Self {
            name: format!("run-{scan_id}"),
            task: Task::Trials,
            runs: vec![scan_id.to_string()],
            label: None,
            deadband_n: None,
            flagged: Choice::Keep,
            untouched: Choice::Keep,
            contact_counts: Vec::new(),
            conditions: Vec::new(),
            sim_random: Vec::new(),
            split: Split { by: SplitBy::None, ..Split::default() },
            license: None,
        }
    }

    /// Parses and checks a definition file; `file` is its name in messages.
    ///
    /// # Errors
    /// All problems of the text or, if it has none, of its values.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let definition: Self = parse_toml(file, text)?;
        definition.check(file)?;
        Ok(definition)
    }

    /// Checks all values; `file` is the name of the definition in messages.
    ///
    /// # Errors
    /// All invalid values.
    pub fn check(&self, file: &str) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of(file);
        let word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let named = (1..=60).contains(&self.name.len()) && self.name.chars().all(word);
        let limit = "must be 1 to 60 characters of a-z, 0-9 and -, and must not start with ds-";
        checks.require(named && self.name.parse::<DatasetId>().is_err(), "name", &self.name, limit);
        if let Some(deadband_n) = self.deadband_n {
            checks.within("deadband_n", deadband_n, 0.0..=1000.0);
        }
        if let Some(license) = &self.license {
            let one_line = !license.contains(char::is_control);
            let fits = license.chars().count() <= LICENSE_MAX && !license.trim().is_empty();
            let limit = format!("must be one line of 1 to {LICENSE_MAX} characters");
            checks.require(one_line && fits, "license", license, &limit);
        }
        let ratio = self.split.ratio;
        let sum = ratio.iter().map(|&part| u64::from(part)).sum::<u64>();
        let shown = format!("{ratio:?}");
        let limit = "must have a first share of at least 1 and a sum of at most 3000";
        checks.require(ratio[0] >= 1 && sum <= 3000, "split.ratio", shown, limit);
        for (key, length) in [
            ("runs", self.runs.len()),
            ("split.test_runs", self.split.test_runs.len()),
            ("contact_counts", self.contact_counts.len()),
            ("where", self.conditions.len()),
            ("sim_random", self.sim_random.len()),
        ] {
            let limit = format!("must hold at most {DEFINITION_LIST_MAX}");
            checks.require(length <= DEFINITION_LIST_MAX, key, length, &limit);
        }
        let (by, tests) = (self.split.by, &self.split.test_runs);
        let limit = "must name the runs of the test part: split.by is run";
        checks.require(by != SplitBy::Run || !tests.is_empty(), "split.test_runs", "absent", limit);
        let limit = "must be absent: only split.by = \"run\" uses it";
        let unused = by != SplitBy::Run && !tests.is_empty();
        checks.require(!unused, "split.test_runs", tests.join(", "), limit);
        let limit =
            "must be absent with split.by = \"imported\" or \"tag\": Sim-Random has neither";
        let of_file = matches!(by, SplitBy::Imported | SplitBy::Tag);
        let both = of_file && !self.sim_random.is_empty();
        checks.require(!both, "sim_random", self.sim_random.join(", "), limit);
        let takes_simulations = self.task == Task::S2sRecon;
        let limit = "must be empty: only the task s2s-recon uses Sim-Random";
        let none = self.sim_random.is_empty();
        checks.require(none || takes_simulations, "sim_random", self.sim_random.len(), limit);
        for folder in &self.sim_random {
            let plain = !folder.is_empty()
                && folder.split('/').all(|part| !part.is_empty() && part != "." && part != "..");
            let limit = "must be a folder under DATA/sim-random, without . or ..";
            checks.require(plain, "sim_random", folder, limit);
        }
        for condition in &self.conditions {
            if let Err(limit) = Condition::parse(condition) {
                checks.require(false, "where", condition, &limit);
            }
        }
        checks.done()
    }

    /// Leave-one-batch-out: for each entry of `runs` a definition with it as the test part, named after this one and
    /// the entry. `file` is the name of this definition in messages.
    ///
    /// # Errors
    /// A split that is not by run or has test runs, and fewer than two runs; otherwise the invalid values of the
    /// first definition that has some.
    pub fn each_run_left_out(&self, file: &str) -> Result<Vec<Self>, Vec<Problem>> {
        let mut checks = Checks::of(file);
        let Split { by, test_runs, .. } = &self.split;
        let shown = format!("{by:?}").to_lowercase();
        let limit = "must be run: each run is the test part in turn";
        checks.require(*by == SplitBy::Run, "split.by", shown, limit);
        let limit = "must be absent: each run is the test part in turn";
        checks.require(test_runs.is_empty(), "split.test_runs", test_runs.join(", "), limit);
        let limit = "must name at least 2 runs: each is the test part in turn";
        checks.require(self.runs.len() > 1, "runs", self.runs.len(), limit);
        checks.done()?;
        let without = |run: &String| -> Result<Self, Vec<Problem>> {
            let name = format!("{}-{run}", self.name);
            let split = Split { test_runs: vec![run.clone()], ..self.split.clone() };
            let definition = Self { name, split, ..self.clone() };
            definition.check(file)?;
            Ok(definition)
        };
        self.runs.iter().map(without).collect()
    }

    /// The conditions, parsed; invalid ones are skipped ([`Self::check`] reports them).
    pub fn filters(&self) -> Vec<Condition> {
        self.conditions.iter().filter_map(|text| Condition::parse(text).ok()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_datasets_are_in_the_binary() {
        for name in Definition::built_in_names() {
            let definition = Definition::built_in(name).unwrap_or_else(|| panic!("{name}"));
            assert_eq!(definition.name, name);
            definition.check(name).unwrap();
            assert_eq!(definition.split.ratio, [3, 1, 1]);
        }
    }

    #[test]
    fn every_wrong_value_is_named() {
        let text = "name = \"Big One\"\ntask = \"real\"\ndeadband_n = -1.0\nsim_random = [\"../x\"]\n\
                    license = \"\"\nwhere = [\"voltages_v__gt=1\", \"tips__near=3\"]\n[split]\nratio = [0, 1, 1]\n";
        let problems = Definition::from_toml("d.toml", text).unwrap_err();
        let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
        let wanted = [
            "name",
            "deadband_n",
            "license",
            "split.ratio",
            "sim_random",
            "sim_random",
            "where",
            "where",
        ];
        assert_eq!(keys, wanted);
        for (split, key) in [
            ("by = \"run\"", "split.test_runs"),
            ("by = \"trial\"\ntest_runs = [\"2\"]", "split.test_runs"),
        ] {
            let text = format!("name = \"a\"\ntask = \"real\"\n[split]\n{split}\n");
            let problems = Definition::from_toml("d.toml", &text).unwrap_err();
            assert_eq!((problems.len(), problems[0].key.as_str()), (1, key));
        }
        let unknown = Definition::from_toml("d.toml", "name = \"a\"\ntask = \"fly\"\n");
        assert!(unknown.unwrap_err()[0].limit.contains("r2s-transfer"));
    }

    #[test]
    fn each_run_is_the_test_part_of_one_definition() {
        let parsed = |runs: &str, split: &str| -> Definition {
            let text =
                format!("name = \"without\"\ntask = \"real\"\nruns = {runs}\n[split]\n{split}\n");
            toml::from_str(&text).unwrap()
        };
        let by_run = "by = \"run\"\nratio = [4, 1, 0]";
        let all = parsed("[\"one\", \"2\"]", by_run);
        let each = all.each_run_left_out("d.toml").unwrap();
        let facts: Vec<(&str, &[String])> =
            each.iter().map(|one| (one.name.as_str(), one.split.test_runs.as_slice())).collect();
        assert_eq!(facts, [("without-one", &all.runs[..1]), ("without-2", &all.runs[1..])]);
        let same = |one: &Definition| one.runs == all.runs && one.split.ratio == [4, 1, 0];
        assert!(each.iter().all(same), "{each:?}");
        for (runs, split, key) in [
            ("[\"one\", \"2\"]", "by = \"tag\"", "split.by"),
            ("[\"one\", \"2\"]", "by = \"run\"\ntest_runs = [\"2\"]", "split.test_runs"),
            ("[\"one\"]", by_run, "runs"),
            ("[\"one\", \"Two\"]", by_run, "name"),
        ] {
            let problems = parsed(runs, split).each_run_left_out("d.toml").unwrap_err();
            assert_eq!((problems.len(), problems[0].key.as_str()), (1, key));
        }
    }
}
