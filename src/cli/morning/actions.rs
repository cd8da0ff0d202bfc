//! `palpate actions`: who requested what, when, why, and with which result.
//! Uses: `client`, `table`. Never: a change.

use std::collections::BTreeMap;

use serde_json::json;

use super::ActionsArgs;
use super::answers::numbers_of;
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::find::find_run;
use crate::cli::output::{say, say_json};
use crate::cli::table::{Table, or_dash};
use crate::cli::times::second;
use crate::store::ActionRow;

/// Runs `palpate actions`.
///
/// # Errors
/// As [`find_run`].
pub async fn actions(client: &Client, args: &ActionsArgs) -> CliResult<()> {
    let of_run = match &args.run {
        Some(run) => format!("run={}", find_run(client, run).await?.uid),
        None => String::new(),
    };
    let path = format!("/api/v1/actions?{of_run}");
    let (found, is_all) = client.first::<ActionRow>(&path, args.limit).await?;
    if args.at.json {
        say_json(&json!({ "items": found, "all": is_all }));
        return Ok(());
    }
    let numbers = numbers_of(client, found.iter().filter_map(|action| action.run)).await?;
    say(table(&found, &numbers));
    if !is_all {
        say(format_args!("the newest {}; --limit N shows more", found.len()));
    }
    Ok(())
}

/// The actions as a table, with the numbers of their runs.
fn table(actions: &[ActionRow], numbers: &BTreeMap<String, i64>) -> Table {
    let number = |action: &ActionRow| numbers.get(&action.run?.to_string());
    let heads = "time | action | run> | who | why, values";
    let mut table = Table::new(heads, "there are no actions").whole();
    for action in actions {
        let words = action.why.iter().chain(&action.detail).cloned().collect::<Vec<_>>();
        table.push([
            second(action.at),
            format!("{}{}", action.action, if action.accepted { "" } else { " (refused)" }),
            or_dash(number(action)),
            action.who.clone(),
            words.join("; "),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_of_an_action_is_whole_at_80_columns() {
        let why = "the skin was cleaned, and the second tip of the carousel was replaced";
        let refused = "the run is paused: resume or abort it first";
        let action = |action: &str, who: &str, accepted: bool| ActionRow {
            id: 1,
            at: jiff::Timestamp::UNIX_EPOCH,
            run: None,
            action: action.into(),
            who: who.into(),
            key_id: None,
            why: Some(why.into()),
            accepted,
            detail: (!accepted).then(|| refused.to_owned()),
        };
        for (name, who) in [("pause", "ada"), ("submit an order", "ada lovelace (local)")] {
            let actions = [action(name, who, true), action(name, who, false)];
            let shown = table(&actions, &BTreeMap::new()).at_width(80).to_string();
            assert!(shown.lines().all(|line| line.chars().count() <= 80), "{shown}");
            let words = shown.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(words.contains(&format!("{why}; {refused}")), "{shown}");
            assert!(!shown.contains('…'), "{shown}");
        }
    }
}
