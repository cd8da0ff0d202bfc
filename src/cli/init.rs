//! `palpate init`: writes the carried experiments, rigs, sensors and recipes into a folder, to be edited.
//! Uses: `carried`. Never: overwriting a file.

use std::path::PathBuf;

use clap::Args;

use super::error::CliError;
use super::next::{Next, word};
use super::output::{counted, say};
use crate::carried::FOLDERS;
use crate::new_file;

/// Options of `init`.
#[derive(Debug, Clone, Args)]
pub struct InitArgs {
    /// Folder to write to; it may exist.
    #[arg(value_name = "DIR", default_value = "experiments")]
    pub folder: PathBuf,
}

/// Runs `palpate init`.
///
/// # Errors
/// `CliError::File` if a file cannot be written.
pub fn init(args: &InitArgs) -> Result<(), CliError> {
    let (mut written, mut kept) = (0, 0);
    for (name, files) in FOLDERS {
        let folder = args.folder.join(name);
        std::fs::create_dir_all(&folder)
            .map_err(|source| CliError::File { path: folder.clone(), source })?;
        for (stem, text) in files {
            let file = format!("{stem}.toml");
            if folder.join(&file).exists() {
                kept += 1;
                continue;
            }
            new_file::write(&folder, &file, text)
                .map_err(|source| CliError::File { path: folder.join(&file), source })?;
            written += 1;
        }
    }
    let shown = args.folder.display();
    say(format_args!("{} written to {shown}", counted(written, "file", "files")));
    if kept > 0 {
        say(format_args!(
            "{} there already, left as they are",
            counted(kept, "file was", "files were")
        ));
    }
    let file = args.folder.join("quickstart.toml").display().to_string();
    Next::default()
        .suggest(
            format_args!("palpate plan {}", word(&file)),
            "checks an experiment; nothing moves",
        )
        .say();
    Ok(())
}
