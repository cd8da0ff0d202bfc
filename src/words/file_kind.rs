//! What a TOML file is, by its tables; so that a file given in the place of another is recognised.
//! PURE. Uses: the TOML parser. Never: a judgement on the values.

/// A kind of file that a person writes or edits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// What a run presses.
    Experiment,
    /// Devices, wires and limits.
    Rig,
    /// Geometry and materials of a skin.
    Sensor,
    /// Differences of a virtual skin from its model.
    Gap,
    /// Recipe of a training.
    Recipe,
    /// The rows of a dataset.
    Dataset,
    /// Parameters of a skin, fitted to measurements.
    Calibration,
    /// Faults of a virtual rig.
    Faults,
}

impl FileKind {
    /// Returns the kind of a text, if its tables show it.
    pub fn of(text: &str) -> Option<Self> {
        let table: toml::Table = toml::from_str(text).ok()?;
        let has = |key: &str| table.contains_key(key);
        Some(match () {
            () if has("fault") => Self::Faults,
            () if has("real_hex") || has("real_random") => Self::Experiment,
            () if has("axes") || has("lines") || has("ert") => Self::Rig,
            () if has("training") => Self::Recipe,
            () if has("laminate") => Self::Gap,
            () if has("fields") && has("foam") && has("electrodes") => Self::Gap,
            () if has("layers") && has("points") => Self::Sensor,
            () if has("id") && has("sensor") => Self::Calibration,
            () if has("split") || has("task") => Self::Dataset,
            () => return None,
        })
    }

    /// Name with its article.
    pub fn name(self) -> &'static str {
        match self {
            Self::Experiment => "an experiment",
            Self::Rig => "a rig file",
            Self::Sensor => "a sensor file",
            Self::Gap => "a gap file",
            Self::Recipe => "a recipe",
            Self::Dataset => "a definition of a dataset",
            Self::Calibration => "a calibration",
            Self::Faults => "a script of faults",
        }
    }

    /// How a file of this kind is given.
    pub fn given(self) -> &'static str {
        match self {
            Self::Experiment => "palpate run FILE",
            Self::Rig => "--rig FILE, or palpate rig check FILE",
            Self::Sensor => "the key `sensor` of an experiment, or --sensor FILE",
            Self::Gap => "--gap FILE",
            Self::Recipe => "palpate train FILE",
            Self::Dataset => "palpate dataset make FILE",
            Self::Calibration => "--calibration FILE",
            Self::Faults => "--fault FILE",
        }
    }

    /// Why a text is not a file of this kind: it is one of another. Nothing if it is not recognised.
    pub fn instead_of(self, text: &str) -> Option<String> {
        let found = Self::of(text).filter(|found| *found != self)?;
        let (is, wanted) = (found.name(), self.name());
        Some(format!("this is {is}, not {wanted}; {is} is given with {}", found.given()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::carried::{DATASETS, EXPERIMENTS, FAULTS, GAPS, RECIPES, SENSORS};

    #[test]
    fn every_carried_file_is_recognised() {
        for (kind, files) in [
            (FileKind::Experiment, EXPERIMENTS),
            (FileKind::Sensor, SENSORS),
            (FileKind::Dataset, DATASETS),
            (FileKind::Gap, GAPS),
            (FileKind::Recipe, RECIPES),
            (FileKind::Faults, FAULTS),
        ] {
            for (name, text) in files {
                assert_eq!(FileKind::of(text), Some(kind), "{name}");
                assert_eq!(kind.instead_of(text), None, "{name}");
            }
        }
        let rig = include_str!("../../experiments/rigs/virtual.toml");
        assert_eq!(FileKind::of(rig), Some(FileKind::Rig));
        let skin = include_str!("../../experiments/rigs/skin-only.toml");
        assert_eq!(FileKind::of(skin), Some(FileKind::Rig));
        assert_eq!(FileKind::of("name = 1\n"), None);
    }
}
