//! `palpate report`: a run as one HTML file, and the same as PDF.
//! Uses: `client`, `html`, `print`. Never: a number that the service does not state.

use jiff::Timestamp;
use serde_json::json;

mod facts;
mod findings;
mod html;
mod plots;
#[cfg(test)]
mod tests;

use facts::Facts;

use super::ReportArgs;
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::files::write;
use crate::cli::find::find_run;
use crate::cli::next::Next;
use crate::cli::output::{counted, note};
use crate::cli::print;
use crate::cli::progress::shown_wait;

/// Runs `palpate report`.
///
/// # Errors
/// As [`find_run`]; `CliError::File` if the HTML cannot be written, `Figure` if a figure cannot be drawn.
/// A PDF that cannot be printed is reported, and is no error: the HTML has all of it.
pub async fn report(client: &Client, args: &ReportArgs) -> CliResult<()> {
    let run = find_run(client, &args.run).await?;
    let facts = Facts::read(client, &run).await?;
    let page = html::page(&facts, Timestamp::now())?;
    let folder = args.out.clone().unwrap_or_default();
    let file = folder.join(format!("run-{}.html", run.scan_id));
    write(&file, &page)?;
    let pdf = file.with_extension("pdf");
    let printed = match args.no_pdf {
        true => None,
        false => match shown_wait("printing the PDF", print::print(&file, &pdf)).await {
            Ok(()) => Some(pdf),
            Err(error) => {
                note(format_args!("no PDF was written: {error}; the HTML prints from any browser"));
                None
            }
        },
    };
    let found: Vec<String> =
        findings::findings(&facts).into_iter().map(|finding| finding.words).collect();
    let count = counted(found.len() as u64, "finding", "findings");
    let (number, name, label) = (run.scan_id, &run.experiment, run.label.as_str());
    let mut lines = vec![format!("run {number}, {name} ({label}): {count}")];
    lines.extend(found.iter().map(|words| format!("- {words}")));
    let written = [&file].into_iter().chain(&printed);
    lines.extend(written.map(|path| format!("written to {}", path.display())));
    let made = json!({ "run": run.uid, "html": file, "pdf": printed, "findings": found });
    args.at.output().say(&made, lines.join("\n"));
    let scan_id = run.scan_id;
    Next::of(&args.at)
        .suggest(format_args!("palpate show {scan_id}"), "draws it in the terminal")
        .suggest(format_args!("palpate events {scan_id} --important"), "what a person should see")
        .say();
    Ok(())
}
