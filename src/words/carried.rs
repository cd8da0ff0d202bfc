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
];

/// Returns the text of a file.
pub fn text(files: &[(&str, &'static str)], name: &str) -> Option<&'static str> {
    files.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
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
        for (folder, files) in [("datasets", DATASETS), ("recipes", RECIPES)] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../experiments").join(folder);
            let found = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
            let found: BTreeSet<String> =
                found.map(|file| file.file_stem().unwrap().to_string_lossy().into()).collect();
            let listed: BTreeSet<String> = names(files).map(str::to_owned).collect();
            assert_eq!(found, listed, "{folder}");
            assert_eq!(listed.len(), files.len(), "{folder}: a name is listed twice");
        }
    }
}
