//! Runs by what a person types: number, start of the id, `last`.
//! Uses: `client`. Never: a guess between several runs.

use super::client::Client;
use super::error::{CliError, CliResult};
use crate::ids::RunUid;
use crate::store::RunRow;

/// Shortest start of an id, characters.
const PREFIX_MIN: usize = 4;
/// Longest number of a run, digits: a longer text of digits is the start of an id.
const DIGITS_MAX: usize = 9;

/// What a person typed for a run.
#[derive(Debug, PartialEq, Eq)]
enum Named<'a> {
    Last,
    /// The number or whole id.
    Whole(&'a str),
    /// The start of an id, in lower case.
    Start(String),
}

fn named(text: &str) -> Option<Named<'_>> {
    if text == "last" {
        return Some(Named::Last);
    }
    // The name of its dataset and of its report.
    let text = text.strip_prefix("run-").unwrap_or(text);
    let is_number = text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number && !text.is_empty() && text.len() <= DIGITS_MAX && !text.starts_with('0') {
        return Some(Named::Whole(text));
    }
    if text.parse::<RunUid>().is_ok() {
        return Some(Named::Whole(text));
    }
    let is_start = text.bytes().all(|byte| byte.is_ascii_hexdigit() || byte == b'-');
    (is_start && text.len() >= PREFIX_MIN).then(|| Named::Start(text.to_ascii_lowercase()))
}

/// Whether a text can be the name of a run.
pub fn is_run(text: &str) -> bool {
    named(text).is_some()
}

/// Returns the run that a person named.
///
/// # Errors
/// `CliError::Problems` if the text is not the name of a run, or is that of several; `NoSuch` or `Refused` if there is no
/// such run; others as [`Client::send`].
pub async fn find_run(client: &Client, text: &str) -> CliResult<RunRow> {
    let wrong = |limit: String| CliError::argument("RUN", text, limit);
    match named(text) {
        Some(Named::Whole(id)) => client.run(id).await.map_err(|error| match error {
            CliError::Refused { status: status @ 404, detail, again } => {
                let detail = format!("{detail}: palpate runs lists all");
                CliError::Refused { status, detail, again }
            }
            error => error,
        }),
        Some(Named::Last) => {
            let newest = client.find_run(|_| true).await?;
            let none = "there are no runs yet: palpate run quickstart";
            newest.ok_or_else(|| CliError::NoSuch(none.into()))
        }
        Some(Named::Start(start)) => {
            let runs: Vec<RunRow> = client.all("/api/v1/runs?limit=1000").await?;
            let mut found: Vec<RunRow> =
                runs.into_iter().filter(|run| run.uid.to_string().starts_with(&start)).collect();
            match (found.len(), found.pop()) {
                (1, Some(run)) => Ok(run),
                (0, _) => Err(CliError::NoSuch(format!("no run {text}: palpate runs lists all"))),
                (count, last) => {
                    let runs = found.iter().chain(&last);
                    let numbers: Vec<String> = runs.map(|run| run.scan_id.to_string()).collect();
                    let numbers = numbers.join(", ");
                    Err(wrong(format!("{count} runs begin like this; their numbers: {numbers}")))
                }
            }
        }
        None => {
            let limit = "must be the number, start of the id (4 characters or more), or `last`";
            Err(wrong(limit.into()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_named_by_its_number_its_id_or_the_start_of_it() {
        assert_eq!(named("last"), Some(Named::Last));
        assert_eq!(named("12"), Some(Named::Whole("12")));
        assert_eq!(named("0193"), Some(Named::Start("0193".into())), "no number begins with 0");
        assert_eq!(named("019AB-"), Some(Named::Start("019ab-".into())));
        assert_eq!(named("run-12"), Some(Named::Whole("12")));
        let whole = "01934f6e-7c1a-7000-8000-000000000000";
        assert_eq!(named(whole), Some(Named::Whole(whole)));
        for wrong in ["", "abc", "the last one", "3/1", "run-", "run-x"] {
            assert!(!is_run(wrong), "{wrong}");
        }
    }
}
