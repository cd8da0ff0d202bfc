//! The files of `experiments/` that the program carries: one list for each folder, which `build.rs` writes.
//! Uses: nothing. Never: the meaning of a file.

/// The list of a folder, which the build writes: of each file its name without `.toml`, and its text, in
/// the order of the names.
macro_rules! carried {
    ($list:literal) => {
        include!(concat!(env!("OUT_DIR"), "/", $list, ".rs"))
    };
}

/// The experiments; each is in the folder itself and names a sensor as `sensors/NAME.toml`.
pub const EXPERIMENTS: &[(&str, &str)] = carried!("experiments");

/// Rig files in the program: name and text.
pub const RIGS: &[(&str, &str)] = carried!("rigs");

/// The differences of virtual skins from the model.
pub const GAPS: &[(&str, &str)] = carried!("gaps");

/// Sensor files in the program: name and text.
pub const SENSORS: &[(&str, &str)] = carried!("sensors");

/// The definitions of datasets.
pub const DATASETS: &[(&str, &str)] = carried!("datasets");

/// The recipes of trainings.
pub const RECIPES: &[(&str, &str)] = carried!("recipes");

/// Scripts of faults for the virtual rig.
pub const FAULTS: &[(&str, &str)] = carried!("faults");

/// All files, by their folder in `experiments/`.
pub const FOLDERS: [(&str, &[(&str, &str)]); 7] = [
    ("", EXPERIMENTS),
    ("rigs", RIGS),
    ("gaps", GAPS),
    ("sensors", SENSORS),
    ("datasets", DATASETS),
    ("recipes", RECIPES),
    ("faults", FAULTS),
];

/// Returns the text of a file.
pub fn text(files: &[(&str, &'static str)], name: &str) -> Option<&'static str> {
    files.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Returns the text of the sensor file that an experiment names, if the program carries it.
pub fn sensor(named: &str) -> Option<&'static str> {
    text(SENSORS, named.strip_prefix("sensors/")?.strip_suffix(".toml")?)
}

/// Returns the comment at the start of a file, as one line; empty without one.
pub fn about(text: &str) -> String {
    let lines = text.lines().map_while(|line| line.strip_prefix('#'));
    lines.map(str::trim).collect::<Vec<_>>().join(" ")
}

/// Returns the names of files, in the order of their list.
pub fn names(files: &'static [(&'static str, &'static str)]) -> impl Iterator<Item = &'static str> {
    files.iter().map(|(name, _)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_experiment_says_what_it_is_and_names_a_sensor_that_is_carried() {
        for (name, text) in EXPERIMENTS {
            assert!(about(text).ends_with('.') && !about(text).contains('#'), "{name}");
            let named = text.lines().find_map(|line| line.strip_prefix("sensor = \""));
            assert!(sensor(named.unwrap().trim_end_matches('"')).is_some(), "{name}");
        }
        assert_eq!(about("# One.\n#  Two.\nname = 1 # three\n"), "One. Two.");
        assert_eq!(about("name = 1\n# no\n"), "");
        for other in
            ["ert-28.toml", "sensors/ert-28", "other/ert-28.toml", "sensors/../ert-28.toml"]
        {
            assert_eq!(sensor(other), None, "{other}");
        }
    }
}
