//! `palpate estop`: an emergency stop, requested until it is answered.
//! Uses: `client`. Never: a probe of the service before the stop, a stop that its key prevents.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::time::Instant;

use super::ask::ActArgs;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::key::key;
use super::output::note;
use super::{At, embed};

/// Longest wait for the axes' acknowledgement of an emergency stop.
const ACKNOWLEDGED: Duration = Duration::from_secs(3);
/// Interval of polling for the acknowledgement, and pause before a stop is sent again.
const ACKNOWLEDGED_POLL: Duration = Duration::from_millis(50);
/// Repetitions of a stop that was not answered.
const ESTOP_AGAIN: usize = 4;

/// An emergency stop that the service has latched.
#[derive(Debug)]
pub struct Stopped {
    latched: Value,
    /// Time until every axis had acknowledged, ms.
    acknowledged_ms: Option<f64>,
    /// Axes that have not acknowledged, or move after it, each with its cause.
    missing: Vec<String>,
    /// Whether every axis was read at rest.
    stands: bool,
    /// Whether the rig has a stage, whose axes acknowledge.
    has_stage: bool,
}

/// Requests an emergency stop until it is answered, then waits for the axes' acknowledgement as far as
/// it is known. `tell` receives what a person must know of the request.
///
/// # Errors
/// `CliError::NotStopped` or `StopUnanswered` if the request for the stop fails; the acknowledgement is only
/// reported.
pub async fn press_estop(
    at: &At,
    why: Option<&str>,
    tell: impl FnOnce(&str),
) -> CliResult<Stopped> {
    // The service is not probed first: the stop must be the first request. On the loopback it needs no
    // key: one that cannot be read, or that is refused, must not prevent it.
    let key = key().unwrap_or_else(|error| {
        tell(&format!("the stop is requested without a key: {error}"));
        None
    });
    let named =
        |key| embed::clients(at, key).map_err(|error| CliError::NotStopped(Box::new(error)));
    let mut clients = named(key.clone())?;
    if key.is_some() {
        clients.extend(named(None)?);
    }
    let (mut tries, mut refused) = (0, None);
    let not_stopped = |error| match error {
        // It may have arrived.
        CliError::Http(_) => CliError::StopUnanswered(Box::new(error)),
        error => CliError::NotStopped(Box::new(error)),
    };
    let (client, answer): (&Client, Value) = loop {
        let client = &clients[tries % clients.len()];
        let body = json!({ "why": why, "who": client.who() });
        match client.post("/api/v1/estop", &body).await {
            Ok(answer) => break (client, answer),
            // A stop may be repeated: a crowded service may close a connection unanswered.
            Err(CliError::NoServer { .. } | CliError::Http(_) | CliError::Untrusted { .. })
                if tries < ESTOP_AGAIN =>
            {
                tries += 1;
                tokio::time::sleep(ACKNOWLEDGED_POLL).await;
            }
            // Another client may have no key, or another address.
            Err(error @ CliError::Refused { status: 401, .. }) if tries + 1 < clients.len() => {
                refused = refused.or(Some(error));
                tries += 1;
            }
            Err(error) => return Err(not_stopped(refused.unwrap_or(error))),
        }
    };
    let asked = Instant::now();
    let latched = answer["latched"].clone();
    let (missing, stands) = (Vec::new(), false);
    let mut stopped = Stopped { latched, acknowledged_ms: None, missing, stands, has_stage: true };
    while stopped.has_stage && !stopped.stands && asked.elapsed() < ACKNOWLEDGED {
        tokio::time::sleep(ACKNOWLEDGED_POLL).await;
        // The stop is latched, whether or not the service reports on it.
        if let Ok(status) = client.status().await {
            stopped.acknowledged_ms = status.rig.estop_acknowledged_ms;
            stopped.missing = status.rig.not_stopped();
            stopped.stands = status.rig.stands();
            stopped.has_stage = status.rig.has_stage;
        }
    }
    Ok(stopped)
}

impl Stopped {
    /// Result for a person, with the next command.
    pub fn words(&self) -> String {
        let axes = match self.acknowledged_ms {
            Some(ms) if self.stands => format!("every axis had acknowledged after {ms:.1} ms"),
            Some(ms) if self.missing.is_empty() => {
                format!("every axis had acknowledged after {ms:.1} ms, and may still move")
            }
            None if !self.has_stage => "a skin alone has no axis to stop".into(),
            None if self.missing.is_empty() => "no acknowledgement of the axes yet".into(),
            Some(_) | None => {
                format!("NOT STOPPED: {}; the stop is sent again", self.missing.join(", "))
            }
        };
        format!("stopped and latched; {axes}. Check the rig, then run `palpate rig reset`.")
    }
}

/// Runs `palpate estop`.
///
/// # Errors
/// As [`press_estop`].
pub async fn estop(args: &ActArgs) -> CliResult<()> {
    let stopped = press_estop(&args.at, args.why.as_deref(), |words| note(words)).await?;
    let answer = json!({ "latched": stopped.latched, "acknowledged_ms": stopped.acknowledged_ms,
        "not_stopped": stopped.missing, "stands": stopped.stands });
    args.at.output().say(&answer, stopped.words());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_result_states_whether_the_axes_may_still_move() {
        let words = |stands| {
            let (latched, acknowledged_ms, missing) = (Value::Null, Some(2.0), Vec::new());
            Stopped { latched, acknowledged_ms, missing, stands, has_stage: true }.words()
        };
        let acknowledged = "stopped and latched; every axis had acknowledged after 2.0 ms";
        assert!(words(true).starts_with(&format!("{acknowledged}. ")));
        assert!(words(false).starts_with(&format!("{acknowledged}, and may still move. ")));
    }
}
