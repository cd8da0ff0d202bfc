//! One wire, one owner: a task that sends one request at a time, enforces every deadline, retries
//! up to a limit, and gives stops priority.
//! Uses: `clock`, `pdu`, `wire`, `latch`. Never: meanings of registers, more than one request in
//! flight, a motion command repeated without its driver.
//!
//! After a lost or garbled reply the connection is closed and reopened, since a late reply would be
//! taken for the answer to the next request (tokio-modbus #324; on RTU replies have no number at
//! all). Exceptions 1 to 4 are returned immediately, 5 and 6 are repeated within a deadline, 8, 0xA
//! and 0xB are retried once over a new connection
//! (`docs/references.md`, "Exceptions and lost replies"). A motion whose reply was lost, or whose
//! exception (5, 8, 0xB) leaves open whether it was received, is returned as an error, because only
//! its driver can check that.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::{Notify, mpsc, oneshot};
use tokio::time::Instant;
use tokio_modbus::client::{Client, Context};
use tokio_modbus::slave::{Slave, SlaveContext};

use super::counts::{Counters, LineCounts, count};
use super::latch::MotionPermit;
use super::pdu::{self, Reply, Request};
use super::wire::{self, Framing, Opener};
use crate::clock::Clock;

/// Capacity of the queue of requests.
const LINE_REQUESTS_WAITING: usize = 64;
/// Capacity of the queue of stops.
const URGENT_QUEUE: usize = 16;
/// Wait before the second retry; before the n-th it is n - 1 times as long.
const RETRY_STEP: Duration = Duration::from_millis(25);
/// Wait before the request to a busy device (exceptions 5 and 6) is repeated.
const BUSY_BACKOFF: Duration = Duration::from_millis(10);

/// Deadlines and limits of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinePolicy {
    /// Longest wait for a connection or a reply, wall time.
    pub timeout: Duration,
    /// Largest number of attempts of one request.
    pub attempts: u32,
    /// Silence between a reply and the next request (RTU: 3.5 characters).
    pub silence: Duration,
    /// Longest time that a stop waits for the reply to a request in flight before it interrupts it.
    pub stop_grace: Duration,
}

/// Error of a request on a line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// No reply arrived within the deadline.
    #[error("no reply within {timeout_ms} ms")]
    NoReply {
        /// Deadline of the reply, wall ms.
        timeout_ms: u64,
    },
    /// The wire could not be opened, or the connection was lost.
    #[error("wire lost: {cause}")]
    Disconnected {
        /// Cause reported by the operating system.
        cause: String,
    },
    /// The reply does not fit the request.
    #[error("garbled reply: {cause}")]
    Garbled {
        /// Reason why the reply was rejected.
        cause: String,
    },
    /// The device replied with a Modbus exception.
    #[error("exception {code}")]
    Exception {
        /// Modbus exception code.
        code: u8,
    },
    /// A motion was refused because the emergency stop of the rig is latched.
    #[error("the emergency stop is latched")]
    Latched,
    /// A motion was withdrawn because its axis was commanded to stop before it was sent.
    #[error("withdrawn by a stop")]
    Withdrawn,
    /// The task that owns the wire has ended.
    #[error("the wire is closed")]
    Closed,
}

/// Handle of a wire. Dropping it ends the owner.
#[derive(Debug)]
pub struct Line {
    name: String,
    policy: LinePolicy,
    ordinary: mpsc::Sender<Job>,
    urgent: mpsc::Sender<Job>,
    bell: Arc<Notify>,
    counters: Arc<Counters>,
}

impl Line {
    /// Starts the owner of a wire on the current runtime. The port is opened by the first request.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn spawn(
        name: impl Into<String>,
        framing: Framing,
        opener: Opener,
        policy: LinePolicy,
        clock: Clock,
    ) -> Self {
        let (ordinary, ordinary_jobs) = mpsc::channel(LINE_REQUESTS_WAITING);
        let (urgent, urgent_jobs) = mpsc::channel(URGENT_QUEUE);
        let (bell, counters) = (Arc::<Notify>::default(), Arc::<Counters>::default());
        let owner = Owner {
            wire: Wire {
                framing,
                opener,
                policy,
                silent_since: clock.now(),
                clock,
                context: None,
                opened: false,
                counters: Arc::clone(&counters),
            },
            ordinary: ordinary_jobs,
            urgent: urgent_jobs,
            stops: VecDeque::new(),
            bell: Arc::clone(&bell),
        };
        tokio::spawn(owner.run());
        Self { name: name.into(), policy, ordinary, urgent, bell, counters }
    }

    /// Name of the wire in the rig file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Deadlines and limits of the line.
    pub fn policy(&self) -> LinePolicy {
        self.policy
    }

    /// Counters of the line.
    pub fn counts(&self) -> LineCounts {
        self.counters.counts()
    }

    /// Sends a request to one device, with retries up to the limit.
    ///
    /// # Errors
    /// The error of the last attempt; `LineError::Closed` if the owner has ended.
    pub async fn ask(&self, unit: u8, request: Request) -> Result<Reply, LineError> {
        self.send(&self.ordinary, Job::new(unit, request, Kind::Ordinary)).await
    }

    /// Sends a write that starts or directs motion, while its permit holds. It is attempted once
    /// per call: after a lost reply the driver must check the drive before it sends again.
    ///
    /// # Errors
    /// `Latched` or `Withdrawn` if the permit does not hold; otherwise as [`Line::ask`].
    pub async fn ask_motion(
        &self,
        unit: u8,
        request: Request,
        permit: MotionPermit,
    ) -> Result<Reply, LineError> {
        self.send(&self.ordinary, Job::new(unit, request, Kind::Motion(permit))).await
    }

    /// Sends a stop before all queued requests, with retries up to the limit.
    ///
    /// # Errors
    /// As [`Line::ask`].
    pub async fn ask_urgent(&self, unit: u8, request: Request) -> Result<Reply, LineError> {
        self.send(&self.urgent, Job::new(unit, request, Kind::Urgent)).await
    }

    async fn send(
        &self,
        lane: &mpsc::Sender<Job>,
        (job, answer): (Job, Answer),
    ) -> Result<Reply, LineError> {
        let urgent = matches!(job.kind, Kind::Urgent);
        lane.send(job).await.map_err(|_| LineError::Closed)?;
        if urgent {
            self.bell.notify_one();
        }
        answer.await.map_err(|_| LineError::Closed)?
    }
}

type Answer = oneshot::Receiver<Result<Reply, LineError>>;

#[derive(Debug)]
enum Kind {
    Ordinary,
    Motion(MotionPermit),
    Urgent,
}

#[derive(Debug)]
struct Job {
    unit: u8,
    request: Request,
    kind: Kind,
    failures: u32,
    gateway_retried: bool,
    busy_since: Option<Instant>,
    reply: oneshot::Sender<Result<Reply, LineError>>,
}

impl Job {
    fn new(unit: u8, request: Request, kind: Kind) -> (Self, Answer) {
        let (reply, answer) = oneshot::channel();
        let job = Self {
            unit,
            request,
            kind,
            failures: 0,
            gateway_retried: false,
            busy_since: None,
            reply,
        };
        (job, answer)
    }

    fn permitted(&self) -> Result<(), LineError> {
        if let Kind::Motion(permit) = &self.kind { permit.check() } else { Ok(()) }
    }
}

/// Decision after a failed attempt.
enum Next {
    GiveUp,
    Again,
    AgainAfter(Duration),
}

struct Owner {
    wire: Wire,
    ordinary: mpsc::Receiver<Job>,
    urgent: mpsc::Receiver<Job>,
    stops: VecDeque<Job>,
    bell: Arc<Notify>,
}

impl Owner {
    async fn run(mut self) {
        loop {
            tokio::select! {
                biased;
                Some(stop) = self.urgent.recv() => self.stops.push_back(stop),
                Some(job) = self.ordinary.recv() => self.serve(job).await,
                else => return,
            }
            self.serve_stops().await;
        }
    }

    /// Sends the waiting stops in turn, so that one silent device does not prevent the others from
    /// stopping.
    async fn serve_stops(&mut self) {
        loop {
            while let Ok(stop) = self.urgent.try_recv() {
                self.stops.push_back(stop);
            }
            let Some(mut stop) = self.stops.pop_front() else { return };
            match self.wire.attempt(&stop).await {
                Ok(reply) => answer(stop, Ok(reply)),
                Err(error) => match self.wire.after(&mut stop, &error) {
                    Next::GiveUp => answer(stop, Err(error)),
                    Next::Again => self.stops.push_back(stop),
                    Next::AgainAfter(wait) => {
                        if self.stops.is_empty() && self.urgent.is_empty() {
                            tokio::time::sleep(wait).await;
                        }
                        self.stops.push_back(stop);
                    }
                },
            }
        }
    }

    async fn serve(&mut self, mut job: Job) {
        loop {
            self.serve_stops().await;
            if job.reply.is_closed() {
                return;
            }
            if let Err(refused) = job.permitted() {
                return answer(job, Err(refused));
            }
            let grace = self.wire.policy.stop_grace;
            let outcome = tokio::select! {
                biased;
                outcome = self.wire.attempt(&job) => outcome,
                () = rung(&self.bell, &self.urgent, grace) => {
                    count(&self.wire.counters.cut_off);
                    self.wire.close();
                    if matches!(job.kind, Kind::Motion(_)) {
                        let timeout_ms = grace.as_millis() as u64;
                        answer(job, Err(LineError::NoReply { timeout_ms }));
                        return self.serve_stops().await;
                    }
                    continue;
                }
            };
            match outcome {
                Ok(reply) => return answer(job, Ok(reply)),
                Err(error) => match self.wire.after(&mut job, &error) {
                    Next::GiveUp => return answer(job, Err(error)),
                    Next::Again => {}
                    Next::AgainAfter(wait) => tokio::select! {
                        () = tokio::time::sleep(wait) => {}
                        () = rung(&self.bell, &self.urgent, Duration::ZERO) => {}
                    },
                },
            }
        }
    }
}

fn answer(job: Job, outcome: Result<Reply, LineError>) {
    // The caller may have stopped waiting.
    let _ = job.reply.send(outcome);
}

/// Waits until a stop has been waiting for `grace`.
async fn rung(bell: &Notify, urgent: &mpsc::Receiver<Job>, grace: Duration) {
    loop {
        bell.notified().await;
        if !urgent.is_empty() {
            break;
        }
    }
    if !grace.is_zero() {
        tokio::time::sleep(grace).await;
    }
}

struct Wire {
    framing: Framing,
    opener: Opener,
    policy: LinePolicy,
    clock: Clock,
    context: Option<Context>,
    opened: bool,
    silent_since: Instant,
    counters: Arc<Counters>,
}

impl Wire {
    fn close(&mut self) {
        self.context = None;
    }

    async fn open(&mut self) -> Result<Context, LineError> {
        let lost = |cause: String| LineError::Disconnected { cause };
        let limit = self.policy.timeout;
        let port = tokio::time::timeout(limit, (self.opener)())
            .await
            .map_err(|_| lost(format!("not open within {} ms", limit.as_millis())))?
            .map_err(|e| lost(e.to_string()))?;
        let context = wire::attach(port, self.framing, limit).await;
        if self.opened {
            count(&self.counters.reconnects);
        }
        self.opened = true;
        context.map_err(|e| lost(e.to_string()))
    }

    /// Executes one exchange. After a failure other than an exception the wire is closed.
    async fn attempt(&mut self, job: &Job) -> Result<Reply, LineError> {
        let mut context = match self.context.take() {
            Some(context) => context,
            None => self.open().await?,
        };
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
        let call = context.call(pdu::to_wire(&job.request));
        let outcome = tokio::time::timeout(self.policy.timeout, call).await;
        self.silent_since = self.clock.now();
        let outcome = match outcome {
            Err(_elapsed) => {
                let timeout_ms = self.policy.timeout.as_millis() as u64;
                return Err(LineError::NoReply { timeout_ms });
            }
            Ok(Err(error)) => return Err(from_wire(&error)),
            Ok(Ok(outcome)) => outcome,
        };
        let round_trip = self.silent_since - sent;
        self.counters.last_round_trip_us.store(round_trip.as_micros() as u64, Ordering::Relaxed);
        let result = match outcome {
            Err(exception) => Err(LineError::Exception { code: exception.into() }),
            Ok(response) => {
                let reply = pdu::reply_of(response);
                if let Err(cause) = job.request.accepts(&reply) {
                    return Err(LineError::Garbled { cause });
                }
                count(&self.counters.answered);
                Ok(reply)
            }
        };
        self.context = Some(context);
        result
    }

    /// Counts a failed attempt and decides what to do next.
    fn after(&mut self, job: &mut Job, error: &LineError) -> Next {
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

fn from_wire(error: &tokio_modbus::Error) -> LineError {
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
        tokio_modbus::Error::Transport(e) => LineError::Disconnected { cause: e.to_string() },
        tokio_modbus::Error::Protocol(e) => LineError::Garbled { cause: e.to_string() },
    }
}
