//! `palpate dataset import`: checks a file, prints what was understood, and uploads it.
//! Uses: `client`, `making`, `dataset::import`. Never: a trial that is stored in this process.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use reqwest::multipart::Part;
use serde_json::{Value, json};

use super::client::{Client, text_of};
use super::error::CliResult;
use super::files::{read_input, read_or_carried};
use super::making;
use super::next::Next;
use super::output::{counted, say};
use super::{At, embed};
use crate::carried::SENSORS;
use crate::dataset::build::Progress;
use crate::dataset::import::coordinates::Coordinates;
use crate::dataset::import::preview;
use crate::dataset::import::sensor::ImportedSensor;
use crate::dataset::import::summary::Summary;
use crate::file_kind::FileKind;

/// Longest wait until an import is stored.
const IMPORT_WAIT: Duration = Duration::from_secs(3600);

/// Options of `dataset import`.
#[derive(Debug, Args)]
pub struct ImportArgs {
    /// Parquet, CSV, NPZ or MAT file.
    file: PathBuf,
    /// Sensor file: TOML with name, channels, width_mm and height_mm, one of Palpate's, or the name of a
    /// carried one.
    #[arg(long, value_name = "SENSOR.toml")]
    sensor: PathBuf,
    /// Label: measured, virtual or simulated.
    #[arg(long, default_value = "measured")]
    label: String,
    /// Name of the experiment [default: the file's].
    #[arg(long)]
    name: Option<String>,
    /// Map from the coordinates of the file to those of the skin: TOML with any of rotate_deg, mirror_x,
    /// offset_mm = [x, y] and scale.
    #[arg(long, value_name = "FILE.toml")]
    coordinates: Option<PathBuf>,
    /// Check the file, show what was understood, and store nothing. Needs no service.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    at: At,
}

/// Runs `palpate dataset import`.
///
/// # Errors
/// `CliError` if a file cannot be read, a value is invalid, or the service refuses.
pub async fn import(args: ImportArgs) -> CliResult<()> {
    let sensor = read_or_carried(FileKind::Sensor, &args.sensor, SENSORS)?;
    let map = args.coordinates.as_deref().map(read_input).transpose()?;
    let summary = understood(&args, sensor.clone(), map.as_deref()).await?;
    if !args.at.json {
        show(&summary, &ImportedSensor::from_toml(&args.sensor.display().to_string(), &sensor)?);
    }
    if args.dry_run {
        let answer = json!({ "summary": summary, "stored": false });
        args.at.output().say(&answer, "nothing was stored: --dry-run");
        Next::of(&args.at).same_command("without --dry-run", "stores the trials").say();
        return Ok(());
    }
    embed::with_purpose(&args.at, embed::Purpose::Stores, async |client| {
        store(client, &args, sensor, map, &summary).await
    })
    .await
}

/// Checks the file as the service does.
async fn understood(args: &ImportArgs, sensor: String, map: Option<&str>) -> CliResult<Summary> {
    let map_file = args.coordinates.as_ref().map(|path| path.display().to_string());
    let map = Coordinates::from_toml(&map_file.unwrap_or_default(), map.unwrap_or_default())?;
    let (path, sensor_file) = (args.file.clone(), args.sensor.display().to_string());
    let file = path.display().to_string();
    let reading = move |rows: &Progress| preview(&path, &file, &sensor_file, &sensor, map, rows);
    Ok(making::here("reading the file", "trials read", reading).await?)
}

async fn store(
    client: &Client,
    args: &ImportArgs,
    sensor: String,
    map: Option<String>,
    summary: &Summary,
) -> CliResult<()> {
    let name = args.name.clone().unwrap_or_else(|| {
        args.file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    });
    let named = |text: String, path: &Path| Part::text(text).file_name(path.display().to_string());
    let map = map.zip(args.coordinates.as_deref());
    let map = map.map(|(text, path)| ("coordinates", named(text, path)));
    let texts = [
        ("sensor", named(sensor, &args.sensor)),
        ("name", Part::text(name.clone())),
        ("label", Part::text(args.label.clone())),
        ("who", Part::text(client.who().to_owned())),
    ];
    let patient = client.patient(IMPORT_WAIT).quiet();
    let stored = patient.upload("/api/v1/imports", &args.file, texts.into_iter().chain(map));
    let mut made: Value = making::import(client, &name, stored).await?;
    made["summary"] = json!(summary);
    let trials = counted(made["trials"].as_u64().unwrap_or_default(), "trial", "trials");
    let (run, label) = (&made["run"]["scan_id"], text_of(&made["run"]["label"]));
    args.at.output().say(&made, format_args!("run {run}: {trials} ({label})"));
    let dataset = text_of(&made["dataset"]);
    Next::of(&args.at)
        .suggest(format_args!("palpate dataset show {dataset}"), "its parts and columns")
        .suggest(format_args!("palpate trials {run}"), "its trials")
        .say();
    Ok(())
}

/// Prints a summary of trials of a sensor for people.
fn show(summary: &Summary, sensor: &ImportedSensor) {
    let range = |range: Option<[f64; 2]>, unit: &str| match range {
        Some([least, most]) => format!("{} to {} {unit}", short(least), short(most)),
        None => "not known".to_owned(),
    };
    let line = |what: &str, value: &dyn Display| say(format_args!("  {what:<16} {value}"));
    say(counted(summary.rows, "trial", "trials"));
    line("columns", &summary.columns.join(", "));
    if !summary.columns_left_out.is_empty() {
        line("unused columns", &summary.columns_left_out.join(", "));
    }
    let missing = match summary.missing_voltages {
        0 => String::new(),
        missing => format!(", {missing} values missing"),
    };
    let volts = range(summary.voltages_v, "V");
    line("voltages", &format_args!("{} channels, {volts}{missing}", summary.channels));
    if summary.raw_frames > 0 {
        line("raw frames", &counted(summary.raw_frames, "frame", "frames"));
    }
    line("contacts", &counts(&summary.contact_counts, "with "));
    line("x", &range(summary.x_mm, "mm"));
    line("y", &range(summary.y_mm, "mm"));
    let (width, height) = (sensor.width_mm, sensor.height_mm);
    if summary.may_be_metres([width, height]) {
        line(
            "",
            &format_args!(
                "every position is within 1 mm of the corner of a skin of {width} x {height} mm: if x_mm and \
                 y_mm are metres, name a map with scale = 1000 by --coordinates"
            ),
        );
    }
    let without = match summary.contacts_without_force {
        0 => String::new(),
        without => format!(", {without} contacts without"),
    };
    line("forces", &format_args!("{}{without}", range(summary.force_n, "N")));
    if summary.contacts_of_0_n > 0 {
        let contacts = counted(summary.contacts_of_0_n, "contact", "contacts");
        line(
            "",
            &format_args!(
                "{contacts} of 0 N: an untouched skin has none; state deadband_n in datasets"
            ),
        );
    }
    if !summary.splits.is_empty() {
        line("split", &counts(&summary.splits, ""));
    }
    if !summary.tags.is_empty() {
        let trials = counted(summary.tags.values().sum(), "trial", "trials");
        line("tags", &format_args!("{} of {trials}", summary.tags.len()));
    }
}

/// A number rounded to four digits.
fn short(number: f64) -> f64 {
    format!("{number:.3e}").parse().unwrap_or(number)
}

/// Numbers of trials by a key.
fn counts<K: Display>(counts: &BTreeMap<K, u64>, before: &str) -> String {
    let each = counts.iter().map(|(key, trials)| format!("{trials} {before}{key}"));
    each.collect::<Vec<_>>().join(", ")
}
