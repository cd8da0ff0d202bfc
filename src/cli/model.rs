//! `palpate model`: lists, shows, promotes and adds models.
//! Uses: `client`, `calibrate::judgement`. Never: models in this process (the service stores them).

use std::fmt::Display;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use reqwest::multipart::Part;
use serde_json::{Value, json};
use sim_core::calibration::Calibration;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::files::{DEFAULT_SENSOR, read_input, write};
use super::next::Next;
use super::output::{Output, counted, note, say, say_json};
use super::table::Table;
use super::{At, embed};
use crate::api::{ModelOut, PromotionRequest, RollBackRequest, ServesOut, ServingOut};
use crate::calibrate::judgement;
use crate::evaluate::quantities::QuantityScores;
use crate::evaluate::request::EvaluationReport;
use crate::ids::{CalibrationId, PromotedId};
use crate::infer::slot::Slot;

/// Options of `model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    at: At,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Show the models, newest first, with their scores, and which serve.
    List,
    /// Show the facts of a model.
    Show {
        /// Id of the model, start of the id (mdl- and 6 digits or more), or name.
        model: String,
    },
    /// Make a model (by id, start of the id, or name), or a calibration (by id), serve from the next frame on.
    ///
    /// It is loaded and warmed first: no frame is dropped. Its slot follows from its task:
    /// transfer, map, points, position, pattern, count, force; a calibration is the skin of the exact method. A model of
    /// another sensor than the rig's answers as SLOT@SENSOR, such as position@pad-60.
    Promote {
        /// Id, start of the id, or name of a model, or id of a calibration.
        what: String,
        /// Reason, for the log of actions.
        #[arg(long, value_name = "WORDS")]
        why: Option<String>,
    },
    /// Restore the previous promotion of a slot.
    RollBack {
        /// Slot: transfer, map, points, skin, position, pattern, count or force.
        #[arg(value_parser = slot)]
        slot: Slot,
        /// Name of its sensor [default: that of the rig].
        #[arg(long, value_name = "NAME")]
        sensor: Option<String>,
        /// Reason, for the log of actions.
        #[arg(long, value_name = "WORDS")]
        why: Option<String>,
    },
    /// Show the serving models, and earlier promotions.
    Serving,
    /// Write a model's ONNX file, and its manifest and scores to FILE.json.
    Onnx {
        /// Id of the model, start of the id (mdl- and 6 digits or more), or name.
        model: String,
        /// Path of the ONNX file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Add a model trained elsewhere: an ONNX file and its facts.
    ///
    /// FACTS is TOML with task, label, sensor, channels, output_shape and code, and for nets with
    /// force maps force_map, as in a manifest's table `model`.
    Add {
        /// ONNX file of the model.
        #[arg(value_name = "ONNX")]
        file: PathBuf,
        /// File with its facts, TOML.
        #[arg(long, value_name = "FILE")]
        facts: PathBuf,
        /// Name of the model.
        #[arg(long, value_name = "NAME")]
        name: String,
        /// Its sensor file [default: ert-28].
        #[arg(long, value_name = "FILE")]
        sensor: Option<PathBuf>,
    },
    /// Store a calibration file in the service, so that it can be promoted.
    AddCalibration {
        /// Calibration file to store.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

fn slot(name: &str) -> Result<Slot, String> {
    let found = Slot::ALL.iter().copied().find(|slot| slot.name() == name);
    let names = || Slot::ALL.iter().map(|slot| slot.name()).collect::<Vec<_>>().join(", ");
    found.ok_or_else(|| format!("must be {}", names()))
}

/// Longest wait for a promotion: the preparation of a skin takes most of a minute, or longer under
/// load.
const PROMOTING: Duration = Duration::from_secs(900);

/// Runs `palpate model`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, refuses, or a file cannot be used.
pub async fn model(args: ModelArgs) -> CliResult<()> {
    let ModelArgs { what, at } = args;
    let purpose = match what {
        What::List | What::Show { .. } | What::Serving | What::Onnx { .. } => embed::Purpose::Reads,
        _ => embed::Purpose::Stores,
    };
    embed::with_purpose(&at, purpose, async |client| answer(client, what, &at).await).await
}

async fn answer(client: &Client, what: What, at: &At) -> CliResult<()> {
    match what {
        What::List => {
            let models: Vec<ModelOut> = client.all("/api/v1/models?").await?;
            match at.output() {
                Output::Json => models.iter().for_each(say_json),
                Output::Text => say(table(&models)),
            }
        }
        What::Show { model } if model.parse::<CalibrationId>().is_ok() => {
            let limit = "is a calibration: palpate model serving shows the one that serves";
            return Err(CliError::argument("MODEL", model, limit));
        }
        What::Show { model } => {
            let model: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
            let manifest = toml::to_string_pretty(&model.manifest).unwrap_or_default();
            let words = format!("{}{}\n{}", line(&model), warned(&model), manifest.trim_end());
            at.output().say_whole(&model, words);
        }
        What::Promote { what, why } => {
            let request = PromotionRequest { what, why, who: Some(client.who().into()) };
            let client = client.patient(PROMOTING).showing("loading and warming up");
            let serves: ServesOut = client.post("/api/v1/serving", &request).await?;
            at.output().say(&serves, words(&serves));
            let slot = serves.slot.name();
            let next = Next::of(at);
            let next = match &serves.sensor {
                Some(sensor) => next
                    .suggest(
                        format_args!("palpate infer FILE --model {slot}@{sensor}"),
                        "answers frames of its sensor",
                    )
                    .suggest(
                        format_args!("palpate model roll-back {slot} --sensor {sensor}"),
                        "restores the one before",
                    ),
                None => {
                    let next = match serves.slot.is_quantity() {
                        true => next
                            .suggest("palpate live --quantities", "its answers on the rig's skin"),
                        false => next.suggest("palpate live", "contacts on the rig's skin"),
                    };
                    next.suggest(
                        format_args!("palpate model roll-back {slot}"),
                        "restores the one before",
                    )
                }
            };
            next.say();
        }
        What::RollBack { slot, sensor, why } => {
            let request = RollBackRequest { slot, sensor, why, who: Some(client.who().into()) };
            let client = client.patient(PROMOTING).showing("loading and warming up");
            let serves: ServesOut = client.post("/api/v1/serving/roll-back", &request).await?;
            at.output().say(&serves, words(&serves));
        }
        What::Serving => {
            let serving: ServingOut = client.get("/api/v1/serving").await?;
            if at.json {
                say_json(&serving);
            } else {
                for serves in serving.serves.iter().chain(&serving.elsewhere) {
                    say(words(serves));
                    if let Some(restores) = &serves.restores {
                        say(format_args!("          roll-back restores {}", restores.as_str()));
                    }
                }
            }
        }
        What::Onnx { model, out } => {
            let path = format!("/api/v1/models/{model}/onnx");
            let answer = client.send(reqwest::Method::GET, &path, None::<&Value>).await?;
            let bytes = answer.bytes().await?;
            write(&out, &bytes)?;
            let known: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
            let manifest = out.with_added_extension("json");
            write(&manifest, &format!("{:#}\n", json!(known)))?;
            let written = json!({ "file": out, "bytes": bytes.len(), "manifest": manifest });
            let (file, known) = (out.display(), manifest.display());
            at.output().say(&written, format_args!("{file}: {} bytes; {known}", bytes.len()));
        }
        What::Add { file, facts, name, sensor } => {
            let sensor = match sensor {
                Some(path) => read_input(&path)?,
                None => DEFAULT_SENSOR.to_owned(),
            };
            let texts = [
                ("sensor", Part::text(sensor)),
                ("facts", Part::text(read_input(&facts)?)),
                ("name", Part::text(name)),
            ];
            let client = client.showing("checking the model");
            let model: ModelOut = client.upload("/api/v1/models", &file, texts).await?;
            at.output().say(&model, line(&model));
            promotion(at, &model.id).say();
        }
        What::AddCalibration { file } => {
            let text = read_input(&file)?;
            let limitation = limitation(&text);
            let id: CalibrationId = client.post_text("/api/v1/calibrations", text).await?;
            at.output().say(&json!({ "calibration": id, "limitation": limitation }), &id);
            if let Some(words) = limitation.filter(|_| !at.json) {
                note(format_args!("note: {words}"));
            }
            promotion(at, &id).say();
        }
    }
    Ok(())
}

/// What limits the answers of the skin in a calibration file, by the evidence of its fit.
fn limitation(text: &str) -> Option<String> {
    let skin = Calibration::from_toml(text).ok()?.skin?;
    judgement::limitation(&skin.evidence)
}

/// The command that makes what was added serve.
fn promotion(at: &At, id: impl Display) -> Next {
    Next::of(at).suggest(format_args!("palpate model promote {id}"), "makes it serve")
}

fn words(serves: &ServesOut) -> String {
    let what = serves.what.as_ref().map_or("nothing", PromotedId::as_str);
    let of = serves.sensor.as_ref().map(|sensor| format!(" of sensor {sensor}"));
    let note = serves.limitation.as_ref().map(|words| format!("\n          note: {words}"));
    format!(
        "{:<9} {what}{}{}",
        serves.slot.name(),
        of.unwrap_or_default(),
        note.unwrap_or_default()
    )
}

/// Models with their last scores.
fn table(models: &[ModelOut]) -> Table {
    let mut table = Table::new(
        "model | name | task | label | state | last score",
        "there are no models: palpate train RECIPE (calibrations: palpate model serving)",
    );
    models.iter().for_each(|model| table.push(cells(model)));
    table
}

fn cells(model: &ModelOut) -> [String; 6] {
    let label = model.manifest["label"].as_str().unwrap_or_default();
    let last = model.scores.first().cloned().and_then(|report| serde_json::from_value(report).ok());
    [
        model.id.to_string(),
        model.name.clone(),
        model.task.clone(),
        label.into(),
        if model.serves { "serves" } else { "" }.into(),
        last.map_or_else(|| "not scored".into(), |report| score(&report)),
    ]
}

/// The warnings of a model's training, each on a further line.
fn warned(model: &ModelOut) -> String {
    model.warnings.iter().map(|warning| format!("\nwarning: {warning}")).collect()
}

/// A model and its last score, on one line.
fn line(model: &ModelOut) -> String {
    let cells = cells(model).into_iter().filter(|cell| !cell.is_empty());
    cells.collect::<Vec<_>>().join("  ")
}

/// The most important scores of an evaluation, on one line.
pub fn score(report: &EvaluationReport) -> String {
    let rows_of = |rows: u64| counted(rows, "row", "rows");
    let rows = rows_of(report.rows);
    if let Some(voltages) = &report.voltages {
        return format!("FVU {:.1} % of {rows}", 100.0 * voltages.all.fvu);
    }
    if let Some(scores) = &report.quantity {
        return format!("{} {} of {}", scores.quantity, wrong(scores), rows_of(scores.rows));
    }
    let Some(contacts) = &report.contacts else { return String::new() };
    let mean = |mean: &Option<crate::evaluate::score::Mean>| mean.as_ref().map(|mean| mean.mean);
    let shown = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
    format!(
        "number {} %, location {} mm, force {} % of {rows}",
        shown(mean(&contacts.all.number_percent)),
        shown(mean(&contacts.all.location_mm)),
        shown(mean(&contacts.all.force_percent)),
    )
}

/// How wrong answers of a quantity are.
fn wrong(scores: &QuantityScores) -> String {
    match (scores.right, scores.quantity.as_str()) {
        (Some(right), _) => format!("right in {:.1} %", 100.0 * right.mean),
        (None, "position") => format!("wrong by {:.2} mm", scores.error.mean),
        (None, _) => format!("wrong by {:.2} N", scores.error.mean),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::score::Mean;
    use crate::ids::ModelId;

    #[test]
    fn the_score_of_a_quantity_states_its_unit() {
        let mean = Mean::of_rows(&[0.5, 1.0], 1);
        let scores = |quantity: &str, right: Option<Mean>| QuantityScores {
            quantity: quantity.into(),
            rows: 2,
            left_out: 0,
            error: mean.unwrap(),
            median_error: 0.75,
            right,
            constant_error: 9.0,
        };
        assert_eq!(wrong(&scores("position", None)), "wrong by 0.75 mm");
        assert_eq!(wrong(&scores("force", None)), "wrong by 0.75 N");
        assert_eq!(wrong(&scores("count", mean)), "right in 75.0 %");
    }

    #[test]
    fn a_model_without_a_score_is_listed_as_not_scored() {
        let model = ModelOut {
            id: ModelId::unchecked("mdl-1"),
            name: "mlp-force".into(),
            task: "force".into(),
            slot: None,
            manifest: json!({ "label": "virtual" }),
            created_at: jiff::Timestamp::UNIX_EPOCH,
            serves: false,
            scores: Vec::new(),
            warnings: vec!["3 of 9 channels are constant".into()],
        };
        assert_eq!(line(&model), "mdl-1  mlp-force  force  virtual  not scored");
        assert_eq!(warned(&model), "\nwarning: 3 of 9 channels are constant");
    }

    #[test]
    fn a_promotion_states_what_limits_its_answers() {
        let serves = |limitation: Option<&str>| {
            let limitation = limitation.map(str::to_owned);
            ServesOut { slot: Slot::Skin, sensor: None, what: None, limitation, restores: None }
        };
        assert_eq!(words(&serves(None)), "skin      nothing");
        let limited = words(&serves(Some("the errors are unknown")));
        assert_eq!(limited, "skin      nothing\n          note: the errors are unknown");
    }
}
