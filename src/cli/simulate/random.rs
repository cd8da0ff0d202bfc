//! `palpate simulate random`: Sim-Random to a folder, with progress, and Ctrl-C as a request.
//! Uses: `simulate::random`, indicatif. Never: a decision about a byte of the shards.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;
use sim_core::batch::BatchModel;

use crate::cli::error::CliResult;
use crate::cli::next::Next;
use crate::cli::output::{self, bytes, counted, duration, grouped, say, say_json};
use crate::cli::progress::{LogLines, progress_bar, to_go};
use crate::cli::signals::Signals;
use crate::cli::simulate::request::{RandomRequest, SolvedRequest, threads};
use crate::cli::{At, data_or_default};
use crate::new_file::Look;
use crate::simulate::random::manifest::Manifest;
use crate::simulate::random::{Means, Outcome, Progress, generate};

/// Folder in the data folder whose folders of shards trainings read.
const TRAINED_FOLDER: &str = "sim-random";

/// Options of `simulate random`.
#[derive(Debug, Clone, Args)]
pub struct RandomArgs {
    #[command(flatten)]
    request: RandomRequest,
    /// Folder of the shards and their manifest.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of threads that simulate [default: the machine's cores]; they change no byte.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Read every byte of existing shards, instead of checking their length only.
    #[arg(long)]
    verify: bool,
    /// Print one line of JSON per shard, and a last one with totals, on standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the command. Exit code: 0 all trials exist, 1 failed or stopped, 2 bad input.
///
/// # Errors
/// `CliError` if an option is invalid, or a shard cannot be made.
pub async fn random(args: RandomArgs) -> CliResult<ExitCode> {
    let mut signals = Signals::catch()?;
    let stop = Arc::new(AtomicBool::new(false));
    let mut work = tokio::task::spawn_blocking({
        let stop = stop.clone();
        move || make(&args, &stop)
    });
    loop {
        tokio::select! {
            made = &mut work => {
                return made.unwrap_or_else(|e| std::panic::resume_unwind(e.into_panic()));
            }
            _ = signals.next() => {
                if stop.swap(true, Ordering::Relaxed) {
                    output::note("left; the same command resumes after the last complete shard");
                    return Ok(ExitCode::FAILURE);
                }
                output::note("stopping after this shard; Ctrl-C again leaves at once");
            }
        }
    }
}

fn make(args: &RandomArgs, stop: &AtomicBool) -> CliResult<ExitCode> {
    let threads = threads(args.threads)?;
    let SolvedRequest { definition, model, kernel, .. } = args.request.solve()?;
    let frames = BatchModel::new(&model, kernel);
    let look = if args.verify { Look::Sha256 } else { Look::Length };
    let mut screen = Screen::new(args);
    let means = Means { threads, look, stop };
    let outcome =
        generate(&definition, model.sensor(), &frames, &args.out, means, &mut |p| screen.tell(p));
    screen.bar.finish_and_clear();
    let outcome = outcome?;
    screen.end(&outcome, args);
    Ok(match outcome {
        Outcome::Complete(_) => ExitCode::SUCCESS,
        Outcome::Stopped(_) => ExitCode::FAILURE,
    })
}

/// Output: standard error for people, standard output for scripts.
struct Screen {
    bar: ProgressBar,
    lines: LogLines,
    json: bool,
    trials: u64,
    /// Number of trials whose shards were checked.
    checked: u64,
    found: u64,
    made: u64,
    stored: u64,
    started: Instant,
}

impl Screen {
    fn new(args: &RandomArgs) -> Self {
        let bar = progress_bar("trials");
        bar.set_length(args.request.trials);
        Self {
            lines: LogLines::instead_of(&bar),
            bar,
            json: args.json,
            trials: args.request.trials,
            checked: 0,
            found: 0,
            made: 0,
            stored: 0,
            started: Instant::now(),
        }
    }

    fn tell(&mut self, progress: Progress<'_>) {
        match progress {
            Progress::Checked(trials) => {
                self.checked += trials;
                self.bar.set_position(self.checked);
                self.bar.set_message("(check of existing shards)");
                let (checked, trials) = (self.checked, self.trials);
                self.lines.say(|| format!("{}/{} checked", grouped(checked), grouped(trials)));
            }
            Progress::Found { trials, damaged } => {
                self.found = trials;
                self.stored = trials;
                self.bar.set_position(trials);
                self.bar.set_message("");
                self.bar.reset_eta();
                if damaged > 0 {
                    let shards = counted(damaged, "shard is", "shards are");
                    let words = format!("{shards} missing or damaged: made again");
                    self.bar.suspend(|| output::note(words));
                }
            }
            Progress::Made(trials) => {
                self.made += trials;
                self.bar.inc(trials);
                let (done, trials, rate) = (self.found + self.made, self.trials, self.rate());
                self.lines.say(|| {
                    let left = to_go((trials - done) as f64 / rate);
                    let counts = format!("{}/{}", grouped(done), grouped(trials));
                    format!("{counts} {rate:.0} trials/s | {left}")
                });
            }
            Progress::Shard(row) => {
                self.stored += row.trials;
                if self.json {
                    let mut line = json!(row);
                    line["event"] = "shard".into();
                    say_json(&line);
                }
            }
        }
    }

    /// Trials per second in this process.
    fn rate(&self) -> f64 {
        self.made as f64 / self.started.elapsed().as_secs_f64().max(1e-9)
    }

    fn end(&self, outcome: &Outcome, args: &RandomArgs) {
        let (complete, Manifest { shards, .. }) = match outcome {
            Outcome::Complete(manifest) => (true, manifest),
            Outcome::Stopped(manifest) => (false, manifest),
        };
        let wall_s = self.started.elapsed().as_secs_f64();
        let size: u64 = shards.iter().map(|s| s.bytes).sum();
        if self.json {
            say_json(&json!({
                "event": "finished",
                "exit_status": if complete { "success" } else { "abort" },
                "trials_planned": self.trials,
                "trials_stored": self.stored,
                "trials_made": self.made,
                "shards": shards.len(),
                "bytes": size,
                "duration_s": wall_s,
                "trials_per_s": self.rate(),
                "folder": args.out,
            }));
            return;
        }
        let there = format!(
            "{} in {}, {}, in {}",
            counted(self.stored, "trial", "trials"),
            counted(shards.len() as u64, "shard", "shards"),
            bytes(size as f64),
            args.out.display(),
        );
        let (made, wall, rate) = (grouped(self.made), duration(wall_s), self.rate());
        let end = if complete { "" } else { "stopped: " };
        say(format_args!("{end}{there}; {made} made in {wall} ({rate:.0}/s)"));
        let next = Next::of(&At { data: args.request.data.clone(), ..At::default() });
        let data = data_or_default(args.request.data.clone());
        let next = match complete {
            true => after_all(next, &args.out, &data),
            false => next.same_command("again", "resumes after the last complete shard"),
        };
        next.say();
    }
}

/// The command for complete shards in `out`: a training reads only the folders in `sim-random` of the data folder.
fn after_all(next: Next, out: &Path, data: &Path) -> Next {
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let trained = data.join(TRAINED_FOLDER);
    let is_there = whole(out).parent().is_some_and(|folder| folder == whole(&trained));
    let what = match is_there {
        true => format!("learns from {}", trained.display()),
        false => format!("learns from {}: move the folder into it first", trained.display()),
    };
    next.suggest("palpate train recon-net", what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_elsewhere_are_to_be_moved_before_a_training_reads_them() {
        let temporary = tempfile::tempdir().unwrap();
        let data = temporary.path().join("data");
        let [inside, outside] = [data.join("sim-random/1"), temporary.path().join("shards")];
        for folder in [&inside, &outside] {
            std::fs::create_dir_all(folder).unwrap();
        }
        let words = |out: &Path| after_all(Next::default(), out, &data).text(None);
        let learns = format!("palpate train recon-net   learns from {}/sim-random", data.display());
        assert!(words(&inside).ends_with(&learns), "{}", words(&inside));
        let moved = format!("{learns}: move the folder into it first");
        assert!(words(&outside).ends_with(&moved), "{}", words(&outside));
        // The folder of all shards is none of them.
        assert!(words(&data.join("sim-random")).ends_with(&moved));
    }
}
