//! The files of `experiments/` that the program carries: one list for each folder.
//! Uses: nothing. Never: the meaning of a file.

/// A list of files of a folder of `experiments/`: of each its name without `.toml`, and its text.
macro_rules! carried {
    ($folder:literal: $($name:literal),* $(,)?) => {
        &[$((
            $name,
            include_str!(concat!("../../experiments/", $folder, "/", $name, ".toml")),
        )),*]
    };
}

/// The experiments; each is in the folder itself and names a sensor as `sensors/NAME.toml`.
pub const EXPERIMENTS: &[(&str, &str)] = carried![
    ".":
    "quickstart",
    "real-hex",
    "real-hex-1",
    "real-hex-2",
    "real-hex-3",
    "real-hex-4",
    "real-hex-5",
    "real-hex-6",
    "real-random",
    "touch-real-hex",
    "touch-real-random",
];

/// Rig files in the program: name and text.
pub const RIGS: &[(&str, &str)] = carried![
    "rigs":
    "virtual",
    "iai-modbus-tcp",
    "leadshine-rtu",
    "oriental-az-rtu",
    "skin-only",
];

/// The differences of virtual skins from the model.
pub const GAPS: &[(&str, &str)] = carried!["gaps": "gap-a", "gap-b", "gap-c", "gap-d"];

/// Sensor files in the program: name and text.
pub const SENSORS: &[(&str, &str)] = carried!["sensors": "ert-28"];

/// The definitions of datasets.
pub const DATASETS: &[(&str, &str)] = carried![
    "datasets":
    "real",
    "real-untouched",
    "r2s-transfer",
    "r2s-transfer-by-trial",
    "s2s-recon",
    "real-unseen",
];

/// The recipes of trainings.
pub const RECIPES: &[(&str, &str)] = carried![
    "recipes":
    "transfer-net",
    "transfer-net-published",
    "recon-net",
    "end-to-end",
    "point-net",
    "mlp",
    "ridge",
    "kernel-ridge",
];

/// All files, by their folder in `experiments/`.
pub const FOLDERS: [(&str, &[(&str, &str)]); 6] = [
    ("", EXPERIMENTS),
    ("rigs", RIGS),
    ("gaps", GAPS),
    ("sensors", SENSORS),
    ("datasets", DATASETS),
    ("recipes", RECIPES),
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
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::*;

    #[test]
    fn every_file_of_a_folder_is_in_its_list() {
        for (folder, files) in FOLDERS {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../experiments").join(folder);
            let found = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
            let found: BTreeSet<String> = found
                .filter(|file| file.extension().is_some_and(|extension| extension == "toml"))
                .map(|file| file.file_stem().unwrap().to_string_lossy().into())
                .collect();
            let listed: BTreeSet<String> = names(files).map(str::to_owned).collect();
            assert_eq!(found, listed, "{folder}");
            assert_eq!(listed.len(), files.len(), "{folder}: a name is listed twice");
        }
    }

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
