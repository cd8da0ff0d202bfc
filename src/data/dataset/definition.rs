//! What a dataset is made of: which runs, how they are labelled, what is left out, how it is split.
//! PURE. Uses: `problem`, `syntax`. Never: files, rows.
//!
//! The paper's four (Table II) are definition files like anybody else's, and are in the binary.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::problem::{Checks, Problem};
use crate::store::{Condition, Label, RunKind};
use crate::syntax::syntax_problem;

/// The definitions that are in the binary, by their names.
const BUILT_IN: [(&str, &str); 6] = [
    ("real", include_str!("../../../experiments/datasets/real.toml")),
    ("real-untouched", include_str!("../../../experiments/datasets/real-untouched.toml")),
    ("r2s-transfer", include_str!("../../../experiments/datasets/r2s-transfer.toml")),
    (
        "r2s-transfer-by-trial",
        include_str!("../../../experiments/datasets/r2s-transfer-by-trial.toml"),
    ),
    ("s2s-recon", include_str!("../../../experiments/datasets/s2s-recon.toml")),
    ("real-unseen", include_str!("../../../experiments/datasets/real-unseen.toml")),
];

/// Most runs, counts, filters or folders of one definition.
const LIST_MAX: usize = 1000;

/// What is learned from a dataset: its input and its output (paper, Table II).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Every trial of its runs with all columns; nothing in particular.
    Trials,
    /// Measured voltages to force maps.
    Real,
    /// Measured voltages to simulated ones.
    R2sTransfer,
    /// Simulated voltages to force maps; the twins and Sim-Random.
    S2sRecon,
    /// Measured voltages to force maps, of contacts placed freely.
    RealUnseen,
}

impl Task {
    /// The runs that it takes unless they are named (imports always are).
    pub fn kinds(self) -> &'static [RunKind] {
        match self {
            Self::Trials => &[RunKind::RealHex, RunKind::RealRandom],
            Self::Real | Self::R2sTransfer | Self::S2sRecon => &[RunKind::RealHex],
            Self::RealUnseen => &[RunKind::RealRandom],
        }
    }

    /// Whether each row needs a simulated twin.
    pub fn needs_twin(self) -> bool {
        matches!(self, Self::R2sTransfer | Self::S2sRecon)
    }

    /// Whether measured voltages belong to its rows.
    pub fn has_measured(self) -> bool {
        self != Self::S2sRecon
    }

    /// Whether simulated voltages belong to its rows.
    pub fn has_simulated(self) -> bool {
        matches!(self, Self::Trials | Self::R2sTransfer | Self::S2sRecon)
    }
}

/// What becomes of some of the trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// They are left out, counted and said.
    #[default]
    LeaveOut,
    /// They stay.
    Keep,
    /// The others are left out.
    Only,
}

/// What is never divided between two parts of a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SplitBy {
    /// Equal configurations with all their depths, in whichever runs.
    #[default]
    Configuration,
    /// A trial, as in the paper's tables: neighbouring depths land on both sides.
    Trial,
    /// There are no parts.
    None,
}

/// How rows are divided into train, validation and test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Split {
    /// What stays together.
    pub by: SplitBy,
    /// Shares of train, validation and test (paper V-A: 3:1:1).
    pub ratio: [u32; 3],
    /// Seed of the draw.
    pub seed: u64,
    /// Divide each number of contacts by itself, so that every part has its share of each.
    pub stratify: bool,
}

impl Default for Split {
    fn default() -> Self {
        Self { by: SplitBy::default(), ratio: [3, 1, 1], seed: 1, stratify: false }
    }
}

/// A dataset to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// Its name: lower-case letters, digits and hyphens.
    pub name: String,
    /// What is learned from it.
    pub task: Task,
    /// Runs, each by uid, scan id or experiment; empty: all ended runs that the task takes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub runs: Vec<String>,
    /// Whether a skin was touched; needed where runs of more than one label would come together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<Label>,
    /// In Real-Hex, contacts under this are removed and counts relabelled, N; absent: as each run's
    /// experiment says (5 N).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadband_n: Option<f64>,
    /// Trials with a flag.
    #[serde(default)]
    pub flagged: Choice,
    /// Trials without a contact.
    #[serde(default)]
    pub untouched: Choice,
    /// Only trials with so many contacts; empty: any number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contact_counts: Vec<u32>,
    /// More conditions, each `COLUMN__gt=VALUE`, on the labelled rows.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Folders of Sim-Random shards under the data folder's `sim-random`; `*` is all there are.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sim_random: Vec<String>,
    /// How it is divided.
    #[serde(default)]
    pub split: Split,
}

impl Definition {
    /// The definition in the binary of this name.
    pub fn built_in(name: &str) -> Option<Self> {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        toml::from_str(text).ok()
    }

    /// Names of the definitions in the binary.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// All trials of one run with all columns: what a finished campaign leaves behind.
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
        }
    }

    /// Reads a definition file and checks it.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let definition: Self =
            toml::from_str(text).map_err(|error| vec![syntax_problem(file, text, &error)])?;
        definition.check(file)?;
        Ok(definition)
    }

    /// What is wrong with it; `file` is how messages name it.
    pub fn check(&self, file: &str) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of(file);
        let word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let named = (1..=60).contains(&self.name.len()) && self.name.chars().all(word);
        let limit = "must be 1 to 60 of a-z, 0-9 and - (not starting with ds-)";
        checks.require(named && !self.name.starts_with("ds-"), "name", &self.name, limit);
        if let Some(deadband_n) = self.deadband_n {
            checks.within("deadband_n", deadband_n, 0.0, 1000.0);
        }
        let ratio = self.split.ratio;
        let sum = ratio.iter().map(|&part| u64::from(part)).sum::<u64>();
        let shown = format!("{ratio:?}");
        let limit = "must be up to 1000 each, the first at least 1";
        checks.require(ratio[0] >= 1 && sum <= 3000, "split.ratio", shown, limit);
        for (key, length) in [
            ("runs", self.runs.len()),
            ("contact_counts", self.contact_counts.len()),
            ("where", self.conditions.len()),
            ("sim_random", self.sim_random.len()),
        ] {
            let limit = format!("must hold at most {LIST_MAX}");
            checks.require(length <= LIST_MAX, key, length, &limit);
        }
        let takes_simulations = self.task == Task::S2sRecon;
        let limit = "only a dataset of task s2s-recon takes Sim-Random";
        let none = self.sim_random.is_empty();
        checks.require(none || takes_simulations, "sim_random", self.sim_random.len(), limit);
        for folder in &self.sim_random {
            let plain = !folder.is_empty()
                && folder.split('/').all(|part| !part.is_empty() && part != "." && part != "..");
            let limit = "must be a folder under DATA/sim-random, without . or ..";
            checks.require(plain, "sim_random", folder, limit);
        }
        let mut problems = checks.done().err().unwrap_or_default();
        for condition in &self.conditions {
            if let Err(limit) = Condition::parse(condition) {
                problems.push(Problem::new(file, "where", condition, limit));
            }
        }
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    /// Its conditions, checked before.
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
                    where = [\"voltages_v__gt=1\", \"tips__near=3\"]\n[split]\nratio = [0, 1, 1]\n";
        let problems = Definition::from_toml("d.toml", text).unwrap_err();
        let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
        let wanted =
            ["name", "deadband_n", "split.ratio", "sim_random", "sim_random", "where", "where"];
        assert_eq!(keys, wanted);
        let unknown = Definition::from_toml("d.toml", "name = \"a\"\ntask = \"fly\"\n");
        assert!(unknown.unwrap_err()[0].limit.contains("r2s-transfer"));
    }
}
