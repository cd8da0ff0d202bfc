//! The thread of the campaign: accepts requests, executes a run step by step, decides after every
//! halt.
//! Uses: everything in `campaign`, `rig::registry`. Never: HTTP, SQL, an exit other than the safe
//! end.
//!
//! It runs on its own thread and runtime, so that no HTTP request can delay a motion
//! (`docs/decisions/0002`). The plan determines the order of the steps, `resume` the remaining
//! steps, `run_state` and `rig_state` the next state. This module executes them.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::{OwnedMutexGuard, oneshot};
use tokio::task::JoinSet;
use tokio::time::Instant;
use tracing::{Instrument, Span};

use self::decide::OPERATED_WITHIN;
use self::skin::EmptySkin;
use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::bench::interlock::{Trip, TripKind};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::stage::{Height, Stage};
use crate::campaign::diary::{Diary, Note};
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunState};
use crate::campaign::safe_end;
use crate::campaign::shown::command::{Envelope, Handle, Moment, Refusal, Request, channel};
use crate::campaign::shown::placement::Confirmation;
use crate::campaign::shown::rig_action::{NO_STAGE, NO_WIRES};
use crate::campaign::shown::safe_end::SafeEnd;
use crate::campaign::shown::show;
use crate::campaign::spans::run_span;
use crate::clock::Clock;
use crate::journal::{ExitStatus, Journal, Mounting, error_chain};
use crate::priority;
use crate::rig::link::Line;
use crate::rig::setup::RigSetup;
use crate::rig::traits::SkinReader;
use crate::state::{StateChange, StoredState};

mod bench;
mod decide;
mod recovery;
mod session;
mod skin;
#[cfg(test)]
mod tests;
mod wait;

/// Period at which an idle or waiting engine checks its bench, wall.
const IDLE_TICK: Duration = Duration::from_millis(200);
/// Why nothing moves while a safe end is not complete.
const NOT_COMPLETE: &str =
    "the last safe end is not complete: the tips are down, or an axis is not stopped";
/// Pause before a safe end that is not complete is repeated.
const OWED_AGAIN: Duration = Duration::from_millis(500);
/// Longest pause before it is repeated again, once the tips are up: no request is read meanwhile.
const OWED_AGAIN_MAX: Duration = Duration::from_secs(30);
/// Longest wait for the store when the thread starts and ends.
const STORE_PATIENCE: Duration = Duration::from_secs(10);
/// Time after the end of a homing or a jog within which an abort was meant for it, wall.
const JUST_MOVED: Duration = Duration::from_secs(10);
/// Time after such an abort within which no jog begins, wall: a held button requests one after the other.
const NO_JOG_AFTER_ABORT: Duration = Duration::from_secs(5);
/// Time from the decision on a homing or a jog from which on a lock is read again before it begins, wall.
const DECIDED_WITHIN: Duration = Duration::from_secs(1);
/// Longest time since all devices replied for which a wire that fails as a run begins counts as just failed, wall.
const REPLIED_WITHIN: Duration = Duration::from_secs(30);
/// Longest wait between two automatic resumes, wall.
const LONGEST_BACKOFF: Duration = Duration::from_secs(120);

/// Starts the thread of the campaign for one rig. It ends on `Request::Shutdown`, or when every
/// handle is dropped.
///
/// # Errors
/// The operating system's error if the runtime or the thread cannot be created.
pub fn spawn(
    config: RigSetup,
    journal: Arc<dyn Journal>,
) -> std::io::Result<(Handle, std::thread::JoinHandle<()>)> {
    let estop = StopSwitch::default();
    let (handle, inbox) = channel(estop.clone(), show::closed(&config));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let thread = std::thread::Builder::new().name("campaign".into()).spawn(move || {
        priority::raise();
        runtime.block_on(async {
            let (diary, writing) = Diary::open(journal.clone());
            let control = Control::new(inbox, estop, diary, journal);
            Engine::new(config, control).serve().await;
            // Every clone of the diary is dropped: its task ends when all is written.
            if tokio::time::timeout(STORE_PATIENCE, writing).await.is_err() {
                tracing::error!("the diary was not written completely: its last notes are lost");
            }
        });
    })?;
    Ok((handle, thread))
}

/// Open wires and the tasks that use them.
struct Connection {
    /// Modbus wires by their names in the rig file, for their counters.
    lines: BTreeMap<String, Arc<Line>>,
    skin: Arc<dyn SkinReader>,
    clock: Clock,
    /// The devices that move and measure forces; none for a skin alone.
    stage: Option<Stage>,
    /// Serve the stop, and forward the frames; they end with the connection.
    _tasks: JoinSet<()>,
    /// Released with the connection; its tasks close their ports as soon as they run again.
    _wires: OwnedMutexGuard<()>,
}

impl Connection {
    /// Publishes the counters of the wires, without a request to any device.
    fn show_counters(&self, control: &Control) {
        show::counters(control, self.skin.as_ref(), &self.lines);
    }
}

struct Engine {
    config: RigSetup,
    control: Control,
    connection: Option<Connection>,
    prepared_setting: Option<u32>,
    /// Tips that are mounted, and whether they were entered since this thread started.
    mounting: Option<(Mounting, bool)>,
    /// The empty skin of a manual run.
    empty_skin: EmptySkin,
    /// Parts of the last safe end that are not complete.
    owed: Owed,
    /// Pause before these are tried again.
    owed_pause: Duration,
    /// When a homing or a jog ended last.
    moved_at: Option<Instant>,
    /// When one ended last that a person had requested, or has ended. What a person did before the start of this thread
    /// is not known: it counts as done at the start.
    operated_at: Instant,
    /// When an abort of one was requested last.
    aborted_at: Option<Instant>,
    /// When the devices were last known to reply outside a step of a run.
    replied_at: Option<Instant>,
    /// When the driven run halted last.
    halted_at: Moment,
    /// When the newest request that may move the rig was decided.
    decided_at: Moment,
    /// Span of the driven run, for the log; none outside a run.
    driven: Span,
}

/// Parts of a safe end that are still to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owed {
    /// The safe end is complete.
    Nothing,
    /// An axis did not acknowledge its stop or moved after it, or the wires failed during the raise to this height, at
    /// this time: repeated once the wires work.
    Wires(Instant, Height),
    /// The wires work and the tips are still down: a person must inspect the rig.
    Person,
}
/// Where the outcome of a request is sent.
type Answer = oneshot::Sender<Result<(), Refusal>>;

/// Decision after a halt.
enum Next {
    Again,
    /// The thread ends; the run stays open.
    Leave,
    End(ExitStatus, String),
}

/// Event that ended a wait.
enum Waited {
    Resume,
    Confirmed(Confirmation),
    /// The last placement was withdrawn: the plan asks for it again.
    Repeat,
    Ended(ExitStatus),
    Left,
}

impl Engine {
    fn new(config: RigSetup, control: Control) -> Self {
        let now = (jiff::Timestamp::now(), Instant::now());
        Self {
            config,
            control,
            connection: None,
            prepared_setting: None,
            mounting: None,
            empty_skin: EmptySkin::default(),
            owed: Owed::Nothing,
            owed_pause: OWED_AGAIN,
            moved_at: None,
            operated_at: now.1,
            replied_at: None,
            aborted_at: None,
            halted_at: now,
            decided_at: now,
            driven: Span::none(),
        }
    }

    /// Accepts requests until the shutdown. A panic leads to the safe end like any fault, and the
    /// thread continues to serve.
    async fn serve(mut self) {
        self.recall_mounting().await;
        loop {
            match AssertUnwindSafe(self.take_requests()).catch_unwind().await {
                Ok(()) => break,
                Err(panic) => {
                    let driven = std::mem::replace(&mut self.driven, Span::none());
                    self.after_panic(&panic_words(panic.as_ref())).instrument(driven).await;
                }
            }
        }
        let driven = self.driven.clone();
        self.make_safe(None, Height::Clear).instrument(driven).await;
    }

    async fn take_requests(&mut self) {
        let mut tick = tokio::time::interval(IDLE_TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        while !self.control.leaving() {
            tokio::select! {
                envelope = self.control.inbox.next() => match envelope {
                    None => return,
                    Some(Envelope { request: Request::Shutdown, answer, .. }) => {
                        let _ = answer.send(Ok(()));
                        return;
                    }
                    Some(Envelope {
                        request: Request::Start(job), answer, asked_in, signs, decided_at, ..
                    }) => {
                        self.decided_at = decided_at;
                        asked_in.in_scope(|| {
                            let (run, scan_id) = (job.run, job.scan_id);
                            tracing::info!(%run, scan_id, "the start of a run is requested");
                        });
                        // A night does not belong to the request that started it.
                        let span = run_span(job.run, job.scan_id);
                        self.driven = span.clone();
                        self.start(&job, answer, signs).instrument(span).await;
                        // A run that this thread leaves open keeps its span for the last safe end.
                        if !self.control.leaving() {
                            self.driven = Span::none();
                        }
                    }
                    Some(envelope) => {
                        let asked_in = envelope.asked_in.clone();
                        self.rig_request(envelope).instrument(asked_in).await;
                    }
                },
                _ = tick.tick() => {
                    self.notice_suspension();
                    self.look().await;
                }
            }
        }
    }

    /// Begins a run, unless a person may have come to the rig since it was requested. `signs`: those at that time. If a
    /// wire has just failed as a run begins by itself, this is a trip of that run: it keeps the rig, and may resume.
    async fn start(&mut self, job: &Job, answer: Answer, signs: u64) {
        let armed = match self.control.attended_since(signs) {
            Some(why) => Err(Refusal::Busy(format!("{why}: start it again"))),
            None => self.arm(job, &answer).await,
        };
        let (begun, first) = match armed {
            Err(Refusal::Fault(kind, detail))
                if job.has_waited && kind.may_pass() && self.has_just_failed() =>
            {
                (self.begin_halted(job, &answer).await, Some(Halt::trip(kind, detail)))
            }
            armed => (armed, None),
        };
        let go = begun.is_ok();
        let _ = answer.send(begun);
        if go {
            self.run(job, first).await;
        }
    }

    /// Whether a device that does not reply has just failed, and no homing or jog of a person, nor the start of this
    /// thread, came shortly before: otherwise a person may be at the rig.
    fn has_just_failed(&self) -> bool {
        self.replied_at.is_some_and(|at| at.elapsed() <= REPLIED_WITHIN)
            && self.operated_at.elapsed() > OPERATED_WITHIN
    }

    /// Executes the safe end, with or without a run. Returns true if nothing more can be done for
    /// the tips.
    async fn make_safe(&mut self, trip: Option<&Trip>, height: Height) -> bool {
        self.owed_pause = OWED_AGAIN;
        self.attempt_safe_end(trip, height, None).await
    }

    /// Repeats a safe end that is not complete; its event is stored if the result differs. An axis that moves after its
    /// stop takes seconds each time: with raised tips the next attempt is later.
    async fn repeat_safe_end(&mut self, height: Height) {
        let before = self.control.inbox.status.borrow().rig.safe_end.clone();
        if self.attempt_safe_end(None, height, before.as_ref()).await {
            self.owed_pause = OWED_AGAIN_MAX.min(2 * self.owed_pause);
        }
    }

    async fn attempt_safe_end(
        &mut self,
        trip: Option<&Trip>,
        height: Height,
        before: Option<&SafeEnd>,
    ) -> bool {
        let Some(stage) = self.connection.as_mut().and_then(|c| c.stage.as_mut()) else {
            // Nothing moves: a trip of a skin alone only latches.
            if let Some(trip) = trip {
                self.control.latch(trip);
            }
            return true;
        };
        let end = safe_end::make_safe(&mut self.control, stage, trip, height, before).await;
        self.owed = match (end.is_safe(), end.is_stopped()) {
            (true, true) => Owed::Nothing,
            (true, false) => Owed::Wires(Instant::now(), height),
            (false, _) if stage.pose().await.is_err() => Owed::Wires(Instant::now(), height),
            (false, _) => Owed::Person,
        };
        if self.owed == Owed::Nothing {
            self.replied_at = Some(Instant::now());
        }
        end.is_safe()
    }

    /// Refuses what moves an axis, or calls hands to the rig, while the last safe end is not complete.
    fn require_nothing_owed(&self) -> Result<(), Refusal> {
        match self.owed {
            Owed::Nothing => Ok(()),
            Owed::Wires(..) | Owed::Person => Err(Refusal::Busy(NOT_COMPLETE.into())),
        }
    }

    /// Latches that the computer was suspended, unless the wires are closed. Returns it as text.
    fn notice_suspension(&mut self) -> Option<String> {
        let words = self.control.was_suspended()?;
        if self.control.rig() != RigState::Disconnected {
            let detail = words.clone();
            self.control.latch(&Trip { kind: TripKind::Service, detail });
        }
        Some(words)
    }

    /// Checks the bench between runs: publishes its readings, latches an e-stop, and completes the
    /// last safe end once the wires work.
    async fn look(&mut self) {
        if let Some(press) = self.control.estop.pressed()
            && self.control.rig() != RigState::Disconnected
        {
            self.control.latch(&Trip { kind: TripKind::Estop, detail: press.why });
        }
        let Some(connection) = self.connection.as_ref() else { return };
        if let Owed::Wires(tried, height) = self.owed
            && tried.elapsed() > self.owed_pause
            && self.control.estop.pressed().is_none()
            && let Some(stage) = &connection.stage
            && stage.pose().await.is_ok()
        {
            self.repeat_safe_end(height).await;
        }
        if let Some(connection) = self.connection.as_ref() {
            connection.show_counters(&self.control);
            if let Some(stage) = &connection.stage {
                show::bench(&self.control, stage).await;
                let status = self.control.inbox.status.borrow();
                if status.rig.pose.is_some() && status.rig.live_cells.is_some() {
                    self.replied_at = Some(Instant::now());
                }
            }
        }
    }

    /// Handles a fault of the service: makes the rig safe and leaves the run open to be resumed.
    async fn after_panic(&mut self, words: &str) {
        let detail = format!("the campaign's thread failed: {words}");
        let trip = Trip { kind: TripKind::Service, detail };
        // Before the safe end, as for any trip: a process that dies meanwhile leaves no run that resumes automatically.
        if self.control.run() != RunState::Idle
            && let Some(run) = self.control.run_uid()
        {
            let why = Some(PausedWhy::Trip);
            let change = StateChange { why, ..StateChange::to(StoredState::Interrupted) };
            self.control.diary.note(Note::RunState(run, change));
        }
        let safe = AssertUnwindSafe(self.make_safe(Some(&trip), Height::Clear)).catch_unwind();
        if safe.await.is_err() {
            tracing::error!("the safe end itself failed: inspect the rig");
            if self.control.rig() != RigState::Tripped {
                self.control.latch(&trip);
            }
            // An axis may still move, and the tips may be down.
            if self.stage().is_some() {
                self.owed = Owed::Person;
            }
        }
        self.control.forget_run();
        self.control.show(|status| (status.run, status.rig.motion) = (None, None));
        self.prepared_setting = None;
    }

    /// Reads the tips that a person last entered before this thread started.
    async fn recall_mounting(&mut self) {
        let journal = self.control.journal.clone();
        let known = tokio::time::timeout(STORE_PATIENCE, journal.last_mounted()).await;
        match known {
            Ok(Ok(mounting)) => self.mounting = mounting.map(|m| (m, false)),
            Ok(Err(error)) => tracing::warn!(error = error_chain(&error), "tips are not known"),
            Err(_late) => tracing::warn!("tips are not known: the store does not answer"),
        }
    }
}

fn panic_words(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic".into())
}

/// Counts of failed attempts in this session.
struct Attempts {
    /// Number of the next attempt at the current configuration, from 1.
    of_configuration: u32,
    /// Configuration of the last failure.
    configuration: Option<u32>,
    /// Number of configurations given up.
    skipped: u32,
    /// Whether the attempt before the next one has failed.
    has_failed: bool,
    /// Placement that a person has confirmed, with that confirmation.
    confirmed: Option<(u32, Confirmation)>,
    /// The placement that was measured last.
    last: Last,
    /// Why the awaited placement was not measured; none if it was not tried.
    not_measured: Option<String>,
}

/// The placement that was measured last in this session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Last {
    /// No placement was measured in this session.
    Unknown,
    /// This one is stored.
    Stored(u32),
    /// It was withdrawn and is repeated now.
    Withdrawn,
}

impl Default for Attempts {
    fn default() -> Self {
        Self {
            of_configuration: 1,
            configuration: None,
            skipped: 0,
            has_failed: false,
            confirmed: None,
            last: Last::Unknown,
            not_measured: None,
        }
    }
}

fn trip_of(halt: &Halt) -> Trip {
    let device = |detail: String| Trip { kind: TripKind::Device, detail };
    match halt {
        Halt::Trip(trip) => trip.clone(),
        Halt::Failed(detail) => device(detail.clone()),
        Halt::Store(error) => device(error_chain(error)),
        Halt::Asked | Halt::Checkpoint | Halt::Needs(_) => device("ended early".into()),
    }
}

fn backoff(job: &Job, resumes: u32) -> Duration {
    let first = Duration::from_secs_f64(job.plan.policy.auto_resume_after_s);
    first.saturating_mul(1 << resumes.saturating_sub(1).min(6)).min(LONGEST_BACKOFF)
}

fn no_stage() -> Refusal {
    Refusal::State(NO_STAGE.into())
}

fn no_wires() -> Refusal {
    Refusal::State(NO_WIRES.into())
}
