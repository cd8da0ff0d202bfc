//! `palpate train`: requests a training and follows it.
//! Uses: `client`. Never: nets (a process of the service trains).

use std::path::Path;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use serde_json::{Value, json};

use super::asking::Asking;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::files::read_or_carried;
use super::job::{JOB_POLL, JobScreen, shown};
use super::leave::{Choice, Interrupt, QUESTION_ON_TRAINING};
use super::next::Next;
use super::output::{duration, say, say_json, say_whole};
use super::own_server::OwnServer;
use super::signals::{Asked, Signals};
use super::{At, embed, job_losses};
use crate::api::{JobOut, ModelOut};
use crate::carried::{self, RECIPES};
use crate::dataset::force_map::ForceMapSpec;
use crate::evaluate::losses::{best, read};
use crate::file_kind::FileKind;
use crate::learn::recipe::{Net, map_channels};
use crate::learn::targets::Quantity;
use crate::problem::Problem;
use crate::store::TaskState;

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
    /// Request the training, and leave it to the service.
    #[arg(long, visible_alias = "detach")]
    no_wait: bool,
    #[command(flatten)]
    at: At,
}

/// Changes of a recipe.
#[derive(Debug, Clone, Default, Args)]
pub struct Changes {
    /// Name of the model [default: the recipe's].
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Name or id of a dataset [default: the recipe's].
    #[arg(long, value_name = "NAME")]
    pub dataset: Option<String>,
    /// A condition on its rows, `COLUMN__lte=VALUE`; may be repeated.
    #[arg(long = "where", value_name = "CONDITION")]
    pub conditions: Vec<String>,
    /// Quantity that it answers: position, pattern, count or force [default: the recipe's].
    #[arg(long, value_name = "QUANTITY", value_parser = quantities())]
    pub answers: Option<Quantity>,
    /// Pixel and diameter of the force maps, mm; those of a carried recipe are scaled to the skin [default: the
    /// recipe's].
    #[arg(long, value_name = "4x20")]
    pub map: Option<String>,
    /// Seed of the first weights, the order of samples and the noise [default: the recipe's].
    #[arg(long, value_name = "N")]
    pub seed: Option<i64>,
    /// Number of passes over the data [default: the recipe's].
    #[arg(long, value_name = "N")]
    pub epochs: Option<i64>,
    /// Largest number of rows for training, taken evenly [default: the recipe's].
    #[arg(long, value_name = "N")]
    pub rows: Option<i64>,
    /// Number of samples in a batch [default: the recipe's].
    #[arg(long, value_name = "N")]
    pub batch: Option<i64>,
    /// Factor on the noise of --noise-of [default: the recipe's].
    #[arg(long, value_name = "0.1")]
    pub noise: Option<f64>,
    /// Id, start of the id, or name of the Transfer-Net whose residuals are the noise [default: the recipe's].
    #[arg(long, value_name = "MODEL")]
    pub noise_of: Option<String>,
    /// Learn all epochs, without early stopping.
    #[arg(long)]
    pub all_epochs: bool,
}

/// Parser of the name of a quantity.
pub fn quantities() -> impl TypedValueParser<Value = Quantity> {
    let named = |name: String| Quantity::ALL.into_iter().find(|quantity| quantity.name() == name);
    PossibleValuesParser::new(Quantity::ALL.map(Quantity::name))
        .try_map(move |name| named(name).ok_or("must be the name of a quantity"))
}

/// Text of a recipe file, or of a carried recipe, with changes.
///
/// # Errors
/// `CliError::Problems` if the recipe cannot be read, or a change does not apply.
pub fn recipe_text(named: &str, changes: &Changes) -> CliResult<String> {
    let text = read_or_carried(FileKind::Recipe, Path::new(named), RECIPES)?;
    let mut recipe: toml::Table = crate::syntax::parse_toml(named, &text)?;
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
        let spec = self.map.as_ref().and_then(|map| map.parse::<ForceMapSpec>().ok());
        let mut net = training.get_mut("net").and_then(|net| net.as_table_mut());
        if let (Some(answers), Some(net)) = (self.answers, &mut net) {
            net.insert("answers".into(), answers.name().into());
        }
        if let (Some(spec), Some(net)) = (spec, net) {
            let side = spec.pixels() as i64;
            let known = net.clone().try_into::<Net>().ok();
            let channels = known.and_then(|known| map_channels(&known, side));
            net.insert("side".into(), side.into());
            if let Some(channels) = channels.filter(|_| !net.contains_key("channels")) {
                net.insert("channels".into(), channels.to_vec().into());
            }
        }
    }
}

/// Runs `palpate train`. Without a service it starts one, which a detached training outlives.
///
/// # Errors
/// `CliError` if the recipe is invalid, the service refuses, or the training fails or is stopped.
pub async fn train(args: TrainArgs) -> CliResult<()> {
    let recipe = recipe_text(&args.recipe, &args.changes)?;
    if args.show {
        say_whole(recipe.trim_end());
        return Ok(());
    }
    let mut signals = Signals::catch()?;
    let (client, own) = match embed::find(&args.at).await? {
        Some(client) => (client, None),
        None => {
            let own = signals.during(OwnServer::at_desk(&args.at.data())).await?;
            (own.client.clone(), Some(own))
        }
    };
    let process = own.as_ref().and_then(OwnServer::process);
    let done = async {
        let asked = request(&client, &args, &recipe).await?;
        train_on(&client, asked, &args, process, &mut signals).await
    };
    let reported = match done.await {
        Ok(None) => return Ok(()),
        Ok(Some(done)) => report(&client, &done, &args.at).await,
        Err(error) => Err(error),
    };
    if let Some(own) = own {
        own.end().await?;
    }
    reported
}

async fn request(client: &Client, args: &TrainArgs, recipe: &str) -> CliResult<JobOut> {
    let mut body = json!({ "recipe": recipe });
    // An earlier version of the service refuses it: it is sent only where it is needed.
    if has_default_map(&args.recipe, &args.changes) {
        body["scale_map"] = true.into();
    }
    let asked = client.post("/api/v1/trainings", &body).await;
    asked.map_err(|error| of_file(error, &args.recipe))
}

/// Whether the map is that of a carried recipe, and follows the size of the skin: a person states theirs in `--map`
/// or in a file.
fn has_default_map(recipe: &str, changes: &Changes) -> bool {
    changes.map.is_none() && !Path::new(recipe).exists()
}

/// The error of a service that does not know the name of the recipe.
fn of_file(error: CliError, named: &str) -> CliError {
    let CliError::Problems(problems) = error else { return error };
    let renamed = problems.into_iter().map(|problem| match problem.file.as_str() {
        "recipe" => Problem { file: named.into(), ..problem },
        _ => problem,
    });
    CliError::Problems(renamed.collect())
}

/// Follows a training to its end; none if it was left to the service, whose process is told if it is this
/// command's own.
async fn train_on(
    client: &Client,
    asked: JobOut,
    args: &TrainArgs,
    process: Option<u32>,
    signals: &mut Signals,
) -> CliResult<Option<JobOut>> {
    let (id, url) = (asked.task.id, client.url());
    if args.no_wait {
        shown(&asked, args.at.output());
    } else if !signals.hung_up()
        && let Some(done) = follow(client, asked, process.is_some(), signals).await?
    {
        return Ok(Some(done));
    }
    args.at.output().say(
        &json!({ "event": "detached", "job": id, "url": url, "process": process }),
        format_args!("training {id} continues without this terminal; its page is {url}/nets"),
    );
    let at = At { url: Some(url.into()), json: args.at.json, ..At::default() };
    let mut next = Next::of(&at).suggest(format_args!("palpate job show {id}"), "shows it");
    if let Some(process) = process {
        let what = "ends the service; the next one resumes the training";
        next = next.line(format_args!("kill {process}"), what);
    }
    next.say();
    Ok(None)
}

/// Prints the model of a training, and what to do with it.
async fn report(client: &Client, done: &JobOut, at: &At) -> CliResult<()> {
    let model = done.task.result.as_ref().and_then(|r| r["model"].as_str()).unwrap_or_default();
    let model: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
    if at.json {
        say_json(&json!({ "job": done, "model": model }));
        return Ok(());
    }
    let took = done.task.finished_at.zip(done.task.started_at);
    let took = took.map(|(end, start)| duration(end.duration_since(start).as_secs_f64()));
    say(format_args!("{} {}, trained in {}", model.id, model.name, took.unwrap_or_default()));
    let mut next = Next::of(at);
    let losses = read(&job_losses::losses(client, &done.task.id.to_string()).await?);
    if let Some((epoch, loss)) = best(&losses) {
        let epochs = losses.len();
        say(format_args!("best epoch {epoch} of {epochs}, validation loss {loss:.3e}"));
        next = next.suggest(
            format_args!("palpate job losses {} --plot losses.svg", done.task.id),
            "draws the learning curve",
        );
    }
    let ModelOut { id, task, .. } = &model;
    next = next.suggest(format_args!("palpate model show {id}"), "its facts and recipe");
    let is_of_quantity = Quantity::ALL.iter().any(|quantity| quantity.name() == task.as_str());
    if let Some(dataset) = done.task.dataset.as_ref().filter(|_| is_of_quantity) {
        next = next.suggest(
            format_args!("palpate evaluate quantity {task} --dataset {dataset} --net {id}"),
            "scores it, with ridge regressions",
        );
    }
    next.suggest(format_args!("palpate model promote {id}"), "makes it serve").say();
    Ok(())
}

/// Shows the progress of a job until it has ended; none if it was left to the service. Ctrl-C asks what to do,
/// or stops the job without a terminal. `own_service`: the service ends with this program.
///
/// # Errors
/// `CliError::Refused` if the job failed or was stopped; other variants if a request fails.
async fn follow(
    client: &Client,
    asked: JobOut,
    own_service: bool,
    signals: &mut Signals,
) -> CliResult<Option<JobOut>> {
    let mut screen = JobScreen::new();
    let mut asking = Asking::default();
    let mut interrupts = 0;
    let mut now = asked;
    loop {
        if screen.has_ended(&now)? {
            return Ok(Some(now));
        }
        let choice = tokio::select! {
            () = tokio::time::sleep(JOB_POLL) => None,
            line = asking.answer() => match Choice::of(&line) {
                Some(choice @ (Choice::Detach | Choice::Stop | Choice::Continue)) => Some(choice),
                Some(Choice::Pause | Choice::Resume) | None => {
                    screen.note(QUESTION_ON_TRAINING);
                    asking.open();
                    None
                }
            },
            signal = signals.next() => match signal {
                Asked::HangUp => Some(Choice::Detach),
                Asked::Terminate if own_service => return Err(CliError::Terminated),
                Asked::Terminate => Some(Choice::Detach),
                Asked::Interrupt => {
                    interrupts += 1;
                    match Interrupt::of(interrupts, Asking::is_possible()) {
                        Interrupt::Ask => {
                            screen.note(QUESTION_ON_TRAINING);
                            asking.open();
                            None
                        }
                        Interrupt::Stop | Interrupt::Abort | Interrupt::Leave => {
                            asking.close();
                            Some(Choice::Stop)
                        }
                    }
                }
            },
        };
        match choice {
            Some(Choice::Detach) => return Ok(None),
            Some(Choice::Stop) => {
                screen.note(stopping(now.task.state));
                let path = format!("/api/v1/jobs/{}/stop", now.task.id);
                client.post::<Value>(&path, &Value::Null).await?;
            }
            Some(Choice::Continue) => interrupts = 0,
            Some(Choice::Pause | Choice::Resume) | None => {}
        }
        now = client.get(&format!("/api/v1/jobs/{}", now.task.id)).await?;
    }
}

/// What a stop of a training does, by its state.
fn stopping(state: TaskState) -> &'static str {
    match state {
        TaskState::Waiting => {
            "taking the training out of the queue; the same command requests it again"
        }
        TaskState::Running | TaskState::Done | TaskState::Stopped | TaskState::Failed => {
            "stopping at a checkpoint, from which the same command resumes"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_map_of_a_carried_recipe_follows_the_skin() {
        let stated = Changes { map: Some("4x20".into()), ..Changes::default() };
        assert!(has_default_map("end-to-end", &Changes::default()));
        assert!(!has_default_map("end-to-end", &stated));
        assert!(!has_default_map("experiments/recipes/end-to-end.toml", &Changes::default()));
    }

    #[test]
    fn a_stop_states_how_the_training_resumes() {
        assert!(stopping(TaskState::Running).contains("the same command resumes"));
        let waiting = stopping(TaskState::Waiting);
        assert!(waiting.contains("out of the queue") && !waiting.contains("checkpoint"));
    }
}
