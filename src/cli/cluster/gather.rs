//! `palpate cluster gather`: verified chunks as the folder that one process would have written, or in the database of
//! their run.
//! Uses: `chunk`, `kind`, `twins`, `evaluation`, `verified`. Never: a chunk that does not have the sha256 of its row.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::evaluation;
use super::kind::{ChunkKind, all_whole, twins_order};
use super::twins::{self, Stored};
use super::verified::Verified;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::ChunkRow;
use crate::cli::At;
use crate::cli::error::CliError;
use crate::cli::next::Next;
use crate::cli::output::{bytes, grouped, say, say_json};

/// Options of `cluster gather`.
#[derive(Debug, Clone, Args)]
pub struct GatherArgs {
    /// Folder of the work order.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Folder to write: that of `palpate simulate random`, a folder for each net, or the readings and scores
    /// of an evaluation. Twins need none: the service with their run stores them.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    at: At,
}

/// Verifies and gathers the chunks of a work order.
///
/// # Errors
/// `ChunkError::Incomplete` if a chunk is missing or damaged; another `CliError` if a file cannot be read or written, or
/// twins cannot be stored.
pub async fn gather(args: &GatherArgs) -> Result<(), CliError> {
    let folder = OrderFolder::open(&args.folder)?;
    let kind = ChunkKind::of(&folder)?;
    let rows = folder.rows()?;
    match (kind, &args.out) {
        (ChunkKind::Twins, None) => store(folder, rows, &args.at).await,
        (ChunkKind::Readings, Some(out)) => score(&folder, &rows, out, &args.at).await,
        (_, Some(out)) => {
            let mut verified = Verified::of(folder.order().chunks);
            let gathered = kind.gather(&folder, &rows, out, &mut || verified.one());
            drop(verified);
            let gathered = gathered?;
            if args.at.json {
                say_json(&json!({
                    "order": folder.order().id,
                    "kind": folder.order().kind,
                    "chunks": folder.order().chunks,
                    "rows": gathered.rows,
                    "bytes": gathered.bytes,
                    "folder": out,
                }));
                return Ok(());
            }
            say(format_args!(
                "{} rows of {} chunks, each with its sha256, {}, in {}",
                grouped(gathered.rows),
                folder.order().chunks,
                bytes(gathered.bytes as f64),
                out.display(),
            ));
            Ok(())
        }
        (ChunkKind::SimRandom | ChunkKind::Trainings | ChunkKind::Readings, None) => {
            Err(CliError::argument("out", "absent", "must be given: the folder to write"))
        }
    }
}

/// Stores the twins of a work order.
async fn store(folder: OrderFolder, rows: Vec<ChunkRow>, at: &At) -> Result<(), CliError> {
    let run = twins_order(&folder)?.definition.run;
    let verified = Verified::of(folder.order().chunks);
    let done = twins::store(run, folder.clone(), rows, at, verified).await?;
    let Stored { stored, present, damaged } = done;
    all_whole(&folder, damaged)?;
    if at.json {
        say_json(&json!({
            "order": folder.order().id,
            "kind": folder.order().kind,
            "chunks": folder.order().chunks,
            "run": run,
            "stored": stored,
            "present": present,
        }));
        return Ok(());
    }
    say(format_args!(
        "{} twins of {} chunks, each with its sha256, are stored in run {run}; {} of them were there before",
        grouped(stored + present),
        folder.order().chunks,
        grouped(present),
    ));
    Next::of(at)
        .suggest(format_args!("palpate evaluate simulation --run {run}"), "shows how well they fit")
        .say();
    Ok(())
}

/// Has the readings of a work order scored.
async fn score(
    folder: &OrderFolder,
    rows: &[ChunkRow],
    out: &Path,
    at: &At,
) -> Result<(), CliError> {
    let verified = Verified::of(folder.order().chunks);
    let frames = evaluation::score(folder, rows, out, at, verified).await?;
    if at.json {
        say_json(&json!({
            "order": folder.order().id,
            "kind": folder.order().kind,
            "chunks": folder.order().chunks,
            "rows": frames,
            "folder": out,
        }));
        return Ok(());
    }
    say(format_args!(
        "{} readings of {} chunks, each with its sha256, and their scores, in {}",
        grouped(frames),
        folder.order().chunks,
        out.display(),
    ));
    let out = out.display();
    Next::of(at)
        .line(
            format_args!("palpate evaluate method exact --trained {out}"),
            "shows the scores, with the options of the order",
        )
        .say();
    Ok(())
}
