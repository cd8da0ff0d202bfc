//! One wire, one owner: a task that sends one request at a time and gives stops priority.
//! Uses: `clock`, `exchange`, `latch`. Never: more than one request in flight, a motion command repeated without
//! its driver.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, mpsc};

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
            wire: Wire::new(framing, opener, policy, clock, Arc::clone(&counters)),
            stop_grace: policy.stop_grace,
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

struct Owner {
    wire: Wire,
    stop_grace: Duration,
    ordinary: mpsc::Receiver<Job>,
    urgent: mpsc::Receiver<Job>,
    stops: VecDeque<Job>,
    bell: Arc<Notify>,
}

impl Owner {
    async fn run(mut self) {
        loop {
            self.serve_stops().await;
            if !self.stops.is_empty() {
                if let Ok(job) = self.ordinary.try_recv() {
                    self.serve(job).await;
                }
                continue;
            }
            tokio::select! {
                biased;
                Some(stop) = self.urgent.recv() => self.stops.push_back(stop),
                Some(job) = self.ordinary.recv() => self.serve(job).await,
                else => return,
            }
        }
    }

    /// Sends the waiting stops in turn, so that one silent device does not prevent the others from
    /// stopping. Returns when none waits, or when one was given up: the stops of several silent devices, which are sent
    /// again and again, must not keep a request to another device waiting. Others may still wait then.
    async fn serve_stops(&mut self) {
        loop {
            while let Ok(stop) = self.urgent.try_recv() {
                self.stops.push_back(stop);
            }
            let Some(mut stop) = self.stops.pop_front() else { return };
            match self.wire.attempt(&stop).await {
                Ok(reply) => stop.answer(Ok(reply)),
                Err(error) => match self.wire.after(&mut stop, &error) {
                    Next::GiveUp => return stop.answer(Err(error)),
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
            if job.is_abandoned() {
                return;
            }
            if let Err(refused) = job.permitted() {
                return job.answer(Err(refused));
            }
            let grace = self.stop_grace;
            let stop_waits = !self.stops.is_empty() || !self.urgent.is_empty();
            // While the e-stop is latched it has no permit: these stops are sent a few times only.
            if stop_waits && matches!(job.kind, Kind::Motion(_)) {
                continue;
            }
            let outcome = tokio::select! {
                biased;
                outcome = self.wire.attempt(&job) => outcome,
                () = rung(&self.bell, &self.urgent, stop_waits, grace) => {
                    self.wire.cut_off();
                    job.cut_offs += 1;
                    if matches!(job.kind, Kind::Motion(_)) || job.cut_offs >= CUT_OFFS_MAX {
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
                        () = rung(&self.bell, &self.urgent, stop_waits, Duration::ZERO) => {}
                    },
                },
            }
        }
    }
}

/// Waits until a stop has been waiting for `grace`. `stop_waits`: whether one waits already.
async fn rung(bell: &Notify, urgent: &mpsc::Receiver<Job>, stop_waits: bool, grace: Duration) {
    if !stop_waits {
        loop {
            bell.notified().await;
            if !urgent.is_empty() {
                break;
            }
        }
    }
    if !grace.is_zero() {
        tokio::time::sleep(grace).await;
    }
}
