//! The campaign's thread: takes requests, drives a run step by step, decides after every halt.
//! Uses: everything in `campaign`, `rig::registry`. Never: HTTP, SQL.
//!
//! It runs on a thread and a runtime of its own, so that no HTTP read can delay a motion
//! (`design.md` 4). What it does in which order is the plan's; what is left of it is `resume`'s;
//! which state follows is `run_state`'s and `rig_state`'s. Here they are put to work.

use std::sync::Arc;
use std::time::Duration;

use tokio::task::JoinHandle;

use super::command::{Envelope, Handle, Inbox, Refusal, Request, channel};
use super::control::Control;
use super::estop::StopSwitch;
use super::halt::Halt;
use super::interlock::{self, TripKind};
use super::job::Job;
use super::journal::{ExitStatus, Journal};
use super::rig_state::RigState;
use super::show;
use super::stage::Stage;
use super::status::{Phase, Wanted};
use crate::rig::config::RigConfig;
use crate::rig::registry::OpenBench;

mod bench;
mod decide;
mod session;
mod wait;

/// How often an idle or waiting engine looks at its bench, wall.
const IDLE_TICK: Duration = Duration::from_millis(200);
/// Longest wait between two automatic resumes, wall.
const LONGEST_BACKOFF: Duration = Duration::from_secs(120);

/// Starts the campaign's thread for one rig. It ends on `Request::Shutdown`, or when every handle
/// is gone.
pub fn spawn(
    config: RigConfig,
    journal: Arc<dyn Journal>,
) -> std::io::Result<(Handle, std::thread::JoinHandle<()>)> {
    let estop = StopSwitch::default();
    let (handle, inbox) = channel(estop.clone(), show::closed(&config));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let thread = std::thread::Builder::new().name("campaign".into()).spawn(move || {
        runtime.block_on(Engine::new(config, inbox, estop, journal).serve());
    })?;
    Ok((handle, thread))
}

/// Open wires and the tasks that live with them.
struct Connection {
    open: OpenBench,
    stage: Stage,
    estop: JoinHandle<()>,
    frames: JoinHandle<()>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.estop.abort();
        self.frames.abort();
    }
}

struct Engine {
    config: RigConfig,
    control: Control,
    connection: Option<Connection>,
    prepared_setting: Option<u32>,
}

/// What to do after a halt.
enum Next {
    Again,
    /// The thread ends; the run stays open.
    Leave,
    End(ExitStatus, String),
}

/// What ended a wait.
enum Waited {
    Resume,
    Confirmed(String),
    Ended(ExitStatus),
    Left,
}

impl Engine {
    fn new(config: RigConfig, inbox: Inbox, estop: StopSwitch, journal: Arc<dyn Journal>) -> Self {
        let control = Control::new(inbox, estop, journal);
        Self { config, control, connection: None, prepared_setting: None }
    }

    async fn serve(mut self) {
        let mut tick = tokio::time::interval(IDLE_TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                envelope = self.control.inbox.requests.recv() => match envelope {
                    None => break,
                    Some(Envelope { request: Request::Shutdown, answer }) => {
                        let _ = answer.send(Ok(()));
                        break;
                    }
                    Some(Envelope { request: Request::Start(job), answer }) => {
                        let armed = self.arm(&job).await;
                        let go = armed.is_ok();
                        let _ = answer.send(armed);
                        if go {
                            self.run(&job).await;
                        }
                        if self.control.leaving() {
                            break;
                        }
                    }
                    Some(envelope) => self.rig_request(envelope).await,
                },
                _ = tick.tick() => self.look().await,
            }
        }
        if let Some(connection) = self.connection.as_mut()
            && matches!(self.control.rig(), RigState::Homed | RigState::Armed)
            && let Err(error) = connection.stage.raise().await
        {
            tracing::warn!(error, "the tips were not raised at the end");
        }
    }

    /// A look at the bench between runs: shows where it stands, latches an e-stop.
    async fn look(&mut self) {
        if let Some(press) = self.control.estop.pressed()
            && !matches!(self.control.rig(), RigState::Tripped | RigState::Disconnected)
        {
            let trip = interlock::Trip { kind: TripKind::Estop, detail: press.why };
            self.control.trip(&trip).await;
        }
        if let Some(connection) = self.connection.as_ref() {
            show::bench(&self.control, &connection.stage, &connection.open).await;
        }
    }
}

/// What has been tried in this session.
struct Attempts {
    /// The next try's number at the configuration under way.
    of_configuration: u32,
    /// The configuration of the last failure.
    configuration: Option<u32>,
    /// Configurations given up.
    skipped: u32,
    /// The placement that a person has confirmed, and who.
    confirmed_by: Option<(u32, String)>,
}

impl Default for Attempts {
    fn default() -> Self {
        Self { of_configuration: 1, configuration: None, skipped: 0, confirmed_by: None }
    }
}

async fn require_tips(stage: &mut Stage, tips: u8) -> Result<(), Halt> {
    let reading = stage.bench.cells.read().await?;
    match interlock::live_tips(&stage.config.cells, &reading.volts) {
        Ok(live) if live == tips => {
            stage.tips = tips;
            Ok(())
        }
        Ok(_) | Err(_) => Err(Halt::Needs(Wanted::Tips { tips })),
    }
}

async fn raise(stage: &mut Stage, control: &Control) -> Result<(), Halt> {
    control.phase(Phase::Raise);
    stage.raise().await.map_err(|e| Halt::trip(TripKind::Position, format!("not raised: {e}")))
}

fn trip_of(halt: Halt) -> interlock::Trip {
    match halt {
        Halt::Trip(trip) => trip,
        Halt::Failed(detail) => interlock::Trip { kind: TripKind::Device, detail },
        Halt::Store(error) => {
            interlock::Trip { kind: TripKind::Device, detail: error_chain(&error) }
        }
        Halt::Asked | Halt::Checkpoint | Halt::Needs(_) => {
            interlock::Trip { kind: TripKind::Device, detail: "left before its end".into() }
        }
    }
}

fn backoff(job: &Job, resumes: u32) -> Duration {
    let first = Duration::from_secs_f64(job.plan.policy.auto_resume_after_s);
    first.saturating_mul(1 << resumes.saturating_sub(1).min(6)).min(LONGEST_BACKOFF)
}

fn no_wires() -> Refusal {
    Refusal::State("the rig is disconnected".into())
}

/// An error with its causes, for people.
pub fn error_chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        words += ": ";
        words += &error.to_string();
        cause = error.source();
    }
    words
}
