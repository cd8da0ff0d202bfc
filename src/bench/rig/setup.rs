//! What a rig file describes: a bench that presses, or a skin and its board alone, on which a person
//! places weights.
//! PURE. Uses: `config`, `limits`, `problem`, `syntax`. Never: ports, files (the text is passed in).

use serde::{Deserialize, Serialize};

use super::config::{ErtConfig, RigConfig, RigLabel, one};
use super::limits::check_frame_age;
use crate::problem::{Checks, Problem};
use crate::record::Label;
use crate::syntax::parse_toml;

/// Sections that only a bench has. A file without all of them describes a skin alone.
const OF_A_BENCH: [&str; 5] = ["axes", "slot", "skin", "cells", "lines"];

/// Contents of a rig file.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum RigSetup {
    /// A bench: stage, indenter, load cells, skin.
    Bench(Box<RigConfig>),
    /// A skin and its board, without anything that moves or measures a force.
    Skin(SkinConfig),
}

/// A skin and its board alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinConfig {
    /// Name of the rig, stored with each run.
    pub name: String,
    /// Label of all data of this rig.
    pub label: RigLabel,
    /// Process seconds per wall second: 1 on a real board.
    #[serde(default = "one")]
    pub clock_rate: f64,
    /// The voltage stream.
    pub ert: ErtConfig,
    /// Limits of the stream.
    pub limits: SkinLimits,
}

/// Limits of a skin alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinLimits {
    /// Longest time without a frame, wall ms.
    pub frame_age_ms: u64,
}

impl RigSetup {
    /// Parses and checks the text of a rig file. `file` is its name in the problems.
    ///
    /// # Errors
    /// All problems found; only the first one if the text is not valid TOML or has an unknown key.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Vec<Problem>> {
        let table: Option<toml::Table> = toml::from_str(text).ok();
        let is_skin = table.is_some_and(|t| OF_A_BENCH.iter().all(|key| !t.contains_key(*key)));
        if !is_skin {
            return RigConfig::from_toml(file, text).map(|config| Self::Bench(Box::new(config)));
        }
        let skin: SkinConfig = parse_toml(file, text)?;
        let mut c = Checks::of(file);
        c.within("clock_rate", skin.clock_rate, 0.01..=2000.0);
        check_frame_age(skin.limits.frame_age_ms, &mut c);
        skin.ert.check(&mut c);
        c.done()?;
        Ok(Self::Skin(skin))
    }

    /// The bench; `None` for a skin alone.
    pub fn bench(&self) -> Option<&RigConfig> {
        match self {
            Self::Bench(config) => Some(config),
            Self::Skin(_) => None,
        }
    }

    /// Name of the rig.
    pub fn name(&self) -> &str {
        match self {
            Self::Bench(config) => &config.name,
            Self::Skin(skin) => &skin.name,
        }
    }

    /// Label of all data of the rig.
    pub fn label(&self) -> Label {
        match self {
            Self::Bench(config) => config.label.into(),
            Self::Skin(skin) => skin.label.into(),
        }
    }

    /// Replaces the label.
    pub fn set_label(&mut self, label: RigLabel) {
        match self {
            Self::Bench(config) => config.label = label,
            Self::Skin(skin) => skin.label = label,
        }
    }

    /// Process seconds per wall second.
    pub fn clock_rate(&self) -> f64 {
        match self {
            Self::Bench(config) => config.clock_rate,
            Self::Skin(skin) => skin.clock_rate,
        }
    }

    /// The voltage stream.
    pub fn ert(&self) -> &ErtConfig {
        match self {
            Self::Bench(config) => &config.ert,
            Self::Skin(skin) => &skin.ert,
        }
    }

    /// Longest time without a frame, wall ms.
    pub fn frame_age_ms(&self) -> u64 {
        match self {
            Self::Bench(config) => config.limits.frame_age_ms,
            Self::Skin(skin) => skin.limits.frame_age_ms,
        }
    }

    /// Noise of the load cells, N; `None` without load cells.
    pub fn force_noise_n(&self) -> Option<f64> {
        self.bench().map(|config| config.cells.force_noise_n)
    }
}

impl From<RigConfig> for RigSetup {
    fn from(config: RigConfig) -> Self {
        Self::Bench(Box::new(config))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SKIN: &str = include_str!("../../../experiments/rigs/skin-only.toml");
    const BENCH: &str = include_str!("../../../experiments/rigs/virtual.toml");

    fn problem(from: &str, to: &str) -> String {
        assert!(SKIN.contains(from), "{from}");
        RigSetup::from_toml("s.toml", &SKIN.replacen(from, to, 1)).unwrap_err()[0].to_string()
    }

    #[test]
    fn a_file_without_a_stage_is_a_skin_alone_and_is_written_as_it_was_read() {
        let skin = RigSetup::from_toml("s.toml", SKIN).unwrap();
        assert!(skin.bench().is_none() && skin.force_noise_n().is_none());
        assert_eq!(skin.ert().electrodes(), 28);
        let text = toml::to_string(&skin).unwrap();
        assert_eq!(RigSetup::from_toml("s.toml", &text).unwrap(), skin);
        let bench = RigSetup::from_toml("b.toml", BENCH).unwrap();
        assert_eq!(bench.bench().unwrap().name, bench.name());
        let text = toml::to_string(&bench).unwrap();
        assert_eq!(RigSetup::from_toml("b.toml", &text).unwrap(), bench);
    }

    #[test]
    fn a_wrong_value_is_named_and_half_a_bench_is_no_skin() {
        assert_eq!(
            problem("frame_age_ms = 1000", "frame_age_ms = 1"),
            "s.toml: limits.frame_age_ms = 1: must be from 50 to 10000"
        );
        assert!(problem("electrodes = 28", "electrodes = 1").contains("must be 2 to 64"));
        let half = problem("\n[ert]\n", "\n[cells]\n[ert]\n");
        assert!(half.contains("absent: must be given"), "{half}");
    }
}
