//! `palpate cluster gather`: verified chunks as the folder that one process would have written, or in the database of
//! their run.
//! Uses: `chunk`, `kind`, `twins`, `evaluation`. Never: a chunk that does not have the sha256 of its row.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::evaluation;
use super::kind::{ChunkKind, Gathered, order_of};
use super::twins::{self, Stored};
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::ChunkRow;
use crate::cli::At;
use crate::cli::error::{CliError, CliResult};
use crate::cli::next::Next;
use crate::cli::output::{bytes, grouped};
use crate::cli::progress::Counted;
use crate::simulate::twins::chunks::TwinsOrder;

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
pub async fn gather(args: &GatherArgs) -> CliResult<()> {
    let folder = OrderFolder::open(&args.folder)?;
    let kind = ChunkKind::of(&folder)?;
    let rows = folder.rows()?;
    match (kind, &args.out) {
        (ChunkKind::Twins, None) => store(folder, rows, &args.at).await,
        (ChunkKind::Readings, Some(out)) => score(&folder, &rows, out, &args.at).await,
        (_, Some(out)) => {
            let mut verified = verified(&folder);
            let gathered = kind.gather(&folder, &rows, out, &mut || verified.add(1));
            drop(verified);
            let Gathered { rows, bytes: length } = gathered?;
            let more = json!({ "rows": rows, "bytes": length, "folder": out });
            let words = format!(
                "{} rows of {} chunks, each with its sha256, {}, in {}",
                grouped(rows),
                folder.order().chunks,
                bytes(length as f64),
                out.display(),
            );
            args.at.output().say(&answer(&folder, more), words);
            Ok(())
        }
        (ChunkKind::SimRandom | ChunkKind::Trainings | ChunkKind::Readings, None) => {
            Err(CliError::argument("out", "absent", "must be given: the folder to write"))
        }
    }
}

/// Progress of the verification of chunks.
fn verified(folder: &OrderFolder) -> Counted {
    Counted::of("chunks verified", folder.order().chunks)
}

/// The answer for scripts: the work order, and what became of it.
fn answer(folder: &OrderFolder, mut more: Value) -> Value {
    let order = folder.order();
    more["order"] = json!(order.id);
    more["kind"] = json!(order.kind);
    more["chunks"] = json!(order.chunks);
    more
}

/// Stores the twins of a work order.
async fn store(folder: OrderFolder, rows: Vec<ChunkRow>, at: &At) -> CliResult<()> {
    let run = order_of(&folder, TwinsOrder::read)?.definition.run;
    let done = twins::store(run, folder.clone(), rows, at, verified(&folder)).await?;
    let Stored { stored, present, damaged } = done;
    folder.all_whole(damaged)?;
    let more = json!({ "run": run, "stored": stored, "present": present });
    let words = format!(
        "{} twins of {} chunks, each with its sha256, are stored in run {run}; {} of them were there before",
        grouped(stored + present),
        folder.order().chunks,
        grouped(present),
    );
    at.output().say(&answer(&folder, more), words);
    Next::of(at)
        .suggest(format_args!("palpate evaluate simulation --run {run}"), "shows how well they fit")
        .say();
    Ok(())
}

/// Has the readings of a work order scored.
async fn score(folder: &OrderFolder, rows: &[ChunkRow], out: &Path, at: &At) -> CliResult<()> {
    let frames = evaluation::score(folder, rows, out, at, verified(folder)).await?;
    let words = format!(
        "{} readings of {} chunks, each with its sha256, and their scores, in {}",
        grouped(frames),
        folder.order().chunks,
        out.display(),
    );
    let more = json!({ "rows": frames, "folder": out });
    at.output().say(&answer(folder, more), words);
    let out = out.display();
    Next::of(at)
        .line(
            format_args!("palpate evaluate method exact --trained {out}"),
            "shows the scores, with the options of the order",
        )
        .say();
    Ok(())
}
