//! `palpate actions`: who requested what, when, why, and with which result.
//! Uses: `client`, `table`. Never: a change.

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
    let number = |action: &ActionRow| numbers.get(&action.run?.to_string());
    let mut table = Table::new("time | action | run> | who | why, values", "there are no actions");
    for action in &found {
        let words = action.why.iter().chain(&action.detail).cloned().collect::<Vec<_>>();
        table.push([
            second(action.at),
            format!("{}{}", action.action, if action.accepted { "" } else { " (refused)" }),
            or_dash(number(action)),
            action.who.clone(),
            words.join("; "),
        ]);
    }
    say(&table);
    if !is_all {
        say(format_args!("the newest {}; --limit N shows more", found.len()));
    }
    Ok(())
}
