//! What workers of bulk work and their queue do, as the service reads it.
//! Uses: `client`. Never: queue or store, which `palpate-worker` alone knows.

use std::time::Duration;

use serde_json::Value;
use tokio::time::timeout;

use super::client::{Client, text_of};
use super::error::CliResult;
use super::output::{bytes, counted, duration, grouped};
use super::progress::to_go;
use super::table::{Table, count_or_dash, or_dash};
use super::view::rows;
use super::{At, embed};

/// Path of the state.
const WORKERS: &str = "/api/v1/workers";
/// Longest time for which `status` waits for a queue.
const STATUS_WAIT: Duration = Duration::from_secs(2);
/// Bytes of one MiB.
const MIB: f64 = 1_048_576.0;
/// Digits of an order's id that are shown, enough for `palpate worker`.
const ID_SHOWN: usize = 12;

/// Runs `palpate status --workers`.
///
/// # Errors
/// `CliError` if the service cannot be reached, or its queue does not answer.
pub async fn status(at: &At) -> CliResult<()> {
    let found: Value = embed::server(at).await?.get(WORKERS).await?;
    let none = "the service knows no queue: start it with PALPATE_QUEUE_FILE and PALPATE_STORE";
    let is_known = found["configured"] == true;
    at.output().say(&found, if is_known { state(&found) } else { none.into() });
    Ok(())
}

/// The workers, their orders and what failed, as text.
fn state(found: &Value) -> String {
    let mut workers = Table::new("worker | heard> | at once> | memory> | GPU>", "no worker");
    for worker in rows(found, "workers") {
        let lost = if worker["lost"] == true { " (lost)" } else { "" };
        let heard = duration(worker["heard_s"].as_f64().unwrap_or_default());
        let about = &worker["about"];
        workers.push([
            text_of(&worker["worker"]),
            format!("{heard} ago{lost}"),
            or_dash(about["at_once"].as_u64()),
            or_dash(about["memory_mib"].as_f64().map(|mib| bytes(mib * MIB))),
            or_dash(about["gpu"].as_bool().map(|gpu| if gpu { "yes" } else { "no" })),
        ]);
    }
    let numbers = ["chunks", "done", "running", "waiting", "again", "failed", "missing"];
    let heads = format!("order | folder | {}> | per min> | to go>", numbers.join("> | "));
    let mut orders = Table::new(&heads, "no order");
    for order in rows(found, "orders") {
        let id: String = text_of(&order["order"]).chars().take(ID_SHOWN).collect();
        let rate = or_dash(order["per_minute"].as_f64().map(|rate| format!("{rate:.1}")));
        let to_go = or_dash(order["to_go_s"].as_f64().map(duration));
        let counts = numbers.map(|number| count_or_dash(&order[number]));
        let named = [id, text_of(&order["folder"])];
        orders.push(named.into_iter().chain(counts).chain([rate, to_go]));
    }
    let mut lines = vec![workers.to_string(), orders.to_string()];
    for order in rows(found, "orders") {
        lines.extend(order["again_error"].as_str().map(|error| format!("again: {error}")));
        for failed in rows(order, "errors") {
            let (index, attempts) = (&failed["index"], &failed["attempts"]);
            lines
                .push(format!("chunk {index}: {attempts} attempts: {}", text_of(&failed["error"])));
        }
    }
    let unsubmitted = rows(found, "unsubmitted").iter().filter_map(Value::as_str);
    let unsubmitted: Vec<&str> = unsubmitted.collect();
    if !unsubmitted.is_empty() {
        lines.push(format!("not submitted: {}", unsubmitted.join(", ")));
    }
    let gather = &found["gather"];
    if let Some(state) = gather["state"].as_str() {
        let why = gather["error"].as_str().map_or(String::new(), |why| format!(": {why}"));
        let (folder, into) = (text_of(&gather["folder"]), text_of(&gather["into"]));
        lines.push(format!("gathering of {folder} into {into}: {state}{why}"));
    }
    lines.join("\n")
}

/// The line of `palpate status`; `None` if the service knows no queue.
pub async fn line(client: &Client) -> Option<String> {
    let words = match timeout(STATUS_WAIT, client.get::<Value>(WORKERS)).await {
        Ok(Ok(found)) => words(&found)?,
        Ok(Err(error)) => error.to_string(),
        Err(_) => "the queue has not answered yet".into(),
    };
    Some(format!("workers  {words}"))
}

fn words(found: &Value) -> Option<String> {
    if found["configured"] != true {
        return None;
    }
    let workers = rows(found, "workers");
    let lost = workers.iter().filter(|worker| worker["lost"] == true).count();
    let mut words = counted((workers.len() - lost) as u64, "worker", "workers");
    if lost > 0 {
        words += &format!(" ({lost} lost)");
    }
    let is_open = |order: &&Value| order["done"].as_u64() < order["chunks"].as_u64();
    let open: Vec<&Value> = rows(found, "orders").iter().filter(is_open).collect();
    let sum = |key: &str| open.iter().filter_map(|order| order[key].as_f64()).sum::<f64>();
    if open.is_empty() {
        return Some(words + "; nothing to do");
    }
    let count = |key: &str| grouped(sum(key) as u64);
    words += &format!("; {} of {} chunks done", count("done"), count("chunks"));
    if sum("per_minute") > 0.0 {
        words += &format!(", {:.1} per minute", sum("per_minute"));
    }
    if let Some(left_s) = open.iter().filter_map(|order| order["to_go_s"].as_f64()).reduce(f64::max)
    {
        words += &format!(", {}", to_go(left_s));
    }
    for (key, what) in [("again", "could not be made by a machine"), ("failed", "failed")] {
        if sum(key) > 0.0 {
            words += &format!("; {} {what}", count(key));
        }
    }
    Some(words)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_line_counts_open_orders_and_names_what_needs_a_person() {
        assert_eq!(words(&json!({ "configured": false })), None);
        let mut found = json!({ "configured": true, "orders": [], "workers": [
            { "worker": "a", "lost": false }, { "worker": "b", "lost": true }] });
        assert_eq!(words(&found).unwrap(), "1 worker (1 lost); nothing to do");
        found["orders"] = json!([
            { "chunks": 9, "done": 9, "again": 0, "failed": 0, "per_minute": 2.0, "to_go_s": 0 },
            { "chunks": 20_000, "done": 12_000, "again": 1, "failed": 2, "per_minute": 12.34, "to_go_s": 375 },
            { "chunks": 10, "done": 0, "again": 0, "failed": 0, "per_minute": null, "to_go_s": null },
        ]);
        assert_eq!(
            words(&found).unwrap(),
            "1 worker (1 lost); 12,000 of 20,010 chunks done, 12.3 per minute, 6 min 15 s to go; \
             1 could not be made by a machine; 2 failed"
        );
    }
}
