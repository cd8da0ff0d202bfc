//! `palpate cluster status`: what is done, failed and missing, at which rate, and what to submit.
//! Uses: `chunk`, `job`. Never: Slurm, the bytes of a chunk (`gather` reads them).

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use clap::Args;
use serde_json::json;

use super::job::{JOB_FILE, tasks_for, tasks_of};
use crate::chunk::folder::{ChunkState, OrderFolder};
use crate::chunk::order::{FailedChunk, ranges};
use crate::cli::error::CliResult;
use crate::cli::next::{Next, word};
use crate::cli::output::{bytes, counted, duration, grouped, say, say_json};
use crate::new_file::Look;

/// Time over which the rate is measured.
const RATE_WINDOW: Duration = Duration::from_secs(600);
/// Largest number of failed or damaged chunks that are listed.
const LISTED_CHUNKS: usize = 10;

/// Options of `cluster status`.
#[derive(Debug, Clone, Args)]
pub struct StatusArgs {
    /// Folder of the work order.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Print JSON on standard output, for scripts.
    #[arg(long)]
    json: bool,
}

/// Counts over the chunks of a work order.
#[derive(Default)]
struct Counts {
    done: u64,
    rows: u64,
    bytes: u64,
    failed: Vec<FailedChunk>,
    damaged: Vec<(u64, String)>,
    /// Chunks that are not done, for whatever reason.
    open: Vec<u64>,
    rate: Rate,
}

/// Chunks per second, from the times at which they were done.
#[derive(Default)]
struct Rate {
    /// Number of chunks that were done within the window.
    recent: u64,
    /// Start of the first chunk of all.
    began: Option<SystemTime>,
}

impl Rate {
    fn add(&mut self, done_at: SystemTime, wall_ms: u64, now: SystemTime) {
        let began = done_at.checked_sub(Duration::from_millis(wall_ms)).unwrap_or(done_at);
        self.began = Some(self.began.map_or(began, |first| first.min(began)));
        // A chunk of the future is of a clock that is ahead.
        let age = now.duration_since(done_at).unwrap_or_default();
        self.recent += u64::from(age <= RATE_WINDOW);
    }

    /// Chunks per second over the window; none if none was done in it.
    fn per_s(&self, now: SystemTime) -> Option<f64> {
        let age = now.duration_since(self.began?).unwrap_or_default();
        let over_s = age.min(RATE_WINDOW).as_secs_f64().max(1e-3);
        (self.recent > 0).then(|| self.recent as f64 / over_s)
    }
}

/// Shows the state of a work order.
///
/// # Errors
/// `CliError` if the folder has no work order of this program, or a file cannot be read.
pub fn status(args: &StatusArgs) -> CliResult<()> {
    let folder = OrderFolder::open(&args.folder)?;
    let now = SystemTime::now();
    let counts = count(&folder, now)?;
    let left = counts.open.len() as f64;
    let per_s = counts.rate.per_s(now).filter(|_| left > 0.0);
    let left_s = per_s.map(|per_s| left / per_s);
    let job = args.folder.join(JOB_FILE);
    let tasks = fs::read_to_string(&job).ok().and_then(|text| tasks_of(&text));
    let array = tasks.map(|tasks| ranges(&tasks_for(&counts.open, tasks)));
    let array = array.filter(|array| !array.is_empty());
    if args.json {
        let missing = counts.open.len() - counts.failed.len() - counts.damaged.len();
        say_json(&json!({
            "folder": args.folder,
            "order": folder.order().id,
            "kind": folder.order().kind,
            "chunks": folder.order().chunks,
            "done": counts.done,
            "failed": counts.failed,
            "damaged": counts.damaged.iter().map(|(index, _)| index).collect::<Vec<_>>(),
            "missing": missing,
            "not_done": counts.open,
            "rows": counts.rows,
            "bytes": counts.bytes,
            "chunks_per_s": per_s,
            "left_s": left_s,
            "array": array,
        }));
        return Ok(());
    }
    counts.say(&folder);
    if let (Some(per_s), Some(left_s)) = (per_s, left_s) {
        let per_min = 60.0 * per_s;
        say(format_args!("  rate      {per_min:.1} chunks/min, done in {}", duration(left_s)));
    }
    let place = word(&args.folder.display().to_string());
    let next = Next::default();
    let next = match (counts.open.is_empty(), array) {
        (true, _) => next.suggest(
            format_args!("palpate cluster gather {place} --out {}", folder.order().kind),
            "verifies all chunks, and writes them as one process would have",
        ),
        (false, Some(array)) => next.line(
            format_args!("sbatch --array={array} {place}/{JOB_FILE}"),
            "makes what is not done, when no job of this folder runs any more",
        ),
        (false, None) => next.suggest(
            format_args!("palpate cluster make {place} --task 0 --tasks 1"),
            "makes what is not done, in this process",
        ),
    };
    next.say();
    Ok(())
}

fn count(folder: &OrderFolder, now: SystemTime) -> CliResult<Counts> {
    let mut counts = Counts::default();
    for index in 0..folder.order().chunks {
        match folder.state(index, Look::Length)? {
            ChunkState::Done(row) => {
                counts.done += 1;
                counts.rows += row.rows;
                counts.bytes += row.bytes;
                if let Some(done_at) = folder.done_at(&row.key) {
                    counts.rate.add(done_at, row.wall_ms, now);
                }
                continue;
            }
            ChunkState::Failed(failed) => counts.failed.push(failed),
            ChunkState::Damaged(why) => counts.damaged.push((index, why)),
            ChunkState::Missing => {}
        }
        counts.open.push(index);
    }
    Ok(counts)
}

impl Counts {
    /// Prints the counts for people.
    fn say(&self, folder: &OrderFolder) {
        let order = folder.order();
        let (id, kind, path) = (order.short_id(), &order.kind, folder.path().display());
        say(format_args!("work order {id}: {kind}, {path}"));
        say(format_args!(
            "  done      {} of {}, {} rows, {}",
            self.done,
            counted(order.chunks, "chunk", "chunks"),
            grouped(self.rows),
            bytes(self.bytes as f64),
        ));
        for FailedChunk { index, attempts, error, .. } in self.failed.iter().take(LISTED_CHUNKS) {
            let attempts = counted(*attempts, "attempt", "attempts");
            say(format_args!("  failed    chunk {index}, {attempts}: {error}"));
        }
        for (index, why) in self.damaged.iter().take(LISTED_CHUNKS) {
            say(format_args!("  damaged   chunk {index}: {why}"));
        }
        for (what, count) in [("failed", self.failed.len()), ("damaged", self.damaged.len())] {
            if count > LISTED_CHUNKS {
                say(format_args!("  {what:<9} {} more", count - LISTED_CHUNKS));
            }
        }
        if !self.open.is_empty() {
            say(format_args!("  not done  {}", ranges(&self.open)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_last_ten_minutes() {
        let now = SystemTime::now();
        let before = |seconds: u64| now - Duration::from_secs(seconds);
        let mut rate = Rate::default();
        assert_eq!(rate.per_s(now), None);
        // The first chunk took 20 s, and was done 80 s ago.
        rate.add(before(80), 20_000, now);
        rate.add(before(10), 20_000, now);
        assert_eq!(rate.per_s(now), Some(0.02));
        rate.add(before(3600), 0, now);
        assert_eq!(rate.per_s(now), Some(2.0 / 600.0));
        let mut old = Rate::default();
        old.add(before(3600), 0, now);
        assert_eq!(old.per_s(now), None);
    }
}
