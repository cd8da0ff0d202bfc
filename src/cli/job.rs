//! `palpate job`: waiting, running and ended trainings and evaluations; and the progress of one on the terminal.
//! Uses: `client`, `job_words`. Never: nets (a process of the service trains).

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use serde_json::Value;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::job_words::{details, phase_words, progress_words, warnings};
use super::next::Next;
use super::output::{Output, grouped, note, say, say_json, say_whole};
use super::picture::figure_file;
use super::progress::{LogLines, bar};
use super::table::Table;
use super::times::local;
use super::{At, embed, job_losses};
use crate::api::JobOut;
use crate::ids::TaskId;
use crate::store::TaskState;

/// Shortest start of an id, characters.
const START_MIN: usize = 4;
/// Characters of an id that the list shows at least.
const START_SHOWN: usize = 12;
/// Interval of polling a job's progress.
pub const JOB_POLL: Duration = Duration::from_millis(250);

/// Waits for the end of a job and shows its progress.
///
/// # Errors
/// `CliError::Refused` if the job failed or was stopped; other variants if a request fails.
pub async fn wait_for(client: &Client, asked: JobOut) -> CliResult<JobOut> {
    let client = client.quiet();
    let mut screen = JobScreen::new();
    let mut now = asked;
    while !screen.has_ended(&now)? {
        tokio::time::sleep(JOB_POLL).await;
        now = client.get(&format!("/api/v1/jobs/{}", now.task.id)).await?;
    }
    Ok(now)
}

/// Progress of a job, on standard error.
pub struct JobScreen {
    /// The bar; hidden without a terminal.
    bar: ProgressBar,
    lines: LogLines,
    /// Number of warnings that were shown.
    warned: usize,
}

impl JobScreen {
    /// A screen without a job.
    pub fn new() -> Self {
        let bar = bar("{bar:30} {msg}");
        let lines = LogLines::instead_of(&bar);
        Self { bar, lines, warned: 0 }
    }

    /// Prints a line above the bar.
    pub fn note(&self, text: &str) {
        self.bar.suspend(|| note(text));
    }

    /// Shows the job as it is now, and its new warnings; true if it is done.
    ///
    /// # Errors
    /// `CliError::Refused` if it failed or was stopped.
    pub fn has_ended(&mut self, now: &JobOut) -> CliResult<bool> {
        for warning in warnings(now).iter().skip(self.warned) {
            self.note(&format!("warning: {warning}"));
            self.warned += 1;
        }
        if let Some(progress) = &now.progress {
            self.bar.set_length(progress.total);
            self.bar.set_position(progress.done);
            self.bar.set_message(phase_words(progress));
            self.lines.say(|| progress_words(progress));
        }
        if now.task.state == TaskState::Waiting {
            self.bar.set_message("waits in the queue");
            self.lines.say(|| format!("{} waits in the queue", now.task.id));
        }
        match now.task.state {
            TaskState::Waiting | TaskState::Running => Ok(false),
            TaskState::Done => Ok(true),
            TaskState::Failed | TaskState::Stopped => {
                let stopped = "it was stopped; the same command resumes it from its checkpoint";
                let detail = now.task.error.clone().unwrap_or_else(|| stopped.into());
                Err(CliError::Refused { status: 409, detail, again: false })
            }
        }
    }
}

/// Options of `job`.
#[derive(Debug, Args)]
pub struct JobArgs {
    #[command(subcommand)]
    what: JobWhat,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Subcommand)]
enum JobWhat {
    /// Show trainings and evaluations, the last first.
    List,
    /// Show one job: its request, state, warnings and result.
    Show(OneJob),
    /// Stop a waiting or running job.
    Stop(OneJob),
    /// Print the losses of a training, one JSON object per epoch, or draw them.
    Losses {
        #[command(flatten)]
        one: OneJob,
        /// Draw training and validation loss over the epochs instead; the ending of the name decides:
        /// .svg, .png or .pdf.
        #[arg(long, value_name = "FILE.svg", value_parser = figure_file)]
        plot: Option<PathBuf>,
    },
}

#[derive(Debug, Args)]
struct OneJob {
    /// Job: its number in `job list`, `last`, or its id, of which the start is enough if it is unique.
    job: String,
}

/// Runs `palpate job`.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses.
pub async fn job(args: JobArgs) -> CliResult<()> {
    let JobArgs { what, at } = args;
    let output = at.output();
    let purpose = match what {
        JobWhat::Stop(_) => embed::Purpose::Stores,
        _ => embed::Purpose::Reads,
    };
    embed::with_purpose(&at, purpose, async |client| {
        match what {
            JobWhat::List => {
                let jobs: Vec<JobOut> = client.all("/api/v1/jobs?").await?;
                match output {
                    Output::Json => jobs.iter().for_each(say_json),
                    Output::Text => say(table(&jobs)),
                }
            }
            JobWhat::Show(OneJob { job }) => {
                let id = named(client, &job).await?;
                let job: JobOut = client.get(&format!("/api/v1/jobs/{id}")).await?;
                output.say(&job, details(&job));
                if let Some(model) = job.task.result.as_ref().and_then(|of| of["model"].as_str()) {
                    Next::of(&at)
                        .suggest(format_args!("palpate model show {model}"), "its facts and scores")
                        .say();
                }
            }
            JobWhat::Stop(OneJob { job }) => {
                let path = format!("/api/v1/jobs/{}/stop", named(client, &job).await?);
                let job: JobOut = client.post(&path, &Value::Null).await?;
                shown(&job, output);
            }
            JobWhat::Losses { plot, one } => {
                let id = named(client, &one.job).await?;
                match plot {
                    Some(file) => {
                        job_losses::draw(client, &id, &file).await?;
                        Next::of(&at)
                            .suggest(format_args!("palpate job show {id}"), "its state and result")
                            .say();
                    }
                    None => match job_losses::losses(client, &id).await?.trim_end() {
                        "" => note("there are no losses yet: the first ones come with an epoch"),
                        losses => say_whole(losses),
                    },
                }
            }
        }
        Ok(())
    })
    .await
}

/// Returns the id of the job that a person named; what names none as it is, for the service to refuse.
async fn named(client: &Client, text: &str) -> CliResult<String> {
    if matches!(text.parse(), Ok(TaskId::Job(_))) {
        return Ok(text.to_owned());
    }
    let jobs: Vec<JobOut> = client.all("/api/v1/jobs?").await?;
    let ids: Vec<String> = jobs.iter().map(|job| job.task.id.to_string()).collect();
    match meant(&ids, text)[..] {
        [] => Ok(text.to_owned()),
        [id] => Ok(id.to_owned()),
        [..] => {
            let limit = "several jobs begin like this: palpate job list shows their numbers";
            Err(CliError::argument("JOB", text, limit))
        }
    }
}

/// The ids that a text may mean, of those of all jobs, the newest first: by number, from 1 for the oldest, `last`, or
/// the start of the id.
fn meant<'a>(newest_first: &'a [String], text: &str) -> Vec<&'a str> {
    let place = match text.parse::<usize>() {
        // No number begins with 0, but each id does.
        Ok(number) if !text.starts_with('0') => newest_first.len().checked_sub(number),
        _ => (text == "last").then_some(0),
    };
    if let Some(id) = place.and_then(|place| newest_first.get(place)) {
        return vec![id.as_str()];
    }
    let is_meant = |id: &&str| {
        let uuid = id.strip_prefix("job-").unwrap_or(id);
        text.len() >= START_MIN && (id.starts_with(text) || uuid.starts_with(text))
    };
    newest_first.iter().map(String::as_str).filter(is_meant).collect()
}

fn table(jobs: &[JobOut]) -> Table {
    let mut table = Table::new(
        "job | number> | state | requested | what | progress",
        "there are no jobs: palpate train RECIPE",
    );
    let all: Vec<_> = jobs.iter().map(cells).collect();
    let shown = unique_start(all.iter().map(|[id, ..]| id.as_str()));
    for (number, [mut id, state, requested, what, more]) in (1..=all.len()).rev().zip(all) {
        id.truncate(shown);
        table.push([id, number.to_string(), state, requested, what, more]);
    }
    table
}

/// Number of characters with which each of the ids begins differently, at least `START_SHOWN`: a whole id leaves no room
/// for the progress on a terminal.
fn unique_start<'a>(ids: impl Iterator<Item = &'a str>) -> usize {
    let mut sorted: Vec<&str> = ids.collect();
    sorted.sort_unstable();
    let shared = |a: &str, b: &str| a.bytes().zip(b.bytes()).take_while(|(a, b)| a == b).count();
    sorted.windows(2).map(|pair| shared(pair[0], pair[1]) + 1).fold(START_SHOWN, usize::max)
}

fn cells(job: &JobOut) -> [String; 5] {
    let name = job_losses::recipe_name(job).unwrap_or_else(|| {
        format!("{} on {}", job.task.request["scored"], job.task.request["dataset"])
            .replace('"', "")
    });
    let more = job.task.error.clone().or_else(|| {
        let progress = job.progress.as_ref()?;
        let (done, total) = (grouped(progress.done), grouped(progress.total));
        Some(format!("{} {done} of {total}", progress.phase))
    });
    let requested = local(job.task.created_at);
    [job.task.id.to_string(), job.task.state.to_string(), requested, name, more.unwrap_or_default()]
}

/// Prints one line on a job, or its JSON.
pub fn shown(job: &JobOut, output: Output) {
    let cells = cells(job).into_iter().filter(|cell| !cell.is_empty());
    output.say(job, cells.collect::<Vec<_>>().join("  "));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_named_by_its_number_last_or_the_start_of_its_id() {
        let ids = ["job-0192ab", "job-0192aa", "job-0191ff"].map(str::to_owned);
        for (text, wanted) in [
            ("1", &["job-0191ff"][..]),
            ("3", &["job-0192ab"]),
            ("last", &["job-0192ab"]),
            ("0191", &["job-0191ff"]),
            ("job-0192aa", &["job-0192aa"]),
            ("0192", &["job-0192ab", "job-0192aa"]),
            ("4", &[]),
            ("0", &[]),
            ("01", &[]),
            ("019", &[]),
        ] {
            assert_eq!(meant(&ids, text), wanted, "{text}");
        }
        assert!(meant(&[], "last").is_empty());
    }

    #[test]
    fn a_list_begins_with_the_start_of_each_id_that_names_it() {
        let job = |id: &str| {
            let id = format!("job-0192ab34-{id}");
            let task = serde_json::json!({ "id": id, "kind": "training", "state": "done",
                "request": { "recipe": "name = \"net\"" }, "asked_by": "ada",
                "created_at": "2026-11-24T22:00:00Z" });
            serde_json::from_value::<JobOut>(task).unwrap()
        };
        let jobs = [job("7c1b-7000-8000-000000000001"), job("7c1a-7000-8000-000000000000")];
        let shown = table(&jobs).to_string();
        let columns = |line: &str| line.split_whitespace().take(3).collect::<Vec<_>>().join(" ");
        let lines = ["job number state", "job-0192ab34-7c1b 2 done", "job-0192ab34-7c1a 1 done"];
        assert_eq!(shown.lines().map(columns).collect::<Vec<_>>(), lines);
        let alone = table(&jobs[..1]).to_string();
        assert_eq!(alone.lines().last().map(columns).unwrap(), "job-0192ab34 1 done");
    }
}
