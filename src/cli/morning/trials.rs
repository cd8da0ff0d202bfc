//! `palpate trials`: the stored trials, newest first, by the conditions of the API.
//! Uses: `client`, `table`. Never: frames (`show` draws those of one trial).

use reqwest::Url;
use serde_json::json;

use super::TrialsArgs;
use crate::cli::client::Client;
use crate::cli::embed::{self, Purpose::Reads};
use crate::cli::error::{CliError, CliResult};
use crate::cli::find::find_run;
use crate::cli::next::Next;
use crate::cli::output::grouped;
use crate::cli::table::{Table, or_dash};
use crate::store::TrialRow;

/// What was asked for: at most one run, and conditions.
type Asked = (Option<String>, Vec<(String, String)>);

/// Runs `palpate trials`.
///
/// # Errors
/// `CliError` if the service cannot be reached or started, or refuses a condition.
pub async fn trials(args: TrialsArgs) -> CliResult<()> {
    let asked = asked(&args.what)?;
    embed::with_purpose(&args.at, Reads, async |client| list(client, &args, asked).await).await
}

/// Separates the run from the conditions.
fn asked(what: &[String]) -> CliResult<Asked> {
    let (mut run, mut conditions) = (None, Vec::new());
    for text in what {
        match text.split_once('=') {
            Some((key, value)) => conditions.push((key.trim().into(), value.trim().into())),
            None if run.is_none() => run = Some(text.clone()),
            None => {
                let limit = "must be a condition such as tips=4, or the only run";
                return Err(CliError::argument("RUN", text, limit));
            }
        }
    }
    Ok((run, conditions))
}

/// A query string of pairs, encoded.
pub fn encoded(pairs: &[(String, String)]) -> String {
    let url = Url::parse_with_params("http://palpate/", pairs).ok();
    url.and_then(|url| url.query().map(str::to_owned)).unwrap_or_default()
}

async fn list(client: &Client, args: &TrialsArgs, (run, mut pairs): Asked) -> CliResult<()> {
    let run = match &run {
        Some(run) => Some(find_run(client, run).await?),
        None => None,
    };
    let list = run
        .as_ref()
        .map_or("/api/v1/trials".into(), |run| format!("/api/v1/runs/{}/trials", run.uid));
    let sort = if args.oldest { "trial_id" } else { "-trial_id" };
    pairs.push(("sort".into(), sort.into()));
    let path = format!("{list}?{}", encoded(&pairs));
    let (found, is_all) = client.first::<TrialRow>(&path, args.limit).await?;
    let is_everything = run.is_none() && pairs.len() == 1;
    let (mut words, mut next) = (table(&found, run.is_none()).to_string(), Next::of(&args.at));
    if let Some(first) = found.first() {
        let which = if args.oldest { "oldest" } else { "newest" };
        let count = grouped(found.len() as u64);
        let shown = match is_all {
            true => format!("all {count}"),
            false => format!("the {which} {count}; --limit N shows more"),
        };
        words += &format!("\n{shown}");
        let (trial, run) = (first.trial_id.0, first.scan_id);
        next = next.suggest(format_args!("palpate show t{trial}"), "draws this trial").suggest(
            format_args!("palpate dataset export run-{run} --format csv"),
            format_args!("all of run {run} as a file, with frames"),
        );
    } else if is_everything {
        words =
            "there are no trials: palpate run quickstart measures some on the virtual rig".into();
    }
    args.at.output().say(&json!({ "items": found, "all": is_all }), words);
    next.say();
    Ok(())
}

fn table(trials: &[TrialRow], with_run: bool) -> Table {
    let run = if with_run { "run> | " } else { "" };
    let heads = format!(
        "trial> | {run}configuration> | depth, mm> | tips> | contacts> | largest, N> | FVU> | flags | measured"
    );
    let mut table = Table::new(&heads, "no trial fits");
    for trial in trials {
        let flags: Vec<&str> = trial.flags.iter().map(|flag| flag.as_str()).collect();
        let mut cells = vec![format!("t{}", trial.trial_id.0)];
        if with_run {
            cells.push(trial.scan_id.to_string());
        }
        cells.extend([
            trial.configuration.to_string(),
            or_dash(trial.depth_mm.map(|mm| format!("{mm:.2}"))),
            trial.tips.to_string(),
            trial.contact_count.to_string(),
            or_dash(trial.max_force_n.map(|n| format!("{n:.2}"))),
            or_dash(trial.fvu.map(|fvu| format!("{fvu:.3}"))),
            flags.join(", "),
            or_dash(trial.measured_at.map(crate::cli::times::second)),
        ]);
        table.push(cells);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_and_conditions_stand_in_any_order() {
        let words =
            |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let read = asked(&words(&["tips=4", "3", "fvu__gt = 0.5"])).unwrap();
        assert_eq!(read.0.as_deref(), Some("3"));
        assert_eq!(read.1[1], ("fvu__gt".to_owned(), "0.5".to_owned()));
        let refused = asked(&words(&["3", "4"])).unwrap_err().to_string();
        assert!(refused.contains("RUN = 4"), "{refused}");
    }

    #[test]
    fn a_condition_cannot_add_another_parameter() {
        let pairs = [("experiment".to_owned(), "a&limit=9 ä".to_owned())];
        assert_eq!(encoded(&pairs), "experiment=a%26limit%3D9+%C3%A4");
    }
}
