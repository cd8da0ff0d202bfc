//! `palpate sensor`: what follows from a sensor file alone.
//! Uses: `overlay`, `files`. Never: the network, the rig.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use serde_json::json;

use super::At;
use super::error::CliResult;
use super::files::{read_sensor, write};
use super::next::Next;
use crate::overlay::{self, Paper};

/// Options of `sensor`.
#[derive(Debug, Clone, Args)]
pub struct SensorArgs {
    #[command(subcommand)]
    command: SensorCommand,
    #[command(flatten)]
    at: At,
}

/// What is made from a sensor file.
#[derive(Debug, Clone, Subcommand)]
enum SensorCommand {
    /// Write the overlay for placing weights as a PDF at true scale.
    Overlay {
        /// Paper: sheets of A4 that overlap, or one sheet as large as the skin.
        #[arg(long, value_enum, default_value_t = PaperName::A4)]
        paper: PaperName,
        /// Sensor file or the name of a carried one [default: ert-28].
        #[arg(long, value_name = "FILE")]
        sensor: Option<PathBuf>,
        /// File to write.
        #[arg(long, value_name = "FILE.pdf", value_parser = pdf_file)]
        out: PathBuf,
    },
}

/// Paper of an overlay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PaperName {
    A4,
    Sheet,
}

/// Reads the name of a PDF file.
///
/// # Errors
/// The limit, if the name ends otherwise; it may have no ending.
fn pdf_file(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    match path.extension().is_none_or(|ending| ending.eq_ignore_ascii_case("pdf")) {
        true => Ok(path),
        false => Err("must end in .pdf".into()),
    }
}

/// Runs `palpate sensor`.
///
/// # Errors
/// `CliError` if the sensor file is invalid or the PDF cannot be written.
pub fn sensor(args: &SensorArgs) -> CliResult<()> {
    let SensorCommand::Overlay { paper, sensor, out } = &args.command;
    let (sensor, _) = read_sensor(sensor.as_deref())?;
    let paper = match paper {
        PaperName::A4 => Paper::A4,
        PaperName::Sheet => Paper::Sheet,
    };
    let pdf = overlay::pdf(&sensor, paper);
    write(out, &pdf)?;
    let written = json!({ "file": out, "bytes": pdf.len() });
    let out = out.display();
    let words = format_args!("{out} is written: print it at 100 %, and check its ruler of 100 mm");
    args.at.output().say(&written, words);
    if !args.at.json {
        // It takes no data folder.
        Next::default()
            .suggest("palpate plan real-random", "checks a run with placed weights; nothing moves")
            .say();
    }
    Ok(())
}
