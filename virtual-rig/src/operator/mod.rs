//! The virtual operator: a process that does what a run requests from a person (mounts tips, places
//! weights) and confirms it over the public API of the service.
//! Uses: reqwest, the control socket of the rig, sim-core's sensor. Never: internals of the service, wires of the rig.

use std::io::{self, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use rustls::crypto::ring;
use rustls::{ClientConfig, RootCertStore};
use serde::Deserialize;
use serde_json::{Value, json};
use sim_core::sensor::Sensor;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::bench::Weight;
use crate::hand::{Hand, HandError as NoHand};
use crate::run::{RunError, end_of_life};

/// Environment variable with the API key of the operator.
const KEY_VARIABLE: &str = "PALPATE_KEY";
/// Period at which the status is checked, wall.
const STATUS_POLL: Duration = Duration::from_millis(100);
/// Shortest period, if the clock of the rig runs fast.
const STATUS_POLL_MIN: Duration = Duration::from_millis(5);
/// Time without a reply of the service after which the operator ends.
const AWAY_MAX: Duration = Duration::from_secs(10);
/// Longest wait for one reply of the service, which judges a placement first, or of the control socket;
/// less than `AWAY_MAX`.
const REPLY_WAIT: Duration = Duration::from_millis(9500);
/// Refusals of one confirmation to which the operator reacts; later ones are reported.
const REFUSALS_MAX: u32 = 2;
/// Time for which the skin is left clear until the service has seen it, process, and at least this wall time.
const CLEAR: Duration = Duration::from_secs(6);
const CLEAR_MIN: Duration = Duration::from_secs(1);
/// Time after which a request that is still shown is handled again: the confirmation was lost, or
/// the trial is repeated.
const REPEAT_AFTER: Duration = Duration::from_secs(1);

/// `palpate virtual-operator`: mounts tips, places weights, confirms.
#[derive(Debug, Clone, Args)]
pub struct OperatorArgs {
    /// Base URL of the service; its key is in PALPATE_KEY.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub url: String,
    /// Address of the rig's control socket.
    #[arg(long, value_name = "ADDRESS")]
    pub control: String,
    /// Process seconds per wall second: a fast rig needs a fast operator.
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    pub speed: f64,
    /// Name that is logged with its actions.
    #[arg(long, default_value = "virtual operator")]
    pub who: String,
    /// Probability of placing one weight of a trial on a wrong point at first, 0 to 1.
    #[arg(long, value_name = "P", default_value_t = 0.0)]
    pub mistakes: f64,
    /// Seed of the mistakes.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// End when standard input closes, that is when the parent process ends.
    #[arg(long)]
    pub with_parent: bool,
}

/// Reason why the operator cannot work.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum OperatorError {
    /// The runtime or the signal handlers could not be created.
    #[error(transparent)]
    Start(#[from] RunError),
    #[error(transparent)]
    Hand(#[from] NoHand),
    #[error("TLS: {0}")]
    Tls(#[source] rustls::Error),
    #[error("HTTP client: {0}")]
    Client(#[source] reqwest::Error),
    #[error(
        "no answer of a palpate service at {url} for {after_s:.0} s: {why}; name its address with --url"
    )]
    Away { url: String, after_s: f64, why: String },
}

/// Reason why one status check or action failed; the next check is the retry.
#[derive(Debug, thiserror::Error)]
enum HandError {
    #[error("service: {0}")]
    Service(#[from] reqwest::Error),
    #[error("service answered {status} to {action}")]
    Refused { action: &'static str, status: reqwest::StatusCode },
    #[error("control socket: {0}")]
    Control(#[from] io::Error),
    #[error("the rig refused: {0}")]
    Rig(String),
}

/// Status of the service, as far as the operator reads it.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
struct Status {
    #[serde(default)]
    run: Option<Run>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct Run {
    uid: String,
    state: String,
    #[serde(default)]
    paused_why: Option<String>,
    #[serde(default)]
    wanted: Option<Value>,
}

/// Request of a paused run to a person.
#[derive(Debug, Clone, PartialEq)]
enum Requested {
    Tips(usize),
    Weights { trial: u64, contacts: Vec<Weight> },
}

impl Run {
    /// Request of the run, if it is one that the operator can handle.
    fn requested(&self) -> Option<Requested> {
        #[derive(Deserialize)]
        struct Tips {
            tips: usize,
        }
        #[derive(Deserialize)]
        struct Trial {
            trial: u64,
            contacts: Vec<Weight>,
        }
        let wanted = self.wanted.clone().filter(|_| self.state == "paused")?;
        match self.paused_why.as_deref()? {
            "tip_change" => {
                serde_json::from_value(wanted).ok().map(|Tips { tips }| Requested::Tips(tips))
            }
            "manual_trial" => serde_json::from_value(wanted)
                .ok()
                .map(|Trial { trial, contacts }| Requested::Weights { trial, contacts }),
            _ => None,
        }
    }
}

/// Works until a signal, until the parent ends, or until the service has not replied for 10 s. `sensor`: has the points
/// for mistakes.
///
/// # Errors
/// The runtime, the signal handlers or the HTTP client cannot be created; `Away` if the service did not reply.
pub fn operator_main(args: OperatorArgs, sensor: Option<&Sensor>) -> Result<(), OperatorError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(RunError::Start)?;
    runtime.block_on(async {
        let ended = end_of_life(args.with_parent)?;
        let key = std::env::var(KEY_VARIABLE).ok();
        let mut operator = Operator::new(args, sensor, key)?;
        tokio::select! {
            () = ended => Ok(()),
            away = operator.work(AWAY_MAX) => Err(away),
        }
    })
}

struct Operator {
    args: OperatorArgs,
    key: Option<String>,
    client: reqwest::Client,
    control: Option<BufReader<TcpStream>>,
    weights_down: bool,
    confirmed: Option<(String, Requested, Instant)>,
    /// Uid of the run in which the skin was tared.
    tared: Option<String>,
    hand: Hand,
    /// A confirmation that was refused, and how often.
    refused: Option<(Requested, u32)>,
}

impl Operator {
    fn new(
        args: OperatorArgs,
        sensor: Option<&Sensor>,
        key: Option<String>,
    ) -> Result<Self, OperatorError> {
        // The service is on this machine: no authority is trusted, and none is read.
        let tls = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(OperatorError::Tls)?
            .with_root_certificates(RootCertStore::empty())
            .with_no_client_auth();
        let client = reqwest::Client::builder().tls_backend_preconfigured(tls).timeout(REPLY_WAIT);
        let client = client.build().map_err(OperatorError::Client)?;
        let hand = Hand::new(args.mistakes, args.seed, sensor)?;
        let (control, confirmed, tared, refused) = (None, None, None, None);
        let weights_down = false;
        Ok(Self { args, key, client, control, weights_down, confirmed, tared, hand, refused })
    }

    /// Checks and acts until the service has not replied for `away_max`; returns this as an error.
    async fn work(&mut self, away_max: Duration) -> OperatorError {
        let look = STATUS_POLL.div_f64(self.args.speed.max(1.0)).max(STATUS_POLL_MIN);
        let mut seen = Instant::now();
        let mut told = String::new();
        loop {
            let outcome = match self.look().await {
                Ok(status) => {
                    let outcome = self.act(status).await;
                    seen = Instant::now();
                    outcome
                }
                Err(error) => Err(error),
            };
            // After an answer it was seen just now.
            if let Err(error) = &outcome
                && seen.elapsed() > away_max
            {
                let (url, after_s) = (self.args.url.clone(), away_max.as_secs_f64());
                return OperatorError::Away { url, after_s, why: cause(error) };
            }
            let trouble = outcome.err().map(|e| e.to_string()).unwrap_or_default();
            if trouble != told && !trouble.is_empty() {
                tracing::warn!(trouble, "virtual operator");
            }
            told = trouble;
            tokio::time::sleep(look).await;
        }
    }

    /// Asks the service: a GET, or a POST of a body. `action`: what it is in an error.
    async fn ask(
        &self,
        action: &'static str,
        path: &str,
        body: Option<&Value>,
    ) -> Result<reqwest::Response, HandError> {
        let url = format!("{}/api/v1/{path}", self.args.url.trim_end_matches('/'));
        let mut request = match body {
            Some(body) => self.client.post(url).json(body),
            None => self.client.get(url),
        };
        if let Some(key) = &self.key {
            request = request.bearer_auth(key);
        }
        let answer = request.send().await?;
        let status = answer.status();
        if status.is_success() { Ok(answer) } else { Err(HandError::Refused { action, status }) }
    }

    async fn look(&self) -> Result<Status, HandError> {
        Ok(self.ask("status", "status", None).await?.json().await?)
    }

    async fn act(&mut self, status: Status) -> Result<(), HandError> {
        let requested = status.run.as_ref().and_then(Run::requested);
        let (Some(run), Some(requested)) = (status.run, requested) else {
            self.confirmed = None;
            return Ok(());
        };
        if let Some((uid, done, when)) = &self.confirmed
            && *uid == run.uid
            && *done == requested
            && when.elapsed() < REPEAT_AFTER
        {
            return Ok(());
        }
        // After a first refusal the weights are placed as asked; after a second one they are right, and
        // the skin is wrong.
        let refusals =
            self.refused.as_ref().filter(|(w, _)| *w == requested).map_or(0, |(_, n)| *n);
        let why = self.do_requested(&run.uid, &requested, refusals).await?;
        match self.confirm(&run.uid, &requested, &why, refusals > 1).await {
            Err(HandError::Refused { status, .. })
                if status == reqwest::StatusCode::CONFLICT && refusals < REFUSALS_MAX =>
            {
                self.refused = Some((requested, refusals + 1));
                return Ok(());
            }
            outcome => outcome?,
        }
        // A closed stderr is no error.
        let _ = writeln!(io::stderr(), "{why}, confirmed");
        self.refused = None;
        self.confirmed = Some((run.uid, requested, Instant::now()));
        Ok(())
    }

    /// Takes everything off the skin until the service has seen it untouched, and tares it if it has not.
    async fn clear_skin(&mut self, uid: &str) -> Result<(), HandError> {
        let before = self.untouched_at().await?;
        self.tell_rig(&json!({ "cmd": "clear" })).await?;
        self.weights_down = false;
        if self.tared.as_deref() == Some(uid) {
            let since = Instant::now();
            while since.elapsed() < CLEAR.div_f64(self.args.speed.max(1.0)).max(CLEAR_MIN) {
                if self.untouched_at().await? != before {
                    return Ok(());
                }
                tokio::time::sleep(STATUS_POLL_MIN).await;
            }
        }
        let body = json!({ "action": "tare", "who": self.args.who, "why": "the skin is clear" });
        self.ask("tare", "rig/actions", Some(&body)).await?;
        self.tared = Some(uid.to_owned());
        Ok(())
    }

    /// Time of the untouched frame that the service knows; none if it knows none.
    async fn untouched_at(&self) -> Result<Option<String>, HandError> {
        match self.ask("untouched frame", "frames/untouched", None).await {
            Ok(answer) => {
                let untouched: Value = answer.json().await?;
                Ok(untouched["at"].as_str().map(str::to_owned))
            }
            Err(HandError::Refused { status: reqwest::StatusCode::NOT_FOUND, .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    async fn do_requested(
        &mut self,
        uid: &str,
        requested: &Requested,
        refusals: u32,
    ) -> Result<String, HandError> {
        match requested {
            Requested::Tips(tips) => {
                if self.weights_down {
                    self.tell_rig(&json!({ "cmd": "clear" })).await?;
                    self.weights_down = false;
                }
                self.tell_rig(&json!({ "cmd": "mount", "tips": tips })).await?;
                Ok(format!("mounted {}", counted(*tips, "tip")))
            }
            Requested::Weights { trial, contacts } => {
                let placed = match refusals {
                    0 => {
                        self.clear_skin(uid).await?;
                        self.hand.places(contacts)
                    }
                    _ => contacts.clone(),
                };
                self.tell_rig(&json!({ "cmd": "place", "weights": placed })).await?;
                self.weights_down = !contacts.is_empty();
                let placed = counted(contacts.len(), "weight");
                Ok(format!("placed {placed} for trial {trial}"))
            }
        }
    }

    async fn confirm(
        &self,
        uid: &str,
        requested: &Requested,
        why: &str,
        anyway: bool,
    ) -> Result<(), HandError> {
        let mut body = json!({ "action": "confirm", "who": self.args.who, "why": why });
        match requested {
            Requested::Tips(tips) => body["tips"] = (*tips).into(),
            Requested::Weights { trial, .. } => body["trial"] = (*trial).into(),
        }
        if anyway {
            body["anyway"] = true.into();
        }
        self.ask("confirm", &format!("runs/{uid}/actions"), Some(&body)).await.map(drop)
    }

    /// Sends one command to the rig and reads its reply.
    async fn tell_rig(&mut self, command: &Value) -> Result<(), HandError> {
        let reply = timeout(REPLY_WAIT, self.exchange(command)).await;
        let reply = reply.map_err(io::Error::other).and_then(|r| r);
        if reply.is_err() {
            self.control = None;
        }
        let reply: Value = serde_json::from_str(&reply?).map_err(io::Error::other)?;
        if reply["ok"] == Value::Bool(true) {
            return Ok(());
        }
        Err(HandError::Rig(reply["error"].as_str().unwrap_or("no reason given").to_owned()))
    }

    async fn exchange(&mut self, command: &Value) -> io::Result<String> {
        let wire = match &mut self.control {
            Some(wire) => wire,
            none => none.insert(BufReader::new(TcpStream::connect(&self.args.control).await?)),
        };
        wire.get_mut().write_all(format!("{command}\n").as_bytes()).await?;
        let mut reply = String::new();
        if wire.read_line(&mut reply).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Ok(reply)
    }
}

/// The first cause of an error: that of the HTTP client repeats the address.
fn cause(error: &HandError) -> String {
    let mut first: &dyn std::error::Error = error;
    while let Some(source) = first.source() {
        first = source;
    }
    first.to_string()
}

/// A number with its noun.
fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests;
