//! One exchange on a wire: its deadlines, and what follows a failed one, up to a limit.
//! Uses: `clock`, `pdu`, `wire`, `latch`. Never: meanings of registers, the order of requests.
//!
//! After a lost or garbled reply the connection is closed and reopened, since a late reply would be
//! taken for the answer to the next request (tokio-modbus #324; on RTU replies have no number at
//! all, so that a request to which it could be an answer waits for it). Exceptions 1 to 4 are
//! returned immediately, 5 and 6 are repeated within a deadline, 8, 0xA and 0xB are retried once
//! over a new connection (`docs/references.md`, "Exceptions and lost replies"). A motion whose reply
//! was lost, or whose exception (5, 8, 0xB) leaves open whether it was received, is returned as an
//! error, because only its driver can check that.

use std::collections::BTreeSet;
use std::mem::discriminant;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::Instant;
use tokio_modbus::client::{Client, Context};
use tokio_modbus::slave::{Slave, SlaveContext};

use super::counts::{Counters, count};
use super::error::LineError;
use super::latch::MotionPermit;
use super::pdu::{self, Reply, Request};
use super::wire::{self, Framing, LateReply, Opener};
use crate::clock::Clock;

/// Wait before the second retry; before the n-th it is n - 1 times as long.
const RETRY_STEP: Duration = Duration::from_millis(25);
/// Wait before the request to a busy device (exceptions 5 and 6) is repeated.
const BUSY_BACKOFF: Duration = Duration::from_millis(10);
/// Time beyond its deadline within which a reply on a serial line is still expected.
const LATE_REPLY: Duration = Duration::from_millis(50);
/// Words of tokio-util for a connection that was closed within a frame.
const ENDS_WITHIN_FRAME: &str = "bytes remaining on stream";

/// Deadlines and limits of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinePolicy {
    /// Longest wait for a connection or a reply, wall time.
    pub timeout: Duration,
    /// Largest number of attempts of one request.
    pub attempts: u32,
    /// Silence between a reply and the next request (RTU: 3.5 characters).
    pub silence: Duration,
    /// Longest time that a stop waits for the reply to a request in flight before it interrupts it, and that the first
    /// stop of a silent device waits for its reply.
    pub stop_grace: Duration,
}

/// Where the outcome of a request arrives.
pub(super) type Answer = oneshot::Receiver<Result<Reply, LineError>>;

/// What a request is for.
#[derive(Debug)]
pub(super) enum Kind {
    Ordinary,
    Motion(MotionPermit),
    Urgent,
}

/// A request with what has been tried.
#[derive(Debug)]
pub(super) struct Job {
    unit: u8,
    request: Request,
    pub(super) kind: Kind,
    failures: u32,
    /// Attempts that a stop has cut off.
    pub(super) cut_offs: u32,
    gateway_retried: bool,
    busy_since: Option<Instant>,
    reply: oneshot::Sender<Result<Reply, LineError>>,
}

impl Job {
    pub(super) fn new(unit: u8, request: Request, kind: Kind) -> (Self, Answer) {
        let (reply, answer) = oneshot::channel();
        let job = Self {
            unit,
            request,
            kind,
            failures: 0,
            cut_offs: 0,
            gateway_retried: false,
            busy_since: None,
            reply,
        };
        (job, answer)
    }

    /// Whether the stop of a motion has not come before it was sent.
    pub(super) fn permitted(&self) -> Result<(), LineError> {
        if let Kind::Motion(permit) = &self.kind { permit.check() } else { Ok(()) }
    }

    /// Whether its caller has stopped waiting.
    pub(super) fn is_abandoned(&self) -> bool {
        self.reply.is_closed()
    }

    pub(super) fn answer(self, outcome: Result<Reply, LineError>) {
        // The caller may have stopped waiting.
        let _ = self.reply.send(outcome);
    }
}

/// A request on a serial line whose reply may still arrive.
#[derive(Debug)]
struct Owed {
    unit: u8,
    request: Request,
    until: Instant,
}

impl Owed {
    /// Whether its reply would be taken for the answer to this request.
    fn could_answer(&self, job: &Job) -> bool {
        self.unit == job.unit && self.request.is_alike(&job.request)
    }

    /// Whether an exception in reply to it would be taken for one to this request: it names only the function.
    fn could_refuse(&self, job: &Job) -> bool {
        self.unit == job.unit && discriminant(&self.request) == discriminant(&job.request)
    }
}

/// Decision after a failed attempt.
pub(super) enum Next {
    GiveUp,
    Again,
    AgainAfter(Duration),
}

/// The connection of a wire, opened by the first exchange.
pub(super) struct Wire {
    framing: Framing,
    /// Address or path, for errors.
    port: String,
    opener: Opener,
    policy: LinePolicy,
    clock: Clock,
    context: Option<Context>,
    opened: bool,
    /// Devices that have not replied to their last request.
    silent: BTreeSet<u8>,
    silent_since: Instant,
    /// Requests without a reply so far, on a serial line.
    owed: Vec<Owed>,
    counters: Arc<Counters>,
}

impl Wire {
    pub(super) fn new(
        framing: Framing,
        port: String,
        opener: Opener,
        policy: LinePolicy,
        clock: Clock,
        counters: Arc<Counters>,
    ) -> Self {
        let silent_since = clock.now();
        let (context, opened, silent, owed) = (None, false, BTreeSet::new(), Vec::new());
        Self {
            framing,
            port,
            opener,
            policy,
            clock,
            context,
            opened,
            silent,
            silent_since,
            owed,
            counters,
        }
    }

    fn close(&mut self) {
        self.context = None;
    }

    /// Closes the wire of an exchange that a stop interrupted.
    pub(super) fn cut_off(&mut self) {
        count(&self.counters.cut_off);
        self.close();
    }

    async fn open(&mut self, late: Option<LateReply>) -> Result<Context, LineError> {
        let lost = |cause: String| LineError::Disconnected { cause };
        let limit = self.policy.timeout;
        let port = tokio::time::timeout(limit, (self.opener)())
            .await
            .map_err(|_| lost(format!("not open within {} ms", limit.as_millis())))?
            .map_err(|e| lost(e.to_string()))?;
        let context = wire::attach(port, self.framing, limit, late).await;
        if self.opened {
            count(&self.counters.reconnects);
        }
        self.opened = true;
        context.map_err(|e| lost(e.to_string()))
    }

    /// Longest wait for the reply. The first stop of a silent device must not delay those of the others.
    fn reply_limit(&self, job: &Job) -> Duration {
        let is_first_stop = matches!(job.kind, Kind::Urgent) && job.failures == 0;
        match is_first_stop && self.silent.contains(&job.unit) {
            true => self.policy.stop_grace.min(self.policy.timeout),
            false => self.policy.timeout,
        }
    }

    /// The reply that would be taken for the answer to this request. A stop does not wait for one: the echo of an earlier
    /// stop acknowledges a stop, too, and that of another write does not (`attempt`).
    fn late_reply(&mut self, job: &Job) -> Option<LateReply> {
        let now = self.clock.now();
        self.owed.retain(|owed| owed.until > now);
        if matches!(job.kind, Kind::Urgent) {
            return None;
        }
        let alike = self.owed.iter().filter(|owed| owed.could_answer(job));
        let until = alike.map(|owed| owed.until).max()?;
        Some(LateReply { until, is_only: self.owed.len() == 1 })
    }

    /// Executes one exchange. After a failure other than an exception the wire is closed.
    pub(super) async fn attempt(&mut self, job: &Job) -> Result<Reply, LineError> {
        let late = self.late_reply(job);
        if late.is_some() {
            self.close();
        }
        let mut context = match self.context.take() {
            Some(context) => context,
            None => self.open(late).await?,
        };
        if late.is_some() {
            self.owed.retain(|owed| !owed.could_answer(job));
        }
        let next = self.silent_since + self.policy.silence;
        if !self.policy.silence.is_zero() && next > self.clock.now() {
            tokio::time::sleep_until(next).await;
        }
        // The stop may have been latched while the wire was opened or silent.
        if let Err(refused) = job.permitted() {
            self.context = Some(context);
            return Err(refused);
        }
        context.set_slave(Slave(job.unit));
        let sent = self.clock.now();
        if self.framing == Framing::Rtu {
            let until = sent + self.policy.timeout + LATE_REPLY;
            self.owed.push(Owed { unit: job.unit, request: job.request.clone(), until });
        }
        let call = context.call(pdu::to_wire(&job.request));
        let limit = self.reply_limit(job);
        let outcome = tokio::time::timeout(limit, call).await;
        self.silent_since = self.clock.now();
        let outcome = match outcome {
            Err(_elapsed) => {
                self.silent.insert(job.unit);
                return Err(LineError::NoReply { timeout_ms: limit.as_millis() as u64 });
            }
            Ok(Err(error)) => {
                // After a reply to another request the own one is still awaited.
                if matches!(error, tokio_modbus::Error::Transport(_)) {
                    self.owed.pop();
                }
                return Err(from_wire(&error, &self.port));
            }
            Ok(Ok(outcome)) => outcome,
        };
        self.silent.remove(&job.unit);
        let round_trip = self.silent_since - sent;
        self.counters.last_round_trip_us.store(round_trip.as_micros() as u64, Ordering::Relaxed);
        let result = match outcome {
            Err(exception) => {
                let code: u8 = exception.into();
                self.require_own(job, Owed::could_refuse, &format!("exception {code}"))?;
                Err(LineError::Exception { code })
            }
            Ok(response) => {
                let reply = pdu::reply_of(response);
                if let Err(cause) = job.request.accepts(&reply) {
                    return Err(LineError::Garbled { cause });
                }
                self.require_own(job, Owed::could_answer, &reply.to_string())?;
                count(&self.counters.answered);
                Ok(reply)
            }
        };
        self.context = Some(context);
        result
    }

    /// Checks that a reply to this request, the newest one, cannot be that to an earlier one. If it can, as `could_be`
    /// states, that one has been answered, and the reply to the newest one is still awaited.
    fn require_own(
        &mut self,
        job: &Job,
        could_be: fn(&Owed, &Job) -> bool,
        reply: &str,
    ) -> Result<(), LineError> {
        let is_of_other = |owed: &Owed| could_be(owed, job) && owed.request != job.request;
        if let Some(at) = self.owed.iter().position(is_of_other) {
            self.owed.remove(at);
            let cause = format!("{reply} may answer an earlier request");
            return Err(LineError::Garbled { cause });
        }
        self.owed.pop();
        Ok(())
    }

    /// Counts a failed attempt and decides what to do next.
    pub(super) fn after(&mut self, job: &mut Job, error: &LineError) -> Next {
        let limit = self.policy.timeout * self.policy.attempts;
        let next = match error {
            LineError::Exception { code } => {
                count(&self.counters.exceptions);
                match code {
                    5 | 8 | 0x0B if matches!(job.kind, Kind::Motion(_)) => Next::GiveUp,
                    5 | 6 => {
                        let since = *job.busy_since.get_or_insert(self.clock.now());
                        let waited = self.clock.now().saturating_duration_since(since);
                        let over = waited + BUSY_BACKOFF > limit;
                        if over { Next::GiveUp } else { Next::AgainAfter(BUSY_BACKOFF) }
                    }
                    8 | 0x0A | 0x0B if !job.gateway_retried => {
                        job.gateway_retried = true;
                        self.close();
                        Next::Again
                    }
                    _ => Next::GiveUp,
                }
            }
            LineError::NoReply { .. } => {
                count(&self.counters.timeouts);
                self.after_failure(job)
            }
            LineError::Garbled { .. } => {
                count(&self.counters.garbled);
                self.after_failure(job)
            }
            LineError::Disconnected { .. } => self.after_failure(job),
            LineError::Latched | LineError::Withdrawn | LineError::Closed => Next::GiveUp,
        };
        if !matches!(next, Next::GiveUp) {
            count(&self.counters.retries);
        }
        next
    }

    /// What follows a request without a sound reply. A motion is never repeated.
    fn after_failure(&self, job: &mut Job) -> Next {
        job.failures += 1;
        if job.failures >= self.policy.attempts || matches!(job.kind, Kind::Motion(_)) {
            Next::GiveUp
        } else if job.failures == 1 {
            Next::Again
        } else {
            Next::AgainAfter(RETRY_STEP * (job.failures - 1))
        }
    }
}

fn from_wire(error: &tokio_modbus::Error, port: &str) -> LineError {
    use std::io::ErrorKind;
    match error {
        tokio_modbus::Error::Transport(e)
            if matches!(e.kind(), ErrorKind::InvalidData | ErrorKind::InvalidInput) =>
        {
            LineError::Garbled { cause: e.to_string() }
        }
        // For a closed connection the library returns the last system error, often "success".
        tokio_modbus::Error::Transport(e) if e.raw_os_error() == Some(0) => {
            LineError::Disconnected { cause: "closed by the other side".into() }
        }
        tokio_modbus::Error::Transport(e) if e.to_string() == ENDS_WITHIN_FRAME => {
            let cause = format!(
                "{port}: the answer is not a Modbus reply, or only the start of one; check the address"
            );
            LineError::Disconnected { cause }
        }
        tokio_modbus::Error::Transport(e) => LineError::Disconnected { cause: e.to_string() },
        tokio_modbus::Error::Protocol(e) => LineError::Garbled { cause: e.to_string() },
    }
}
