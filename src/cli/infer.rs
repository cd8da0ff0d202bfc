//! `palpate infer`: contacts of frames in a file; `palpate live`: contacts of the rig's frames.
//! Uses: `client`. Never: models (the service answers).

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::files::read_input;
use super::next::Next;
use super::output::{Output, note, say, say_whole};
use super::progress::Counted;
use super::{At, embed, recording};
use crate::api::{
    FrameAnswer, InferOptions, InferRequest, LiveAnswer, LiveQuantities, ModelOut, QuantityRequest,
};
use crate::campaign::bench::rig_state::RigState;
use crate::ids::CalibrationId;
use crate::infer::answer::FoundContact;
use crate::infer::methods::Method;
use crate::infer::quantity::QuantityAnswer;
use crate::infer::slot::Slot;
use crate::learn::task::NetTask;
use crate::problem::Problem;

/// Number of frames per request.
const FRAMES_PER_REQUEST: usize = 64;
/// Longest wait for an answer by a skin that must be prepared first.
const SKIN_READY_WITHIN: Duration = Duration::from_secs(900);

/// Options of `infer`.
#[derive(Debug, Args)]
pub struct InferArgs {
    /// JSON lines: each an array of voltages, or an object with voltages_v; - for standard input.
    #[arg(value_name = "FILE|-")]
    file: PathBuf,
    /// Method [default: that of the --model]; not for a model that answers a position, pattern, count or force.
    #[arg(long, value_parser = methods(Method::served()), required_unless_present = "model")]
    method: Option<Method>,
    /// Id, start of the id, or name of a model, or id of a calibration; it need not be promoted [default: the
    /// serving one].
    ///
    /// SLOT@SENSOR, such as position@pad-60, is the promoted one of another sensor.
    #[arg(long, value_name = "MODEL")]
    model: Option<String>,
    /// Id, start of the id, or name of a Transfer-Net before it [default: the serving one].
    #[arg(long, value_name = "MODEL")]
    transfer: Option<String>,
    /// Include the force map (shown with --json): the net's own, or the contacts drawn as Map 1.
    #[arg(long)]
    map: bool,
    /// Number of frames of which each frame is the mean.
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    averaged: f64,
    #[command(flatten)]
    at: At,
}

/// Options of `live`.
#[derive(Debug, Args)]
pub struct LiveArgs {
    /// Method [default: the best one with serving models].
    #[arg(long, value_parser = methods(Method::served()))]
    method: Option<Method>,
    /// Include the force map (shown with --json): the net's own, or the contacts drawn as Map 1.
    #[arg(long)]
    map: bool,
    /// Show what the promoted nets of a position, pattern, count or force answer, not contacts.
    #[arg(long, conflicts_with_all = ["method", "map"])]
    quantities: bool,
    /// End after this number of frames.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Write the raw --frames to this file instead, by its ending: .parquet, .arrow, .arrows, .csv, .ndjson.
    #[arg(long, value_name = "FILE", requires = "frames",
        conflicts_with_all = ["method", "map", "quantities"])]
    record: Option<PathBuf>,
    #[command(flatten)]
    at: At,
}

/// Parser of the name of a method; the help lists the methods.
pub fn methods(of: impl Iterator<Item = Method>) -> impl TypedValueParser<Value = Method> {
    let values = of.map(|method| PossibleValue::new(method.name()).help(method.about()));
    let named = |name: String| Method::named(&name).ok_or("must be the name of a method");
    PossibleValuesParser::new(values).try_map(named)
}

/// Runs `palpate infer`.
///
/// # Errors
/// `CliError` if the file is invalid, or the service cannot be reached or refuses.
pub async fn infer(args: InferArgs) -> CliResult<()> {
    let frames = frames(&args.file)?;
    embed::with_purpose(&args.at, embed::Purpose::Computes, async |client| {
        let is_skin = |model: &String| model.parse::<CalibrationId>().is_ok();
        let client = match args.model.as_ref().is_some_and(is_skin) {
            true => client.patient(SKIN_READY_WITHIN),
            false => client.clone(),
        };
        let method = match (args.method, &args.model) {
            (Some(method), _) => method,
            (None, Some(model)) => match method_of(&client, model).await? {
                Some(method) => method,
                None => return quantities(&client, model, &frames, &args.at).await,
            },
            // clap requires one of them.
            (None, None) => return Ok(()),
        };
        let request = |frames| InferRequest {
            options: InferOptions {
                method,
                model: args.model.clone(),
                transfer: args.transfer.clone(),
                map: args.map,
                averaged: args.averaged,
            },
            frames,
        };
        let output = args.at.output();
        answered::<_, FrameAnswer>(&client, "/api/v1/infer", &frames, request, output, words)
            .await?;
        let (next, method) = (Next::of(&args.at), method.name());
        let next = match &args.model {
            None => {
                next.suggest("palpate model serving", "what answers, and what limits it").suggest(
                    format_args!("palpate live --method {method}"),
                    "answers on the rig's skin",
                )
            }
            Some(id) if is_skin(id) => {
                next.suggest(format_args!("palpate model promote {id}"), "makes it serve")
            }
            Some(model) => {
                next.suggest(format_args!("palpate model show {model}"), "its facts and recipe")
            }
        };
        next.say();
        Ok(())
    })
    .await
}

/// The method by which a model or a calibration answers; `None` if it answers a quantity.
async fn method_of(client: &Client, model: &str) -> CliResult<Option<Method>> {
    if model.parse::<CalibrationId>().is_ok() {
        return Ok(Method::of(Slot::Skin));
    }
    let found: ModelOut = client.get(&format!("/api/v1/models/{model}")).await?;
    let task = NetTask::deserialize(Value::from(found.task)).ok();
    Ok(task.and_then(|task| Method::of(Slot::of(task))))
}

/// Requests the answers to frames, to some of them at a time, and prints each; shows how many are answered.
async fn answered<Request: Serialize, Answer: Serialize + DeserializeOwned>(
    client: &Client,
    path: &str,
    frames: &[Vec<f32>],
    request: impl Fn(Vec<Vec<f32>>) -> Request,
    output: Output,
    words: impl Fn(&Answer) -> String,
) -> CliResult<()> {
    let mut shown = Counted::of("frames answered", frames.len() as u64);
    for some in frames.chunks(FRAMES_PER_REQUEST) {
        let request = request(some.to_vec());
        let answers: Vec<Answer> = shown.during(client.post(path, &request)).await?;
        shown.bar.suspend(|| {
            for answer in &answers {
                output.say(answer, words(answer));
            }
        });
        shown.add(answers.len() as u64);
    }
    Ok(())
}

/// Shows the answers of a net that estimates a quantity of a whole frame.
async fn quantities(client: &Client, model: &str, frames: &[Vec<f32>], at: &At) -> CliResult<()> {
    let path = format!("/api/v1/models/{model}/quantities");
    let request = |frames| QuantityRequest { frames };
    answered::<_, QuantityAnswer>(client, &path, frames, request, at.output(), quantity_words)
        .await?;
    Next::of(at).suggest(format_args!("palpate model show {model}"), "its facts and recipe").say();
    Ok(())
}

/// Formats a quantity for people.
fn quantity_words(answer: &QuantityAnswer) -> String {
    let QuantityAnswer { position_mm, pressed_mm, count, force_n, outside } = answer;
    let position = position_mm.map(|[x, y]| format!("x {x:.1} mm, y {y:.1} mm"));
    let pressed = pressed_mm.as_ref().map(|places| match places.as_slice() {
        [] => "no place pressed".to_owned(),
        places => {
            let place = |[x, y]: &[f64; 2]| format!("({x:.1}, {y:.1})");
            format!("pressed at {} mm", places.iter().map(place).collect::<Vec<_>>().join(", "))
        }
    });
    let count = count.map(|count| super::output::counted(count.into(), "contact", "contacts"));
    let force = force_n.map(|force_n| format!("{force_n:.1} N"));
    let known: Vec<String> = [position, pressed, count, force].into_iter().flatten().collect();
    let mut words = known.join(", ");
    for outside in outside {
        words += &format!("\n  outside the trained range: {outside}");
    }
    words
}

/// Reads the frames of a file, V.
fn frames(path: &Path) -> CliResult<Vec<Vec<f32>>> {
    let file = path.display().to_string();
    let text = read_input(path)?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let frame = |(number, line): (usize, &str)| {
        let wrong = || {
            let key = format!("line {}", number + 1);
            let limit = "must be an array of voltages, or an object with voltages_v";
            let start: String = line.chars().take(40).collect();
            CliError::Problems(vec![Problem::new(&file, &key, start, limit)])
        };
        let value: Value = serde_json::from_str(line).map_err(|_| wrong())?;
        let frame = value.get("voltages_v").unwrap_or(&value);
        serde_json::from_value(frame.clone()).map_err(|_| wrong())
    };
    let frames: Vec<Vec<f32>> = lines.map(frame).collect::<CliResult<_>>()?;
    match frames.is_empty() {
        true => Err(CliError::in_file(path, "has no frame: must have a line for each")),
        false => Ok(frames),
    }
}

/// Formats an answer for people.
fn words(answer: &FrameAnswer) -> String {
    let FrameAnswer { reading, model, method, latency_us } = answer;
    let averaged = reading.averaged.filter(|frames| *frames > 1.0);
    let mut words = format!(
        "{} by {} ({model}), {:.1} ms{}",
        super::output::counted(reading.contacts.len() as u64, "contact", "contacts"),
        method.name(),
        *latency_us as f64 / 1e3,
        averaged.map_or(String::new(), |frames| format!(", mean of {frames:.0} frames"))
    );
    for contact in &reading.contacts {
        words += &format!("\n  {}", contact_words(contact));
    }
    if let Some(probability) = reading.probability.filter(|_| !reading.alternatives.is_empty()) {
        let is_less = reading.alternatives.iter().any(|other| other.probability > probability);
        let why = if is_less { " (the number of contacts is the most probable one)" } else { "" };
        words += &format!("\n  probability {:.0} %{why}; other explanations:", 100.0 * probability);
    }
    for other in &reading.alternatives {
        let contacts: Vec<String> = other.contacts.iter().map(contact_words).collect();
        let contacts = if contacts.is_empty() { "untouched".into() } else { contacts.join("; ") };
        words += &format!("\n    {:.0} %: {contacts}", 100.0 * other.probability);
    }
    for note in &reading.notes {
        words += &format!("\n  note: {note}");
    }
    for outside in &reading.outside {
        words += &format!("\n  outside the trained range: {outside}");
    }
    words
}

fn contact_words(contact: &FoundContact) -> String {
    let sd = |sd: Option<f64>| sd.map_or(String::new(), |sd| format!(" ± {sd:.1}"));
    let mut words = format!(
        "x {:.1}{} mm, y {:.1}{} mm",
        contact.x_mm,
        sd(contact.x_sd_mm),
        contact.y_mm,
        sd(contact.y_sd_mm)
    );
    if let Some(force_n) = contact.force_n {
        words += &format!(", {force_n:.1}{} N", sd(contact.force_sd_n));
    }
    words
}

/// Formats a live message for people; `None` if it is an error.
fn shown(text: &str, quantities: bool) -> Option<String> {
    let (sequence, words) = match quantities {
        true => {
            let live: LiveQuantities = serde_json::from_str(text).ok()?;
            (live.sequence, quantity_words(&live.answer))
        }
        false => {
            let live: LiveAnswer = serde_json::from_str(text).ok()?;
            (live.sequence, words(&live.answer))
        }
    };
    Some(format!("frame {sequence}: {words}"))
}

/// Runs `palpate live`.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses.
pub async fn live(args: LiveArgs) -> CliResult<()> {
    if let Some(out) = &args.record {
        recording::format(out)?;
    }
    let client = embed::server(&args.at).await?;
    if let (Some(out), Some(frames)) = (&args.record, args.frames) {
        return recording::record(&client, out, frames, args.at.output()).await;
    }
    let method = args.method.map_or(String::new(), |method| format!("&method={}", method.name()));
    let path = match args.quantities {
        true => "/api/v1/live/quantities".to_owned(),
        false => format!("/api/v1/live?map={}{method}", args.map),
    };
    if client.status().await?.rig.state == RigState::Disconnected {
        note("no frames while the rig is not connected: palpate rig connect");
    }
    let mut seen = 0;
    client
        .messages(&path, |text| {
            match shown(text, args.quantities).filter(|_| !args.at.json) {
                Some(words) => say(words),
                // JSON: one line for each message.
                None => say_whole(text),
            }
            seen += 1;
            args.frames.is_none_or(|frames| seen < frames)
        })
        .await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::infer::answer::{Alternative, Reading};

    #[test]
    fn a_file_without_frames_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("frames.jsonl");
        for (text, count) in [("[1, 2]\n\n{\"voltages_v\": [3]}\n", Some(2)), ("\n", None)] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(frames(&file).ok().map(|frames| frames.len()), count, "{text}");
        }
    }

    #[test]
    fn other_explanations_are_shown_with_their_probabilities() {
        let contact = |x_mm: f64| FoundContact {
            x_mm,
            y_mm: 50.0,
            force_n: Some(8.0),
            x_sd_mm: Some(3.0),
            y_sd_mm: Some(4.0),
            force_sd_n: Some(0.5),
            ..FoundContact::default()
        };
        let mut reading = Reading {
            contacts: vec![contact(100.0)],
            probability: Some(0.71),
            ..Reading::default()
        };
        let shown = |reading: &Reading| {
            let reading = reading.clone();
            let (model, latency_us) = ("cal-1".to_owned(), 5300);
            words(&FrameAnswer { reading, model, method: Method::Exact, latency_us })
        };
        let alone =
            "1 contact by exact (cal-1), 5.3 ms\n  x 100.0 ± 3.0 mm, y 50.0 ± 4.0 mm, 8.0 ± 0.5 N";
        assert_eq!(shown(&reading), alone);
        let two = vec![contact(90.0), contact(120.0)];
        reading.alternatives = vec![
            Alternative { probability: 0.2, contacts: two },
            Alternative { probability: 0.06, contacts: Vec::new() },
        ];
        let others = format!(
            "{alone}\n  probability 71 %; other explanations:\n    20 %: {}; {}\n    6 %: untouched",
            contact_words(&contact(90.0)),
            contact_words(&contact(120.0))
        );
        assert_eq!(shown(&reading), others);
        reading.alternatives[0].probability = 0.72;
        let why = "probability 71 % (the number of contacts is the most probable one); other";
        assert!(shown(&reading).contains(why), "{}", shown(&reading));
    }
}
