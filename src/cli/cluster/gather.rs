//! `palpate cluster gather`: verified chunks as the folder that one process would have written.
//! Uses: `chunk`, `kind`, indicatif. Never: a chunk that does not have the sha256 of its row.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::kind::ChunkKind;
use crate::chunk::folder::OrderFolder;
use crate::cli::error::CliError;
use crate::cli::output::{bytes, grouped, say, say_json};
use crate::cli::progress::{LogLines, progress_bar};

/// Options of `cluster gather`.
#[derive(Debug, Clone, Args)]
pub struct GatherArgs {
    /// Folder of the work order.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Folder to write: that of `palpate simulate random`, or a folder for each net.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print JSON on standard output, for scripts.
    #[arg(long)]
    json: bool,
}

/// Verifies and gathers the chunks of a work order.
///
/// # Errors
/// `ChunkError::Incomplete` if a chunk is missing or damaged; another `CliError` if a file cannot be read or written.
pub fn gather(args: &GatherArgs) -> Result<(), CliError> {
    let folder = OrderFolder::open(&args.folder)?;
    let kind = ChunkKind::of(&folder)?;
    let rows = folder.rows()?;
    let chunks = folder.order().chunks;
    let bar = progress_bar("chunks");
    bar.set_length(chunks);
    let mut lines = LogLines::instead_of(&bar);
    let mut verified = 0;
    let gathered = kind.gather(&folder, &rows, &args.out, &mut || {
        verified += 1;
        bar.inc(1);
        lines.say(|| format!("{verified}/{chunks} chunks"));
    });
    bar.finish_and_clear();
    let gathered = gathered?;
    if args.json {
        say_json(&json!({
            "order": folder.order().id,
            "kind": folder.order().kind,
            "chunks": chunks,
            "rows": gathered.rows,
            "bytes": gathered.bytes,
            "folder": args.out,
        }));
        return Ok(());
    }
    say(format_args!(
        "{} rows of {chunks} chunks, each with its sha256, {}, in {}",
        grouped(gathered.rows),
        bytes(gathered.bytes as f64),
        args.out.display(),
    ));
    Ok(())
}
