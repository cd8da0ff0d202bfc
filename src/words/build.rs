//! Lists the files of `experiments/` that the program carries, folder by folder, in the order of their names.
//! Uses: std alone. Never: the meaning of a file.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=../../experiments");
    list("experiments", Path::new(""))?;
    for folder in ["rigs", "gaps", "sensors", "datasets", "recipes", "faults"] {
        list(folder, Path::new(folder))?;
    }
    Ok(())
}

/// Writes the list of a folder as Rust: of each file its name without `.toml`, and its text. The paths
/// are relative to the package, since another checkout may build with the same target folder.
fn list(name: &str, folder: &Path) -> io::Result<()> {
    let folder = Path::new("../../experiments").join(folder);
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        // An editor's lock file has a name that begins with a dot.
        if path.extension() == Some(OsStr::new("toml"))
            && let Some(stem) = path.file_stem()
            && !stem.as_encoded_bytes().starts_with(b".")
        {
            files.push((stem.to_owned(), path));
        }
    }
    files.sort();
    let row = |(stem, path): (OsString, PathBuf)| {
        let path = Path::new("/").join(path);
        format!("({stem:?}, include_str!(concat!(env!(\"CARGO_MANIFEST_DIR\"), {path:?}))),\n")
    };
    let rows: String = files.into_iter().map(row).collect();
    let out = env::var("OUT_DIR").map_err(io::Error::other)?;
    fs::write(Path::new(&out).join(format!("{name}.rs")), format!("&[{rows}]"))
}
