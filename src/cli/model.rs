//! `palpate model`: what models there are, what is known of them, and which serve.
//! Uses: `client`. Never: models of its own (the service keeps them).

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use serde_json::{Value, json};

use super::client::Client;
use super::error::CliError;
use super::files::{DEFAULT_SENSOR, read_input, write, write_bytes};
use super::output::{say, say_json};
use super::{At, embed};
use crate::api::{ModelOut, PromotionRequest, RollBackRequest, ServesOut, ServingOut};
use crate::evaluate::request::EvaluationReport;
use crate::infer::serving::Slot;

/// Options of `model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Show the models, newest first, their scores, and which serve.
    List(At),
    /// Show what is known of a model.
    Show(One),
    /// Let a model (by id or name), or a calibration (by id), serve from the next frame on.
    ///
    /// It is loaded and warmed first: no frame is dropped. Its place follows from what it does:
    /// transfer, map, points; a calibration is the skin of the exact method.
    Promote(Promote),
    /// Let what served before serve again.
    RollBack(RollBack),
    /// Show what serves, and what did.
    Serving(At),
    /// Write a model's ONNX file, and beside it (FILE.json) what is known of it: manifest and scores.
    Onnx(Onnx),
    /// Take in a model trained elsewhere: an ONNX file and what is known of it.
    ///
    /// FACTS is TOML with task, label, sensor, channels, output_shape and code, and for nets that
    /// give maps force_map, as in a manifest's table `model`.
    Add(Add),
    /// Keep a calibration file in the service, so that it can be promoted.
    AddCalibration(AddCalibration),
}

#[derive(Debug, Args)]
struct One {
    /// Its id or name.
    model: String,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct Promote {
    /// A model's id or name, or a calibration's id.
    what: String,
    /// Why.
    #[arg(long, value_name = "WORDS")]
    why: Option<String>,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct RollBack {
    /// transfer, map, points or skin.
    #[arg(value_parser = slot)]
    slot: Slot,
    /// Why.
    #[arg(long, value_name = "WORDS")]
    why: Option<String>,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct Onnx {
    /// Its id or name.
    model: String,
    /// Where to.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct Add {
    /// The ONNX file.
    #[arg(value_name = "ONNX")]
    file: PathBuf,
    /// What is known of it, TOML.
    #[arg(long, value_name = "FILE")]
    facts: PathBuf,
    /// What it is called.
    #[arg(long, value_name = "NAME")]
    name: String,
    /// Its sensor file [default: ert-28].
    #[arg(long, value_name = "FILE")]
    sensor: Option<PathBuf>,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Args)]
struct AddCalibration {
    /// The calibration file.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    at: At,
}

fn slot(name: &str) -> Result<Slot, String> {
    let found = Slot::ALL.into_iter().find(|slot| slot.name() == name);
    found.ok_or_else(|| format!("must be {}", Slot::ALL.map(Slot::name).join(", ")))
}

/// Longest wait for a promotion: a skin is made ready in most of a minute, on a busy machine in more.
const PROMOTING: Duration = Duration::from_secs(900);

/// Runs the command.
pub async fn model(args: ModelArgs) -> Result<(), CliError> {
    let at = match &args.what {
        What::List(at) | What::Serving(at) => at,
        What::Show(one) => &one.at,
        What::Promote(promote) => &promote.at,
        What::RollBack(back) => &back.at,
        What::Onnx(onnx) => &onnx.at,
        What::Add(add) => &add.at,
        What::AddCalibration(add) => &add.at,
    };
    let at = at.clone();
    embed::with_server(&at, move |client| answer(client, args.what)).await
}

async fn answer(client: Client, what: What) -> Result<(), CliError> {
    match what {
        What::List(at) => {
            let models: Vec<ModelOut> = client.get("/api/v1/models").await?;
            for model in models {
                if at.json {
                    say_json(&model);
                } else {
                    say(line(&model));
                }
            }
        }
        What::Show(one) => {
            let model: ModelOut = client.get(&format!("/api/v1/models/{}", one.model)).await?;
            if one.at.json {
                say_json(&model);
            } else {
                say(line(&model));
                let manifest = toml::to_string_pretty(&model.manifest).unwrap_or_default();
                say(manifest.trim_end());
            }
        }
        What::Promote(Promote { what, why, at }) => {
            let request = PromotionRequest { what, why, who: Some(client.who().into()) };
            let client = client.patient(PROMOTING);
            let serves: ServesOut = client.post("/api/v1/serving", &request).await?;
            tell(&serves, at.json);
        }
        What::RollBack(RollBack { slot, why, at }) => {
            let request = RollBackRequest { slot, why, who: Some(client.who().into()) };
            let client = client.patient(PROMOTING);
            let serves: ServesOut = client.post("/api/v1/serving/roll-back", &request).await?;
            tell(&serves, at.json);
        }
        What::Serving(at) => {
            let serving: ServingOut = client.get("/api/v1/serving").await?;
            if at.json {
                say_json(&serving);
            } else {
                serving.serves.iter().for_each(|serves| tell(serves, false));
            }
        }
        What::Onnx(Onnx { model, out, at }) => {
            let path = format!("/api/v1/models/{model}/onnx");
            let answer = client.send(reqwest::Method::GET, &path, None::<&Value>).await?;
            let operation = format!("GET {path}");
            let bytes = answer.bytes().await;
            let bytes = bytes.map_err(|source| CliError::Http { operation, source })?;
            write_bytes(&out, &bytes)?;
            let known: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
            let mut manifest = out.clone().into_os_string();
            manifest.push(".json");
            let manifest = PathBuf::from(manifest);
            write(&manifest, &format!("{:#}\n", json!(known)))?;
            if at.json {
                say_json(&json!({ "file": out, "bytes": bytes.len(), "manifest": manifest }));
            } else {
                let known = manifest.display();
                say(format_args!("{}: {} bytes; {known}", out.display(), bytes.len()));
            }
        }
        What::Add(add) => {
            let sensor = match &add.sensor {
                Some(path) => read_input(path)?,
                None => DEFAULT_SENSOR.to_owned(),
            };
            let texts = [
                ("sensor", sensor, None),
                ("facts", read_input(&add.facts)?, None),
                ("name", add.name.clone(), None),
            ];
            let model: ModelOut = client.upload("/api/v1/models", &add.file, texts).await?;
            if add.at.json { say_json(&model) } else { say(line(&model)) }
        }
        What::AddCalibration(add) => {
            let text = read_input(&add.file)?;
            let id: String = client.post_text("/api/v1/calibrations", text).await?;
            if add.at.json { say_json(&json!({ "calibration": id })) } else { say(id) }
        }
    }
    Ok(())
}

fn tell(serves: &ServesOut, as_json: bool) {
    if as_json {
        return say_json(serves);
    }
    say(format_args!("{:<9} {}", serves.slot.name(), serves.what.as_deref().unwrap_or("nothing")));
}

/// A model and its last score, on a line.
fn line(model: &ModelOut) -> String {
    let label = model.manifest["label"].as_str().unwrap_or_default();
    let serves = if model.serves { "serves" } else { "" };
    let mut line =
        format!("{} {:<28} {:<11} {label:<9} {serves:<6}", model.id, model.name, model.task);
    let last = model.scores.first().cloned().and_then(|report| serde_json::from_value(report).ok());
    if let Some(report) = last {
        line += &score(&report);
    }
    line.trim_end().to_owned()
}

fn score(report: &EvaluationReport) -> String {
    if let Some(voltages) = &report.voltages {
        return format!(" FVU {:.1} % of {} rows", 100.0 * voltages.all.fvu, report.rows);
    }
    let Some(contacts) = &report.contacts else { return String::new() };
    let mean = |mean: &Option<crate::evaluate::score::Mean>| mean.as_ref().map(|mean| mean.mean);
    let shown = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
    format!(
        " number {} %, location {} mm, force {} % of {} rows",
        shown(mean(&contacts.all.number_percent)),
        shown(mean(&contacts.all.location_mm)),
        shown(mean(&contacts.all.force_percent)),
        report.rows
    )
}
