//! `palpate init`: writes the carried files into a folder, to be edited, or lists them.
//! Uses: `carried`, `schedule` (trials and schema of experiments). Never: overwriting a file.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::error::{CliError, CliResult};
use super::next::{Next, word};
use super::output::{counted, grouped, say, say_json};
use super::table::{Table, or_dash};
use crate::carried::{FOLDERS, about};
use crate::new_file;
use crate::schedule::experiment::Experiment;
use crate::schedule::schema::of_experiments;

/// Options of `init`.
#[derive(Debug, Clone, Args)]
pub struct InitArgs {
    /// Folder to write to; it may exist.
    #[arg(value_name = "DIR", default_value = "experiments")]
    pub folder: PathBuf,
    /// List the carried files with what each is, and write nothing.
    #[arg(long)]
    pub list: bool,
    /// Print the JSON schema of an experiment file, for editors, and write nothing.
    #[arg(long, conflicts_with = "list")]
    pub schema: bool,
    /// With --list: print JSON on standard output, with the text of each file.
    #[arg(long, requires = "list")]
    pub json: bool,
}

/// Runs `palpate init`.
///
/// # Errors
/// `CliError::File` if a file cannot be written, `System` if the schema cannot.
pub fn init(args: &InitArgs) -> CliResult<()> {
    if args.schema {
        let schema = of_experiments().map_err(std::io::Error::from);
        say_json(&schema.map_err(CliError::system("writing the schema"))?);
        return Ok(());
    }
    if args.list {
        match args.json {
            true => say_json(&carried().map(Carried::value).collect::<Vec<_>>()),
            false => say(list(carried())),
        }
        return Ok(());
    }
    let (mut written, mut kept) = (0, 0);
    for (name, files) in FOLDERS {
        let folder = args.folder.join(name);
        std::fs::create_dir_all(&folder).map_err(CliError::file(&folder))?;
        for (stem, text) in files {
            let file = format!("{stem}.toml");
            if folder.join(&file).exists() {
                kept += 1;
                continue;
            }
            new_file::write(&folder, &file, text).map_err(CliError::file(&folder.join(&file)))?;
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

/// A file that the program carries.
struct Carried {
    /// Its folder in `experiments/`; empty for experiments.
    folder: &'static str,
    name: &'static str,
    text: &'static str,
    /// Number of planned trials of an experiment.
    trials: Option<u64>,
}

impl Carried {
    fn value(self) -> Value {
        let Self { folder, name, text, trials } = self;
        json!({ "folder": folder, "name": name, "about": about(text), "trials": trials, "text": text })
    }
}

fn carried() -> impl Iterator<Item = Carried> {
    FOLDERS.into_iter().flat_map(|(folder, files)| {
        files.iter().map(move |&(name, text)| {
            let experiment = folder.is_empty().then(|| Experiment::from_toml(name, text).ok());
            let trials = experiment.flatten().map(|experiment| experiment.trials());
            Carried { folder, name, text, trials }
        })
    })
}

fn list(files: impl Iterator<Item = Carried>) -> Table {
    let mut table = Table::new("folder | name | trials> | what it is", "nothing is carried");
    for Carried { folder, name, text, trials } in files {
        let folder = if folder.is_empty() { "experiments" } else { folder };
        table.push([folder.into(), name.into(), or_dash(trials.map(grouped)), about(text)]);
    }
    table
}

#[cfg(test)]
mod tests {
    use clap::Subcommand;

    use super::*;

    #[test]
    fn the_help_names_the_folders_that_are_written() {
        let root = crate::cli::Command::augment_subcommands(clap::Command::new("palpate"));
        let about = root.find_subcommand("init").unwrap().get_about().unwrap().to_string();
        for (folder, _) in FOLDERS {
            let folder = if folder.is_empty() { "experiments" } else { folder };
            assert!(about.contains(&format!(" {folder}")), "{folder}: {about}");
        }
    }

    #[test]
    fn carried_files_are_listed_with_the_trials_of_experiments() {
        let shown = list(carried()).to_string();
        let rows: Vec<Vec<&str>> =
            shown.lines().map(|line| line.split_whitespace().take(3).collect()).collect();
        assert!(rows.contains(&vec!["experiments", "quickstart", "264"]), "{shown}");
        assert!(rows.contains(&vec!["rigs", "virtual", "-"]), "{shown}");
        assert!(rows.contains(&vec!["faults", "each-kind", "-"]), "{shown}");
        let all: usize = FOLDERS.iter().map(|(_, files)| files.len()).sum();
        assert_eq!(rows.len(), 1 + all);
        let texts = carried().map(Carried::value).filter(|file| file["text"] != "").count();
        assert_eq!(texts, all);
    }
}
