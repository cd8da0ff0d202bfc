//! `palpate dataset export` and `dataset exports`: a dataset as a file, and the list of such files.
//! Uses: `client`, `download`. Never: rows in this process (the service writes them).

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde_json::json;

use super::At;
use super::client::{Client, text_of};
use super::download::download_whole;
use super::error::{CliError, CliResult};
use super::next::Next;
use super::output::{bytes, counted};
use super::progress::Counted;
use super::table::{Table, or_dash};
use super::times::local;
use crate::api::ExportOut;
use crate::dataset::export::ExportRequest;
use crate::dataset::format::Format;
use crate::ids::DatasetId;
use crate::new_file::Finished;
use crate::store::TaskState;

/// Interval of polling an export's progress.
const EXPORT_POLL: Duration = Duration::from_millis(200);

/// Options of `dataset export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Id or name; `run-N` is all trials of a run.
    name: String,
    /// Format of the file.
    #[arg(long, default_value = Format::Parquet.name(), value_parser = formats())]
    format: Format,
    /// A condition on rows, such as `contact_count__gte=3` or `split=train`; may be repeated.
    #[arg(long = "where", value_name = "COLUMN__gt=VALUE")]
    conditions: Vec<String>,
    /// Columns, in this order.
    #[arg(long, value_delimiter = ',', value_name = "NAME,..")]
    columns: Vec<String>,
    /// A force map for each row, as pixel x diameter in mm: 4x20.
    #[arg(long, value_name = "PIXELxDIAMETER")]
    map: Option<String>,
    /// Only these values of each frame, the end excluded: 0:28.
    #[arg(long, value_name = "FIRST:END")]
    slice: Option<String>,
    /// The file [default: NAME.FORMAT here].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    pub at: At,
}

/// Parser of the name of a format; the help lists the formats.
fn formats() -> impl TypedValueParser<Value = Format> {
    let of = |format: Format| PossibleValue::new(format.name()).help(format.about());
    PossibleValuesParser::new(Format::ALL.map(of)).try_map(|name| name.parse::<Format>())
}

/// Runs `palpate dataset export`.
///
/// # Errors
/// `CliError` if the service refuses or the export fails, or if the file cannot be written.
pub async fn export(client: &Client, args: &ExportArgs) -> CliResult<()> {
    let request = ExportRequest {
        dataset: args.name.clone(),
        format: args.format,
        columns: args.columns.clone(),
        conditions: args.conditions.clone(),
        map: args.map.clone(),
        slice: args.slice.clone(),
    };
    let asked: ExportOut = client.post("/api/v1/exports", &request).await?;
    let done = follow(client, asked).await?;
    let default = || format!("{}.{}", args.name, args.format.extension()).into();
    let out: PathBuf = args.out.clone().unwrap_or_else(default);
    let url = done.url.clone().unwrap_or_else(|| format!("/api/v1/exports/{}/file", done.id));
    let (length, sha256) = (done.bytes.unwrap_or_default(), done.sha256.clone());
    let whole = Finished { bytes: length, sha256: sha256.unwrap_or_default() };
    download_whole(client, &url, &whole, &out).await?;
    let of = done.dataset.as_ref().map_or(args.name.as_str(), DatasetId::as_str);
    let rows = match done.rows_total {
        0 => String::new(),
        rows => format!("{} of ", counted(rows, "row", "rows")),
    };
    let (file, length, sha256) = (out.display(), bytes(whole.bytes as f64), &whole.sha256);
    let words = format!("{file}: {rows}{of}, {length}, sha256 {sha256}");
    args.at.output().say(&json!({ "file": out, "export": done }), words);
    Next::of(&args.at)
        .suggest(format_args!("palpate dataset card {of}"), "its content, units and citation")
        .say();
    Ok(())
}

/// Shows the progress of an export until it has ended.
async fn follow(client: &Client, asked: ExportOut) -> CliResult<ExportOut> {
    let client = client.quiet();
    let mut shown = Counted::of("rows exported", 0);
    let (mut now, mut rows) = (asked, 0);
    loop {
        rows = rows.max(now.rows_total);
        shown.show(now.rows_done, now.rows_total);
        // The dataset is made before its rows are counted.
        shown.bar.set_message(if now.rows_total == 0 { "(making the dataset)" } else { "" });
        match now.state {
            TaskState::Done => {
                now.rows_total = rows;
                return Ok(now);
            }
            TaskState::Failed | TaskState::Stopped => {
                let detail = now.error.unwrap_or_default();
                return Err(CliError::Refused { status: 409, detail, again: false });
            }
            TaskState::Waiting | TaskState::Running => tokio::time::sleep(EXPORT_POLL).await,
        }
        now = client.get(&format!("/api/v1/exports/{}", now.id)).await?;
    }
}

/// Prints the exports, newest first.
///
/// # Errors
/// As [`Client::send`].
pub async fn list(client: &Client, at: &At) -> CliResult<()> {
    let exports: Vec<ExportOut> = client.all("/api/v1/exports?").await?;
    let mut table = Table::new(
        "export | state | dataset | format | size> | requested | last used | by |",
        "there are no exports: palpate dataset export NAME",
    )
    .whole();
    for export in &exports {
        table.push([
            export.id.to_string(),
            export.state.to_string(),
            text_of(&export.request["dataset"]),
            text_of(&export.request["format"]),
            or_dash(export.bytes.map(|length| bytes(length as f64))),
            local(export.created_at),
            or_dash(export.last_used_at.map(local)),
            export.asked_by.clone(),
            export.error.clone().unwrap_or_default(),
        ]);
    }
    at.output().say(&json!({ "items": exports }), table);
    Ok(())
}
