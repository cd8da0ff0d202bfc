//! `palpate live --record`: raw frames of the rig as a file, in a format of datasets.
//! Uses: `client`, `dataset::format`, `download`. Never: a file that is not complete, other frames than the service's.

use std::path::Path;
use std::time::Duration;

use reqwest::Method;
use serde_json::{Value, json};

use super::client::Client;
use super::download::keep;
use super::error::{CliError, CliResult};
use super::output::{Output, bytes, note};
use super::query::by_ending;
use crate::dataset::format::Format;

/// Longest time of a recording: a rig may send few frames.
const RECORDED_WITHIN: Duration = Duration::from_secs(86_400);

/// Format of the file of a recording, by its ending.
///
/// # Errors
/// `CliError::Problems` if it is not that of a format of rows.
pub fn format(out: &Path) -> CliResult<Format> {
    by_ending(out).ok_or_else(|| {
        let rows = Format::ALL.into_iter().filter(|format| format.streams());
        let endings: Vec<String> = rows.map(|format| format!(".{}", format.extension())).collect();
        let limit = format!("must end in one of {}", endings.join(", "));
        CliError::argument("--record", out.display(), limit)
    })
}

/// Records `frames` frames into a file.
///
/// # Errors
/// `CliError` if the service cannot be reached or refuses, if the recording is cut, or if the file cannot be written.
pub async fn record(client: &Client, out: &Path, frames: u64, output: Output) -> CliResult<()> {
    let path = format!("/api/v1/frames/recording?frames={frames}&format={}", format(out)?.name());
    let answer = client.patient(RECORDED_WITHIN).send(Method::GET, &path, None::<&Value>).await?;
    if output != Output::Json {
        note("recording; Ctrl-C ends it without a file");
    }
    let work = format!("recording {frames} frames");
    let length = keep(answer, out, &work, |_| CliError::Cut { frames }).await?;
    let words = format!("{}: {}", out.display(), bytes(length as f64));
    output.say(&json!({ "file": out, "bytes": length }), words);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_names_a_format_of_rows() {
        assert_eq!(format(Path::new("a/frames.parquet")).unwrap(), Format::Parquet);
        for refused in ["frames.npz", "frames", "frames.xlsx"] {
            let words = format(Path::new(refused)).unwrap_err().to_string();
            assert!(words.contains(".csv") && words.contains(refused), "{words}");
        }
    }
}
