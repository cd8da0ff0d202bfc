//! What people and programs may ask of a campaign, and the handle they ask through.
//! Uses: tokio channels. Never: HTTP, storage, wires.
//!
//! Requests go through one bounded queue and are answered when they have been taken up, not when
//! they have been carried out: the status says what has been reached. The e-stop is not a request:
//! it goes past this queue (`campaign::bench::estop`).

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::run::job::Job;
use crate::campaign::shown::status::Status;
use crate::rig::traits::Frame;

/// Requests that may wait at once.
const QUEUE: usize = 64;
/// Longest wait for a request to be taken up.
const TAKE_UP: Duration = Duration::from_secs(10);

/// Something asked of the campaign.
#[derive(Debug, Clone)]
pub enum Request {
    /// Open the wires and check every device.
    Connect,
    /// Close the wires.
    Disconnect,
    /// Home all axes, z first.
    Home,
    /// Move one axis by hand: `x`, `y`, `z` (mm, machine) or `radius` (mm).
    Jog {
        /// The axis.
        axis: String,
        /// Absolute target, mm.
        to_mm: f64,
    },
    /// Read the cells' zeros.
    Tare,
    /// Acknowledge a trip.
    Reset,
    /// A person has mounted this many tips, on arms 1 to n.
    Mounted {
        /// How many.
        tips: u8,
        /// Who.
        who: String,
    },
    /// Start (or go on with) a run that has passed its preflight and was armed.
    Start(Arc<Job>),
    /// Pause after the current trial.
    PauseAtCheckpoint,
    /// Raise now and pause.
    PauseNow,
    /// Raise now and wait: something that watches the run asks for it.
    Suspend(String),
    /// Go on.
    Resume,
    /// Finish the trial, raise, end.
    Stop,
    /// Raise now, end.
    Abort,
    /// A person has done what a paused run waits for.
    Confirm {
        /// Who did it.
        who: String,
    },
    /// The last manual trial was bad: take it again.
    Repeat {
        /// Why it was bad.
        why: String,
    },
    /// End the thread.
    Shutdown,
}

/// Why a request was not taken up.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The state forbids it.
    #[error("{0}")]
    State(String),
    /// A value is outside its limits.
    #[error("{0}")]
    Value(String),
    /// The campaign's thread has ended or does not answer.
    #[error("the rig's thread does not answer")]
    Gone,
}

/// A request with the place to answer it.
#[derive(Debug)]
pub struct Envelope {
    /// What is asked.
    pub request: Request,
    /// Where the answer goes.
    pub answer: oneshot::Sender<Result<(), Refusal>>,
}

/// The campaign as the rest of the service sees it.
#[derive(Debug, Clone)]
pub struct Handle {
    requests: mpsc::Sender<Envelope>,
    status: watch::Receiver<Status>,
    frames: watch::Receiver<Option<Arc<Frame>>>,
    estop: StopSwitch,
}

/// The engine's end of a handle.
#[derive(Debug)]
pub struct Inbox {
    /// Requests in order.
    pub requests: mpsc::Receiver<Envelope>,
    /// Where the status goes.
    pub status: watch::Sender<Status>,
    /// Where the newest frame goes.
    pub frames: watch::Sender<Option<Arc<Frame>>>,
}

/// A handle and the engine's end of it.
pub fn channel(estop: StopSwitch, status: Status) -> (Handle, Inbox) {
    let (requests_tx, requests) = mpsc::channel(QUEUE);
    let (status_tx, status) = watch::channel(status);
    let (frames_tx, frames) = watch::channel(None);
    let handle = Handle { requests: requests_tx, status, frames, estop };
    (handle, Inbox { requests, status: status_tx, frames: frames_tx })
}

impl Handle {
    /// Asks for something and waits until it has been taken up or refused.
    pub async fn ask(&self, request: Request) -> Result<(), Refusal> {
        let (answer, answered) = oneshot::channel();
        let sent = self.requests.try_send(Envelope { request, answer });
        sent.map_err(|_| Refusal::Gone)?;
        match tokio::time::timeout(TAKE_UP, answered).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) | Err(_) => Err(Refusal::Gone),
        }
    }

    /// Stops every axis at once; needs no state, no lock and no queue.
    pub fn estop(&self, why: &str) {
        self.estop.press(why);
    }

    /// The stop button, for a bench that somebody else opens.
    pub fn stop_switch(&self) -> StopSwitch {
        self.estop.clone()
    }

    /// The newest status.
    pub fn status(&self) -> Status {
        self.status.borrow().clone()
    }

    /// Follows the status.
    pub fn watch_status(&self) -> watch::Receiver<Status> {
        self.status.clone()
    }

    /// Follows the newest frame; slow readers miss frames.
    pub fn watch_frames(&self) -> watch::Receiver<Option<Arc<Frame>>> {
        self.frames.clone()
    }
}
