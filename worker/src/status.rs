//! What workers and queue do: orders with done, waiting and failed chunks, rate and time to go.
//! Uses: `queue`, `store`. Never: a number for what the store or the queue has not stated.

use std::fmt::{self, Display};
use std::time::{Duration, SystemTime};

use serde::Serialize;
use serde_json::Value;

use crate::order::Failed;
use crate::queue::{Backlog, Queue};
use crate::store::{Part, Store};
use crate::{WorkerError, WorkerResult};

/// Time over which the rate is counted.
const RATE_OVER: Duration = Duration::from_secs(600);
/// Failed chunks whose error is shown.
const FAILED_SHOWN: usize = 5;

/// State of workers and orders.
#[derive(Debug, Serialize)]
pub struct Status {
    /// The workers, the last heard first.
    pub workers: Vec<WorkerStatus>,
    /// The orders of the store.
    pub orders: Vec<OrderStatus>,
}

/// State of one worker.
#[derive(Debug, Serialize)]
pub struct WorkerStatus {
    /// Host, process and a random part.
    pub worker: String,
    /// Time since its last heartbeat, s.
    pub heard_s: u64,
    /// Whether its lease has ended.
    pub lost: bool,
    /// What it states of itself: `at_once`, `gpu`, `memory_mib`.
    pub about: Option<Value>,
}

/// State of one order.
#[derive(Debug, Serialize)]
pub struct OrderStatus {
    /// Chunks of the order.
    pub chunks: u64,
    /// Chunks whose result is in the store.
    pub done: u64,
    /// What the queue has of it.
    #[serde(flatten)]
    pub backlog: Backlog,
    /// Chunks that are neither done nor in the queue.
    pub missing: u64,
    /// Chunks that were done in the last 10 minutes, per minute; absent if there were none.
    pub per_minute: Option<f64>,
    /// Predicted time to the end, s; absent without a rate.
    pub to_go_s: Option<u64>,
    /// The first chunks that are set aside.
    pub errors: Vec<Failed>,
}

impl OrderStatus {
    /// Whether no worker will do more for it.
    pub fn is_over(&self) -> bool {
        self.backlog.waiting == 0 && self.backlog.running == 0
    }
}

/// Reads the state of all orders, or of one. `lease`: time without a heartbeat after which a worker is lost.
///
/// # Errors
/// `WorkerError` if store or queue do not answer, or if the store has no such order.
pub async fn status(
    queue: &Queue,
    store: &Store,
    order: Option<&str>,
    lease: Duration,
) -> WorkerResult<Status> {
    let backlogs = queue.backlogs().await?;
    let workers = queue.workers(lease).await?.into_iter().map(|row| WorkerStatus {
        heard_s: SystemTime::now()
            .duration_since(row.last_heartbeat_at.into())
            .map_or(0, |age| age.as_secs()),
        worker: row.worker_id,
        lost: row.is_stale,
        about: row.metadata,
    });
    let ids = match order {
        Some(id) => vec![id.to_owned()],
        None => store.orders().await?,
    };
    let mut status = Status { workers: workers.collect(), orders: Vec::new() };
    for id in ids {
        let backlog = backlogs.iter().find(|backlog| backlog.order == id).cloned();
        let backlog =
            backlog.unwrap_or_else(|| Backlog { order: id.clone(), ..Backlog::default() });
        match one(store, backlog).await? {
            Some(found) => status.orders.push(found),
            None if order.is_some() => {
                return Err(WorkerError::Invalid(format!("order {id}: not in the store")));
            }
            None => (),
        }
    }
    Ok(status)
}

async fn one(store: &Store, backlog: Backlog) -> WorkerResult<Option<OrderStatus>> {
    let Some((order, _)) = store.order(&backlog.order).await? else { return Ok(None) };
    let written = store.keys(&order.id, Part::Results).await?;
    let done = written.len() as u64;
    let since = SystemTime::now() - RATE_OVER;
    let recent: Vec<SystemTime> = written.values().copied().filter(|time| *time >= since).collect();
    // An order that began within this time has its rate since then.
    let began = recent.iter().min().filter(|_| recent.len() as u64 == done);
    let over = began
        .and_then(|began| began.elapsed().ok())
        .unwrap_or(RATE_OVER)
        .max(Duration::from_secs(1));
    let per_minute = (recent.len() > 1).then(|| recent.len() as f64 / over.as_secs_f64() * 60.0);
    let open = order.chunks.saturating_sub(done);
    let to_go_s =
        per_minute.map(|rate| (open.saturating_sub(backlog.failed) as f64 / rate * 60.0) as u64);
    let mut errors = Vec::new();
    for key in store.keys(&order.id, Part::Failed).await?.keys() {
        if errors.len() < FAILED_SHOWN && !written.contains_key(key) {
            errors.extend(store.failed(&order.id, key).await?);
        }
    }
    let missing = open.saturating_sub(backlog.waiting + backlog.running + backlog.failed);
    Ok(Some(OrderStatus {
        chunks: order.chunks,
        done,
        backlog,
        missing,
        per_minute,
        to_go_s,
        errors,
    }))
}

impl Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.workers.is_empty() {
            writeln!(f, "no workers")?;
        }
        for worker in &self.workers {
            let lost = if worker.lost { ", lost" } else { "" };
            let about = worker.about.as_ref();
            let number = |name: &str| about.and_then(|about| about[name].as_u64()).unwrap_or(0);
            let gpu = if about.is_some_and(|about| about["gpu"] == true) { ", GPU" } else { "" };
            let (slots, memory) = (number("at_once"), number("memory_mib"));
            writeln!(
                f,
                "worker {}: heard {} ago{lost}, {slots} at once, {memory} MiB{gpu}",
                worker.worker,
                duration(worker.heard_s)
            )?;
        }
        for order in &self.orders {
            let Backlog { order: id, waiting, running, again, again_error, failed } =
                &order.backlog;
            let (done, chunks, missing) = (order.done, order.chunks, order.missing);
            write!(
                f,
                "order {id}: {done} of {chunks} done, {running} running, {waiting} waiting ({again} again), "
            )?;
            write!(f, "{failed} failed, {missing} not submitted")?;
            if let (Some(rate), Some(to_go)) = (order.per_minute, order.to_go_s) {
                write!(f, "; {rate:.1} per minute, {} to go", duration(to_go))?;
            }
            writeln!(f)?;
            if let Some(error) = again_error {
                writeln!(f, "  again: {error}")?;
            }
            for failed in &order.errors {
                writeln!(
                    f,
                    "  chunk {}: {} attempts: {}",
                    failed.index, failed.attempts, failed.error
                )?;
            }
        }
        Ok(())
    }
}

/// A duration for people, in whole seconds: `25 h 12 min`, `3 min 20 s`, `12 s`.
fn duration(seconds: u64) -> String {
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        _ => {
            let minutes = (seconds + 30) / 60;
            format!("{} h {} min", minutes / 60, minutes % 60)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_shown_in_hours_minutes_and_seconds() {
        let about = serde_json::json!({ "at_once": 2, "memory_mib": 4096 });
        let worker =
            WorkerStatus { worker: "node-1".into(), heard_s: 75, lost: false, about: Some(about) };
        let order = OrderStatus {
            chunks: 1000,
            done: 10,
            backlog: Backlog { order: "sim".into(), waiting: 990, ..Backlog::default() },
            missing: 0,
            per_minute: Some(0.5),
            to_go_s: Some(118_800),
            errors: Vec::new(),
        };
        let shown = Status { workers: vec![worker], orders: vec![order] }.to_string();
        assert!(shown.starts_with("worker node-1: heard 1 min 15 s ago, 2 at once, 4096 MiB\n"));
        assert!(shown.ends_with("; 0.5 per minute, 33 h 0 min to go\n"), "{shown}");
        assert_eq!([12, 200, 90_720].map(duration), ["12 s", "3 min 20 s", "25 h 12 min"]);
    }
}
