//! One wire, one owner: a task that sends one request at a time and gives stops priority.
//! Uses: `clock`, `exchange`, `latch`. Never: more than one request in flight, a motion command repeated without
//! its driver.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, mpsc};
use tokio::time::Instant;

use super::counts::{Counters, LineCounts};
use super::error::LineError;
use super::exchange::{Answer, Job, Kind, LinePolicy, Next, Wire};
use super::latch::MotionPermit;
use super::pdu::{Reply, Request};
use super::wire::{Framing, Opener};
use crate::clock::Clock;

/// Capacity of the queue of requests.
const LINE_REQUESTS_WAITING: usize = 64;
/// Capacity of the queue of stops.
const URGENT_QUEUE: usize = 16;
/// Attempts of a request that stops may cut off. The stop of a silent device is sent again and again: without a limit
/// a request to it would never end, nor those behind it.
const CUT_OFFS_MAX: u32 = 3;
/// Pause before a stop without a reply is sent again while requests wait, as a multiple of `LinePolicy::stop_grace`: z
/// is raised in it on a wire with a silent device.
const REQUESTS_BETWEEN: u32 = 4;

/// Handle of a wire. Dropping it ends the owner.
#[derive(Debug)]
pub struct Line {
    policy: LinePolicy,
    ordinary: mpsc::Sender<Job>,
    urgent: mpsc::Sender<Job>,
    bell: Arc<Notify>,
    counters: Arc<Counters>,
}

impl Line {
    /// Starts the owner of a wire on the current runtime. The port is opened by the first request. `port`: its address
    /// or path, for errors.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn spawn(
        framing: Framing,
        port: impl Into<String>,
        opener: Opener,
        policy: LinePolicy,
        clock: Clock,
    ) -> Self {
        let (ordinary, ordinary_jobs) = mpsc::channel(LINE_REQUESTS_WAITING);
        let (urgent, urgent_jobs) = mpsc::channel(URGENT_QUEUE);
        let (bell, counters) = (Arc::<Notify>::default(), Arc::<Counters>::default());
        let owner = Owner {
            wire: Wire::new(framing, port.into(), opener, policy, clock, Arc::clone(&counters)),
            stop_grace: policy.stop_grace,
            ordinary: ordinary_jobs,
            urgent: urgent_jobs,
            again: VecDeque::new(),
            again_at: Instant::now(),
            bell: Arc::clone(&bell),
        };
        tokio::spawn(owner.run());
        Self { policy, ordinary, urgent, bell, counters }
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

struct Owner {
    wire: Wire,
    stop_grace: Duration,
    ordinary: mpsc::Receiver<Job>,
    urgent: mpsc::Receiver<Job>,
    /// Stops that must be sent again.
    again: VecDeque<Job>,
    /// When they are due.
    again_at: Instant,
    bell: Arc<Notify>,
}

impl Owner {
    async fn run(mut self) {
        loop {
            self.serve_stops(false).await;
            tokio::select! {
                biased;
                () = rung(&self.bell, &self.urgent, self.stop_due(), Duration::ZERO) => {}
                job = self.ordinary.recv() => match job {
                    Some(job) => self.serve(job).await,
                    None if self.again.is_empty() => return,
                    None => tokio::time::sleep_until(self.again_at).await,
                },
            }
        }
    }

    /// When the next stop that was sent already is due; `None` without one.
    fn stop_due(&self) -> Option<Instant> {
        (!self.again.is_empty()).then_some(self.again_at)
    }

    /// Takes the next stop: first those that were not sent yet, so that one silent device does not prevent the others
    /// from stopping.
    fn next_stop(&mut self) -> Option<Job> {
        let fresh = self.urgent.try_recv().ok();
        fresh.or_else(|| self.again.pop_front_if(|_| self.again_at <= Instant::now()))
    }

    /// Sends the stops that are due. One without a reply is due later if a request waits, such as the raise of the
    /// tips: the stops of silent devices, which are sent again and again, must not keep a request to another device
    /// waiting. `is_asked`: whether a request that was taken already waits.
    async fn serve_stops(&mut self, is_asked: bool) {
        while let Some(mut stop) = self.next_stop() {
            match self.wire.attempt(&stop).await {
                Ok(reply) => stop.answer(Ok(reply)),
                Err(error) => {
                    let pause = match self.wire.after(&mut stop, &error) {
                        Next::GiveUp => {
                            stop.answer(Err(error));
                            continue;
                        }
                        Next::Again => Duration::ZERO,
                        Next::AgainAfter(wait) => wait,
                    };
                    let is_silent = matches!(error, LineError::NoReply { .. });
                    let requests = match is_silent && (is_asked || !self.ordinary.is_empty()) {
                        true => REQUESTS_BETWEEN * self.stop_grace,
                        false => Duration::ZERO,
                    };
                    self.again.push_back(stop);
                    self.again_at = Instant::now() + pause.max(requests);
                }
            }
        }
    }

    async fn serve(&mut self, mut job: Job) {
        loop {
            self.serve_stops(true).await;
            if job.is_abandoned() {
                return;
            }
            if let Err(refused) = job.permitted() {
                return job.answer(Err(refused));
            }
            let (grace, is_motion) = (self.stop_grace, matches!(job.kind, Kind::Motion(_)));
            if is_motion && !self.urgent.is_empty() {
                continue;
            }
            // A motion is cut off for a new stop only: what became of it would have to be read first.
            let stop_due = self.stop_due().filter(|_| !is_motion);
            let outcome = tokio::select! {
                biased;
                outcome = self.wire.attempt(&job) => outcome,
                () = rung(&self.bell, &self.urgent, stop_due, grace) => {
                    self.wire.cut_off();
                    job.cut_offs += 1;
                    if is_motion || job.cut_offs >= CUT_OFFS_MAX {
                        let timeout_ms = grace.as_millis() as u64;
                        return job.answer(Err(LineError::NoReply { timeout_ms }));
                    }
                    continue;
                }
            };
            match outcome {
                Ok(reply) => return job.answer(Ok(reply)),
                Err(error) => match self.wire.after(&mut job, &error) {
                    Next::GiveUp => return job.answer(Err(error)),
                    Next::Again => {}
                    Next::AgainAfter(wait) => tokio::select! {
                        () = tokio::time::sleep(wait) => {}
                        () = rung(&self.bell, &self.urgent, self.stop_due(), Duration::ZERO) => {}
                    },
                },
            }
        }
    }
}

/// Waits until a stop has been waiting for `grace`: a new one, or those that are `due` again then.
async fn rung(bell: &Notify, urgent: &mpsc::Receiver<Job>, due: Option<Instant>, grace: Duration) {
    let new = async {
        while urgent.is_empty() {
            bell.notified().await;
        }
    };
    match due {
        Some(due) => tokio::select! {
            () = new => {}
            () = tokio::time::sleep_until(due) => {}
        },
        None => new.await,
    }
    if !grace.is_zero() {
        tokio::time::sleep(grace).await;
    }
}
