//! `palpate train`: requests a training and shows it; `palpate job`: waiting, running and ended
//! jobs.
//! Uses: `client`. Never: nets (a process of the service trains).

use std::path::Path;
use std::time::Duration;

use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::files::read_input;
use super::output::{duration, say, say_json};
use super::progress::LogLines;
use super::{At, embed};
use crate::api::{JobOut, ModelOut};
use crate::carried::{self, RECIPES};
use crate::jobs::Progress;
use crate::store::TaskState;

/// Interval of polling a job's progress.
const LOOK: Duration = Duration::from_millis(250);

/// Largest side of maps, pixels, that are drawn with fewer layers than a recipe's default: from a
/// first image of 8 or 4 pixels, as larger maps are from one of 10.
const FEW_PIXELS: i64 = 64;
const FEWER_CHANNELS: [i64; 3] = [128, 64, 32];

/// Help of the argument RECIPE.
fn recipe_help() -> String {
    let names: Vec<&str> = carried::names(RECIPES).collect();
    format!("A recipe file, or a carried recipe: {}", names.join(", "))
}

/// Options of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    #[arg(value_name = "RECIPE", help = recipe_help())]
    recipe: String,
    #[command(flatten)]
    changes: Changes,
    /// Show the recipe without training.
    #[arg(long)]
    show: bool,
    /// Request the training, and do not wait for its end.
    #[arg(long)]
    no_wait: bool,
    #[command(flatten)]
    at: At,
}

/// Changes of a recipe.
#[derive(Debug, Clone, Default, Args)]
pub struct Changes {
    /// Name of the model.
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Name or id of a dataset.
    #[arg(long, value_name = "NAME")]
    pub dataset: Option<String>,
    /// A condition on its rows, `COLUMN__lte=VALUE`; may be repeated.
    #[arg(long = "where", value_name = "CONDITION")]
    pub conditions: Vec<String>,
    /// Pixel and diameter of the force maps, mm.
    #[arg(long, value_name = "4x20")]
    pub map: Option<String>,
    /// Seed of the first weights, the order of samples and the noise.
    #[arg(long, value_name = "N")]
    pub seed: Option<i64>,
    /// Number of passes over the data.
    #[arg(long, value_name = "N")]
    pub epochs: Option<i64>,
    /// Largest number of rows for training, taken evenly.
    #[arg(long, value_name = "N")]
    pub rows: Option<i64>,
    /// Number of samples in a batch.
    #[arg(long, value_name = "N")]
    pub batch: Option<i64>,
    /// Factor on the noise of --noise-of.
    #[arg(long, value_name = "0.1")]
    pub noise: Option<f64>,
    /// The Transfer-Net whose residuals are the noise.
    #[arg(long, value_name = "MODEL")]
    pub noise_of: Option<String>,
    /// Learn all epochs, without early stopping.
    #[arg(long)]
    pub all_epochs: bool,
}

/// Text of a recipe file, or of a carried recipe, with changes.
///
/// # Errors
/// `CliError::Problems` if the recipe cannot be read, or a change does not apply.
pub fn recipe_text(named: &str, changes: &Changes) -> Result<String, CliError> {
    let text = match carried::text(RECIPES, named) {
        Some(text) => text.to_owned(),
        None => read_input(Path::new(named))?,
    };
    let unread = |error: toml::de::Error| {
        let problem = crate::syntax::syntax_problem(named, &text, &error);
        CliError::Problems(vec![problem])
    };
    let mut recipe: toml::Table = toml::from_str(&text).map_err(unread)?;
    changes.apply(&mut recipe);
    toml::to_string(&recipe).map_err(|error| CliError::argument("RECIPE", named, error.to_string()))
}

impl Changes {
    fn apply(&self, recipe: &mut toml::Table) {
        let mut set = |key: &str, value: Option<toml::Value>| {
            if let Some(value) = value {
                recipe.insert(key.into(), value);
            }
        };
        let text = |value: &Option<String>| value.clone().map(toml::Value::String);
        set("name", text(&self.name));
        set("dataset", text(&self.dataset));
        set("map", text(&self.map));
        set("noise_of", text(&self.noise_of));
        set("rows", self.rows.map(Into::into));
        if !self.conditions.is_empty() {
            let conditions = self.conditions.iter().cloned().map(toml::Value::String);
            set("where", Some(toml::Value::Array(conditions.collect())));
        }
        let Some(training) = recipe.get_mut("training").and_then(|t| t.as_table_mut()) else {
            return;
        };
        for (key, value) in [("seed", self.seed), ("epochs", self.epochs), ("batch", self.batch)] {
            if let Some(value) = value {
                training.insert(key.into(), value.into());
            }
        }
        if self.all_epochs {
            training.remove("patience");
        }
        if let Some(level) = self.noise {
            let noise = training.entry("noise").or_insert_with(|| toml::Table::new().into());
            if let Some(noise) = noise.as_table_mut() {
                noise.insert("level".into(), level.into());
            }
        }
        // The side of the maps follows from their pixels.
        let pixel_mm = self.map.as_ref().and_then(|map| map.split('x').next()?.parse::<f64>().ok());
        let net = training.get_mut("net").and_then(|net| net.as_table_mut());
        if let (Some(pixel_mm), Some(net)) = (pixel_mm, net) {
            let side = (crate::dataset::force_map::SIDE_MM / pixel_mm).round() as i64;
            net.insert("side".into(), side.into());
            if side <= FEW_PIXELS && !net.contains_key("channels") {
                net.insert("channels".into(), FEWER_CHANNELS.to_vec().into());
            }
        }
    }
}

/// Runs `palpate train`.
///
/// # Errors
/// `CliError` if the recipe is invalid, the service refuses, or the training fails.
pub async fn train(args: TrainArgs) -> Result<(), CliError> {
    let recipe = recipe_text(&args.recipe, &args.changes)?;
    if args.show {
        say(recipe.trim_end());
        return Ok(());
    }
    let at = args.at.clone();
    embed::with_server(&at, move |client| async move {
        let asked: JobOut = client.post("/api/v1/trainings", &json!({ "recipe": recipe })).await?;
        if args.no_wait {
            shown(&asked, args.at.json);
            return Ok(());
        }
        let done = follow(&client, asked).await?;
        let model = done.result.as_ref().and_then(|r| r["model"].as_str()).unwrap_or_default();
        let model: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
        if args.at.json {
            say_json(&json!({ "job": done, "model": model }));
        } else {
            let took = done.finished_at.zip(done.started_at);
            let took = took.map(|(end, start)| duration(end.duration_since(start).as_secs_f64()));
            say(format_args!(
                "{} {}, trained in {}",
                model.id,
                model.name,
                took.unwrap_or_default()
            ));
        }
        Ok(())
    })
    .await
}

/// Shows the progress of a job until it has ended.
///
/// # Errors
/// `CliError::Refused` if the job failed or was stopped; other variants if a request fails.
pub async fn follow(client: &Client, asked: JobOut) -> Result<JobOut, CliError> {
    let bar = job_bar();
    let mut lines = LogLines::instead_of(&bar);
    let mut now = asked;
    loop {
        if let Some(progress) = &now.progress {
            bar.set_length(progress.total);
            bar.set_position(progress.done);
            bar.set_message(words(progress));
            lines.say(|| match progress.total {
                0 => words(progress),
                total => format!("{} of {total}, {}", progress.done, words(progress)),
            });
        }
        if now.state == TaskState::Waiting {
            bar.set_message("waits in the queue");
            lines.say(|| format!("{} waits in the queue", now.id));
        }
        match now.state {
            TaskState::Done => {
                bar.finish_and_clear();
                return Ok(now);
            }
            TaskState::Failed | TaskState::Stopped => {
                bar.abandon();
                let operation = now.id.to_string();
                let detail = now.error.unwrap_or_else(|| "it was stopped".into());
                return Err(CliError::Refused { operation, status: 409, detail });
            }
            TaskState::Waiting | TaskState::Running => tokio::time::sleep(LOOK).await,
        }
        now = client.get(&format!("/api/v1/jobs/{}", now.id)).await?;
    }
}

fn job_bar() -> ProgressBar {
    use std::io::IsTerminal;
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:30} {msg}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn words(progress: &Progress) -> String {
    let mut words = progress.phase.clone();
    if let Some(epoch) = progress.epoch {
        words += &format!(", epoch {epoch}");
    }
    if let Some(loss) = progress.train_loss {
        words += &format!(", loss {loss:.3e}");
    }
    if let Some(loss) = progress.validation_loss {
        words += &format!(", validation {loss:.3e}");
    }
    if let Some(rate) = progress.per_second {
        words += &format!(", {rate:.0}/s");
    }
    if let Some(left_s) = progress.left_s {
        words += &format!(", {} to go", duration(left_s));
    }
    words
}

/// Options of `job`.
#[derive(Debug, Args)]
pub struct JobArgs {
    #[command(subcommand)]
    what: JobWhat,
}

#[derive(Debug, Subcommand)]
enum JobWhat {
    /// Show trainings and evaluations, the last first.
    List(At),
    /// Show one job and its result.
    Show(OneJob),
    /// Stop a waiting or running job.
    Stop(OneJob),
    /// Print the losses of a running training, one JSON object per epoch.
    Losses(OneJob),
}

#[derive(Debug, Args)]
struct OneJob {
    /// Id of the job.
    job: String,
    #[command(flatten)]
    at: At,
}

/// Runs `palpate job`.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses.
pub async fn job(args: JobArgs) -> Result<(), CliError> {
    let at = match &args.what {
        JobWhat::List(at) => at.clone(),
        JobWhat::Show(one) | JobWhat::Stop(one) | JobWhat::Losses(one) => one.at.clone(),
    };
    embed::with_server(&at, move |client| async move {
        match args.what {
            JobWhat::List(at) => {
                let jobs: Vec<JobOut> = client.all("/api/v1/jobs?").await?;
                jobs.iter().for_each(|job| shown(job, at.json));
            }
            JobWhat::Show(one) => {
                let job: JobOut = client.get(&format!("/api/v1/jobs/{}", one.job)).await?;
                say_json(&job);
            }
            JobWhat::Stop(one) => {
                let path = format!("/api/v1/jobs/{}/stop", one.job);
                let job: JobOut = client.post(&path, &Value::Null).await?;
                shown(&job, one.at.json);
            }
            JobWhat::Losses(one) => {
                let path = format!("/api/v1/jobs/{}/losses", one.job);
                let answer = client.send(reqwest::Method::GET, &path, None::<&Value>).await?;
                let operation = format!("GET {path}");
                let text = answer.text().await;
                let text = text.map_err(|source| CliError::Http { operation, source })?;
                say(text.trim_end());
            }
        }
        Ok(())
    })
    .await
}

fn shown(job: &JobOut, as_json: bool) {
    if as_json {
        return say_json(job);
    }
    let name = match job.request["recipe"].as_str() {
        Some(recipe) => toml::from_str::<toml::Table>(recipe)
            .ok()
            .and_then(|recipe| recipe.get("name")?.as_str().map(str::to_owned))
            .unwrap_or_default(),
        None => format!("{} on {}", job.request["scored"], job.request["dataset"]).replace('"', ""),
    };
    let state = job.state.to_string();
    let more = job.error.clone().or_else(|| {
        let progress = job.progress.as_ref()?;
        Some(format!("{} {} of {}", progress.phase, progress.done, progress.total))
    });
    say(format_args!("{} {state:<8} {name} {}", job.id, more.unwrap_or_default()));
}
