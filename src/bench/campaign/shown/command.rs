//! Requests that people and programs may make to a campaign, and the handle for making them.
//! Uses: tokio channels, tracing. Never: HTTP, storage, wires.
//!
//! Requests go through one bounded queue and are answered when they are accepted, not when they are
//! complete: the status reports what has been reached. The e-stop is not a request: it bypasses
//! this queue (`campaign::bench::estop`).

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::{Mutex, OwnedMutexGuard, broadcast, mpsc, oneshot, watch};
use tokio::time::Instant;
use tracing::Span;

use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::RunEvent;
use crate::campaign::shown::frames::{FrameFeed, FrameViews, frames};
use crate::campaign::shown::placement::Confirmation;
use crate::campaign::shown::rig_action::RigAction;
use crate::campaign::shown::run_action::{self, ActionOnRun};
use crate::campaign::shown::samples::{ForceSample, Samples};
use crate::campaign::shown::status::{Done, Status};
use crate::ids::RunUid;
use crate::record::Untouched;
use crate::rig::traits::Frame;

/// Capacity of the request queue.
const REQUESTS_WAITING: usize = 64;
/// Longest wait until a request is accepted.
const TAKE_UP: Duration = Duration::from_secs(10);
/// Longest time from a request to the answer of work that changes what is stored, wall: its caller still waits.
pub const ANSWERED_WITHIN: Duration = Duration::from_secs(9);

/// A request to the campaign.
#[derive(Debug, Clone)]
pub enum Request {
    /// Open the wires and check every device.
    Connect,
    /// Close the wires.
    Disconnect,
    /// Home all axes, z first.
    Home,
    /// As `Home`, for a run of an earlier process: no person has requested it.
    HomeForRun,
    /// Move one axis outside a run: `x`, `y`, `z` (machine mm) or `radius` (mm).
    Jog {
        /// Axis: `x`, `y`, `z` or `radius`.
        axis: String,
        /// Absolute target, mm.
        to_mm: f64,
    },
    /// Measure the zeros of the cells.
    Tare,
    /// Acknowledge a trip.
    Reset,
    /// A person has mounted `tips` tips, on arms 1 to `tips`.
    Mounted {
        /// Number of tips, 0 to 6.
        tips: u8,
        /// Name of the person.
        who: String,
    },
    /// Start or resume a run that has passed its preflight and was armed.
    Start(Arc<Job>),
    /// Pause after the current trial.
    PauseAtCheckpoint,
    /// Raise now and pause.
    PauseNow,
    /// Raise now and wait, requested of this run by a suspender, with its reason.
    Suspend(RunUid, String),
    /// Resume a paused run.
    Resume,
    /// Finish the trial, raise, end.
    Stop,
    /// Raise now, end.
    Abort,
    /// End a homing or a jog outside a run: stop, then raise. A run that has begun meanwhile is aborted.
    AbortMotion,
    /// A person has done what a paused run waits for.
    Confirm {
        /// What was done, as far as it was stated.
        done: Done,
        /// Who confirms it, and the verdict on the placement.
        confirmation: Confirmation,
    },
    /// Withdraw a manual trial and repeat it.
    Repeat {
        /// Index of the placement; absent: the one that was measured last.
        trial: Option<u32>,
        /// Reason for the repetition.
        why: String,
    },
    /// A pause or an abort came after the run had ended: no waiting run begins by itself.
    CameLate,
    /// End the thread of the campaign.
    Shutdown,
}

impl Request {
    /// The action on the rig that it requests, as a person who operates it does. None for a request to a run.
    pub fn rig_action(&self) -> Option<RigAction> {
        match self {
            Self::Connect => Some(RigAction::Connect),
            Self::Disconnect => Some(RigAction::Disconnect),
            Self::Home | Self::HomeForRun => Some(RigAction::Home),
            Self::Jog { .. } => Some(RigAction::Jog),
            Self::Tare => Some(RigAction::Tare),
            Self::Reset => Some(RigAction::Reset),
            Self::Mounted { .. } => Some(RigAction::Tips),
            Self::Start(_)
            | Self::PauseAtCheckpoint
            | Self::PauseNow
            | Self::Suspend(..)
            | Self::Resume
            | Self::Stop
            | Self::Abort
            | Self::AbortMotion
            | Self::Confirm { .. }
            | Self::Repeat { .. }
            | Self::CameLate
            | Self::Shutdown => None,
        }
    }

    /// Its name, for refusals.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Connect => "connect",
            Self::Disconnect => "disconnect",
            Self::Home | Self::HomeForRun => "home",
            Self::Jog { .. } => "jog",
            Self::Tare => "tare",
            Self::Reset => "reset",
            Self::Mounted { .. } => "tips",
            Self::Start(_) => "start",
            Self::PauseAtCheckpoint | Self::PauseNow => "pause",
            Self::Suspend(..) => "suspend",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::Abort | Self::AbortMotion => "abort",
            Self::Confirm { .. } => "confirm",
            Self::Repeat { .. } => "repeat",
            Self::CameLate => "a late pause or abort",
            Self::Shutdown => "shutdown",
        }
    }

    /// Why the active run refuses it at this status, as text; `None` if it does not, and for all that is not
    /// requested of an active run.
    pub fn refused_by_run(&self, status: &Status) -> Option<String> {
        let action = match self {
            Self::PauseNow => {
                let run = status.run.as_ref()?;
                return run_action::pause_refused(RunEvent::PauseNow, run);
            }
            // A suspender is behind the campaign: another run may have begun.
            Self::Suspend(run, _) => {
                let other = status.run.as_ref().filter(|active| active.uid != *run)?;
                return Some(format!("suspend is not possible: run {} is active", other.scan_id));
            }
            Self::PauseAtCheckpoint => ActionOnRun::Pause,
            Self::Resume => ActionOnRun::Resume,
            Self::Stop => ActionOnRun::Stop,
            Self::Abort | Self::AbortMotion => ActionOnRun::Abort,
            Self::Confirm { .. } => ActionOnRun::Confirm,
            Self::Repeat { .. } => ActionOnRun::Repeat,
            Self::Connect
            | Self::Disconnect
            | Self::Home
            | Self::HomeForRun
            | Self::Jog { .. }
            | Self::Tare
            | Self::Reset
            | Self::Mounted { .. }
            | Self::Start(_)
            | Self::CameLate
            | Self::Shutdown => return None,
        };
        action.refused(status)
    }
}

/// Reason why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The present state forbids it.
    #[error("{0}")]
    State(String),
    /// The rig moves outside a run, or a person may just have come to it; it may be possible afterwards.
    #[error("{0}")]
    Busy(String),
    /// A device did not reply, or reported a fault, as the rig was armed; kind of the trip that it is in a run.
    #[error("{1}")]
    Fault(TripKind, String),
    /// A value is outside its limits.
    #[error("{0}")]
    Value(String),
    /// The campaign's thread has ended or does not answer.
    #[error("the rig's thread does not answer")]
    Gone,
}

/// A wall time and the same instant: the wall clock may be set later.
pub type Moment = (Timestamp, Instant);

/// A request with the channel for its answer.
#[derive(Debug)]
pub struct Envelope {
    /// What the campaign must do.
    pub request: Request,
    /// Channel for the answer: accepted or refused.
    pub answer: oneshot::Sender<Result<(), Refusal>>,
    /// Span in which it was made, for the log.
    pub asked_in: Span,
    /// Presses of the e-stop when it was made.
    pub presses: u64,
    /// Signs of a person at the rig when it was decided.
    pub signs: u64,
    /// When it was decided: an operator lock that was taken later is not known to its caller.
    pub decided_at: Moment,
}

impl Envelope {
    /// Whether the caller of a request that would move the rig, or permit it, no longer waits for the answer: to
    /// the caller it has failed. What stops or ends is carried out in any case.
    fn is_abandoned(&self) -> bool {
        self.answer.is_closed()
            && match self.request {
                Request::Connect
                | Request::Home
                | Request::HomeForRun
                | Request::Jog { .. }
                | Request::Reset
                | Request::Mounted { .. }
                | Request::Start(_)
                | Request::Resume
                | Request::Confirm { .. } => true,
                Request::Disconnect
                | Request::Tare
                | Request::PauseAtCheckpoint
                | Request::PauseNow
                | Request::Suspend(..)
                | Request::Stop
                | Request::Abort
                | Request::AbortMotion
                | Request::Repeat { .. }
                | Request::CameLate
                | Request::Shutdown => false,
            }
    }
}

/// The wires of the rig: held by who has them open. Two owners would take each other's replies.
#[derive(Debug, Clone, Default)]
pub struct Wires(Arc<Mutex<()>>);

impl Wires {
    /// Takes the wires; `None` while another part has them open.
    pub fn take(&self) -> Option<OwnedMutexGuard<()>> {
        Arc::clone(&self.0).try_lock_owned().ok()
    }
}

/// Access of the rest of the service to the campaign.
#[derive(Debug, Clone)]
pub struct Handle {
    requests: mpsc::Sender<Envelope>,
    status: watch::Receiver<Status>,
    frames: FrameViews,
    samples: Samples,
    untouched: watch::Receiver<Option<Arc<Untouched>>>,
    estop: StopSwitch,
    wires: Wires,
}

/// The engine's side of a handle.
#[derive(Debug)]
pub struct Inbox {
    /// Requests in order of arrival.
    pub requests: mpsc::Receiver<Envelope>,
    /// Channel for the status.
    pub status: watch::Sender<Status>,
    /// Channel for the frames.
    pub frames: FrameFeed,
    /// Channel for every sample of the load cells.
    pub samples: Samples,
    /// Channel for the untouched skin.
    pub untouched: watch::Sender<Option<Arc<Untouched>>>,
    /// The wires, which a check of the rig opens too.
    pub wires: Wires,
}

/// Creates a handle and the engine's side of it.
pub fn channel(estop: StopSwitch, status: Status) -> (Handle, Inbox) {
    let (requests_tx, requests) = mpsc::channel(REQUESTS_WAITING);
    let (status_tx, status) = watch::channel(status);
    let (frames_tx, frames) = frames();
    let (untouched_tx, untouched) = watch::channel(None);
    let samples = Samples::default();
    let wires = Wires::default();
    let handle = Handle {
        requests: requests_tx,
        status,
        frames,
        samples: samples.clone(),
        untouched,
        estop,
        wires: wires.clone(),
    };
    let inbox = Inbox {
        requests,
        status: status_tx,
        frames: frames_tx,
        samples,
        untouched: untouched_tx,
        wires,
    };
    (handle, inbox)
}

impl Inbox {
    /// Waits for the next request that is not abandoned; `None` once every handle is dropped.
    pub async fn next(&mut self) -> Option<Envelope> {
        loop {
            let envelope = self.requests.recv().await?;
            if !envelope.is_abandoned() {
                return Some(envelope);
            }
        }
    }

    /// The next request that has already arrived and is not abandoned.
    pub fn pending(&mut self) -> Option<Envelope> {
        while let Ok(envelope) = self.requests.try_recv() {
            if !envelope.is_abandoned() {
                return Some(envelope);
            }
        }
        None
    }
}

impl Handle {
    /// Sends a request and waits until it is accepted or refused.
    ///
    /// # Errors
    /// The refusal; `Refusal::Gone` if the thread has ended, its queue is full, or it does not
    /// answer in time.
    pub async fn ask(&self, request: Request) -> Result<(), Refusal> {
        let signs = self.status.borrow().attended.signs;
        self.ask_since(request, signs, (Timestamp::now(), Instant::now())).await
    }

    /// As [`Self::ask`]. `signs`: signs of a person that were known when the request was decided; a start is refused after
    /// a further one. `decided_at`: when that was; a start or a resume is refused after a lock that was taken later, and a
    /// homing or a jog if a safe end had to be completed before it, or if it was taken up more than 1 s later.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub async fn ask_since(
        &self,
        request: Request,
        signs: u64,
        decided_at: Moment,
    ) -> Result<(), Refusal> {
        let (answer, answered) = oneshot::channel();
        let (asked_in, presses) = (Span::current(), self.estop.presses());
        let envelope = Envelope { request, answer, asked_in, presses, signs, decided_at };
        self.requests.try_send(envelope).map_err(|_| Refusal::Gone)?;
        match tokio::time::timeout(TAKE_UP, answered).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) | Err(_) => Err(Refusal::Gone),
        }
    }

    /// Stops every axis immediately; needs no state, no lock and no queue.
    pub fn estop(&self, why: &str) {
        self.estop.press(why);
    }

    /// Returns the stop button, for a bench that another part opens.
    pub fn stop_switch(&self) -> StopSwitch {
        self.estop.clone()
    }

    /// Returns the wires, for a check that opens them while the rig is disconnected.
    pub fn wires(&self) -> Wires {
        self.wires.clone()
    }

    /// Returns the newest status.
    pub fn status(&self) -> Status {
        self.status.borrow().clone()
    }

    /// Subscribes to the status.
    pub fn watch_status(&self) -> watch::Receiver<Status> {
        self.status.clone()
    }

    /// Subscribes to the newest frame; slow readers miss frames.
    pub fn watch_frames(&self) -> watch::Receiver<Option<Arc<Frame>>> {
        self.frames.newest()
    }

    /// Follows each frame from now on; slow readers miss frames.
    pub fn follow_frames(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.frames.follow()
    }

    /// Follows every sample of the load cells; slow readers miss samples.
    pub fn follow_samples(&self) -> broadcast::Receiver<ForceSample> {
        self.samples.follow()
    }

    /// Returns the frames of the untouched skin that were taken last; none before the first.
    pub fn untouched(&self) -> Option<Arc<Untouched>> {
        self.untouched.borrow().clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::bench::stand_in;
    use crate::campaign::shown::show;
    use crate::rig::setup::RigSetup;

    #[tokio::test]
    async fn a_motion_that_nobody_waits_for_is_dropped_and_a_stop_is_not() {
        let setup = RigSetup::from(stand_in::config());
        let (handle, mut inbox) = channel(StopSwitch::default(), show::closed(&setup));
        let mounted = Request::Mounted { tips: 2, who: "ada".into() };
        for request in [Request::Home, Request::Stop, mounted, Request::Resume, Request::Abort] {
            let asked = tokio::time::timeout(Duration::from_millis(1), handle.ask(request));
            assert!(asked.await.is_err(), "nobody answers");
        }
        let waiting = tokio::spawn(async move { handle.ask(Request::Reset).await });
        tokio::task::yield_now().await;
        let taken: Vec<Envelope> = std::iter::from_fn(|| inbox.pending()).collect();
        let requests: Vec<&Request> = taken.iter().map(|envelope| &envelope.request).collect();
        assert!(matches!(requests[..], [Request::Stop, Request::Abort, Request::Reset]));
        drop(taken);
        assert!(waiting.await.unwrap().is_err());
    }
}
