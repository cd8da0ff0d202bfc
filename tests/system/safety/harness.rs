//! The campaign's thread on the virtual rig's wires, with a journal that obeys the test. What the
//! rig truly did is asked at its control socket; what the service knows is its status.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::campaign::bench::interlock::TripKind;
use palpate::campaign::bench::rig_state::RigState;
use palpate::campaign::run::engine;
use palpate::campaign::run::job::{Beginning, Job};
use palpate::campaign::shown::command::{Handle, Refusal, Request};
use palpate::campaign::shown::safe_end::Tips;
use palpate::campaign::shown::status::{Phase, Status};
use palpate::ids::RunUid;
use palpate::rig::config::RigConfig;
use palpate::schedule::experiment::Experiment;
use palpate::schedule::plan::Plan;
use serde_json::{Value, json};
use sim_core::sensor::Sensor;
use virtual_rig::run::{RigArgs, VirtualRig};

use super::journal::Scripted;
use crate::bench::{self, LIMIT, WAITS, WHOLE, rig_args};
use palpate::state::StoredState;

/// Process seconds in a wall second: each fault is over in seconds, and this computer's lateness,
/// 5 ms of the wall, is 40 ms of the rig.
pub const SPEED: f64 = 8.0;

/// One tip setting of three configurations, down to 5 mm.
pub fn experiment(tips: u8, more: &str) -> String {
    format!(
        "name = 'safety'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [{tips}]\nconfigurations = 3\n\
         depths = 6\ndepth_step_mm = 1.0\nblock = 3\nreference_every = 0\n\
         [measure]\nsettle_ms = 400.0\n{more}"
    )
}

/// A trial waits to be durable.
pub fn committing(status: &Status) -> bool {
    status.run.as_ref().is_some_and(|run| run.phase == Phase::Commit)
}

pub fn no_axis_moves(truth: &Value) {
    for axis in truth["axes"].as_array().unwrap() {
        assert_eq!(axis["moving"], false, "{axis}");
    }
}

/// Everything of one test.
pub struct Harness {
    /// Switched on.
    pub rig: VirtualRig,
    pub handle: Handle,
    pub journal: Arc<Scripted>,
    pub config: RigConfig,
    thread: std::thread::JoinHandle<()>,
    _turn: bench::Turn,
}

impl Harness {
    /// Switches everything on, connects and homes.
    pub async fn homed() -> Self {
        Self::homed_on(&rig_args("virtual", SPEED)).await
    }

    /// As `homed`, for a test that measures how soon a rig stops, or how far it presses meanwhile.
    pub async fn homed_alone() -> Self {
        Self::homed_with(&rig_args("virtual", SPEED), WHOLE).await
    }

    /// As `homed`, on another rig.
    pub async fn homed_on(args: &RigArgs) -> Self {
        Self::homed_with(args, WAITS).await
    }

    async fn homed_with(args: &RigArgs, share: u32) -> Self {
        let turn = bench::turn(share).await;
        let rig = VirtualRig::switch_on(args).await.unwrap();
        let config = RigConfig::from_toml("served.toml", &rig.rig_text).unwrap();
        let journal = Arc::new(Scripted::default());
        let (handle, thread) = engine::spawn(config.clone().into(), journal.clone()).unwrap();
        let harness = Self { rig, handle, journal, config, thread, _turn: turn };
        harness.ask(Request::Connect).await.unwrap();
        harness.home().await;
        harness
    }

    /// A homed rig on which `n` trials of an experiment with two tips are stored.
    pub async fn running(n: u64) -> Self {
        let harness = Self::homed().await;
        harness.run(2, "").await;
        harness.stored(n).await;
        harness
    }

    /// As `running`, once the rig's tips truly press again.
    pub async fn pressing(n: u64) -> Self {
        let harness = Self::running(n).await;
        let start = Instant::now();
        while harness.truth().await["pressing"] != true {
            assert!(start.elapsed() < LIMIT, "nothing presses: {:#?}", harness.handle.status());
        }
        harness
    }

    /// Resets a trip, and homes.
    pub async fn reset_and_home(&self) {
        self.ask(Request::Reset).await.unwrap();
        self.home().await;
    }

    /// Resumes the run, which must reach its end.
    pub async fn resume_to_the_end(&self) {
        self.ask(Request::Resume).await.unwrap();
        self.until("the end", |s| s.run.is_none()).await;
    }

    /// Resets a trip that left the run to a person, and resumes it to its end: its 18 trials are stored, each once.
    pub async fn recovers(&self) {
        self.ask(Request::Reset).await.unwrap();
        self.run_is(StoredState::Paused).await;
        self.home().await;
        self.resume_to_the_end().await;
        let taken = self.journal.taken();
        let distinct: BTreeSet<_> = taken.trials.iter().map(|t| t.key).collect();
        assert_eq!((taken.trials.len(), distinct.len()), (18, 18));
        assert_eq!(taken.ends[0].0.as_str(), "success", "{:?}", taken.ends);
    }

    /// Homes, and waits for it.
    pub async fn home(&self) {
        self.ask(Request::Home).await.unwrap();
        self.until("homed", |s| s.rig.state == RigState::Homed).await;
    }

    /// Asks the campaign for something.
    pub async fn ask(&self, request: Request) -> Result<(), Refusal> {
        self.handle.ask(request).await
    }

    /// Mounts tips and says so; `powered` cells stay on their cables.
    pub async fn mount(&self, tips: u8, powered: u8) {
        self.tell(json!({ "cmd": "mount", "tips": tips, "powered": powered })).await;
        // The module's next conversion shows it.
        tokio::time::sleep(Duration::from_millis(50)).await;
        self.ask(Request::Mounted { tips, who: "test".into() }).await.unwrap();
    }

    /// A job of the experiment, changed by hand.
    pub fn job(&self, definition: &str, change: impl FnOnce(&mut Job)) -> Job {
        let experiment = Experiment::from_toml("test.toml", definition).unwrap();
        let sensor = Sensor::from_toml(bench::SENSOR).unwrap();
        let plan = Plan::of("test.toml", &experiment, &sensor).unwrap();
        let mut job = Job {
            run: RunUid::new(),
            scan_id: 1,
            plan,
            predicted_trial_s: 1.0,
            auto_resume: false,
            has_waited: false,
            beginning: Beginning::OfPerson,
            bytes_per_trial: 4000,
        };
        change(&mut job);
        job
    }

    /// Mounts tips and starts the experiment.
    pub async fn run(&self, tips: u8, more: &str) {
        self.mount(tips, tips).await;
        self.start(self.job(&experiment(tips, more), |_| {})).await;
    }

    /// Starts an experiment of two tips that resumes automatically a second after a trip that passes; waits for a
    /// trial.
    pub async fn run_that_resumes(&self, policy: &str) {
        self.mount(2, 2).await;
        let definition = experiment(2, &format!("[policy]\nauto_resume_after_s = 1.0\n{policy}"));
        self.start(self.job(&definition, |job| job.auto_resume = true)).await;
        self.stored(1).await;
    }

    /// Starts the experiment without mounting tips.
    pub async fn start_unmounted(&self, tips: u8) {
        self.start(self.job(&experiment(tips, ""), |_| {})).await;
    }

    pub async fn start(&self, job: Job) {
        self.ask(Request::Start(Arc::new(job))).await.unwrap();
    }

    /// Waits for the status to satisfy this.
    pub async fn until(&self, what: &str, done: impl Fn(&Status) -> bool) -> Status {
        let start = Instant::now();
        loop {
            let status = self.handle.status();
            if done(&status) {
                return status;
            }
            assert!(start.elapsed() < LIMIT, "{what} does not come: {status:#?}");
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }

    /// Waits until `n` trials are stored.
    pub async fn stored(&self, n: u64) {
        self.until("trials", |s| s.run.as_ref().is_some_and(|r| r.trials_stored >= n)).await;
    }

    /// Number of trials that the journal took.
    pub fn taken_trials(&self) -> u64 {
        self.journal.taken().trials.len() as u64
    }

    /// Waits until another trial is stored.
    pub async fn stores_another(&self) {
        self.stored(self.taken_trials() + 1).await;
    }

    /// Waits until the run is in this state.
    pub async fn run_is(&self, state: StoredState) {
        let is = |s: &Status| s.run.as_ref().is_some_and(|r| r.state == state);
        self.until(state.as_str(), is).await;
    }

    /// Waits until each of the axes has stopped after an e-stop.
    pub async fn every_axis_stands(&self) {
        let stand = |s: &Status| {
            let stops = &s.rig.estop_stops;
            stops.len() == 4 && stops.iter().all(|stop| stop.stood_ms.is_some())
        };
        self.until("every axis stands", stand).await;
    }

    /// Nothing is stored for this long, and the rig is still tripped afterwards; returns the status then.
    pub async fn stays_tripped(&self, seconds: u64) -> Status {
        let stored = self.taken_trials();
        tokio::time::sleep(Duration::from_secs(seconds)).await;
        let status = self.handle.status();
        assert_eq!(status.rig.state, RigState::Tripped, "{:#?}", status.rig);
        assert_eq!(self.taken_trials(), stored);
        status
    }

    /// Waits for a trip and for its safe end.
    pub async fn tripped(&self) -> Status {
        let ended = |s: &Status| s.rig.state == RigState::Tripped && s.rig.safe_end.is_some();
        let status = self.until("a trip", ended).await;
        // Of the run, the state that follows.
        self.until("a halt", |s| s.run.as_ref().is_none_or(|r| r.state != StoredState::Running))
            .await;
        status
    }

    /// As `tripped`, by this kind and in these words, and safe.
    pub async fn tripped_by(&self, kind: TripKind, words: &str) -> Status {
        let status = self.tripped().await;
        let trip = status.rig.trip.as_ref().expect("a trip");
        assert_eq!(trip.kind, kind, "{trip:?}");
        assert!(trip.detail.contains(words), "{trip:?}");
        self.is_safe().await;
        status
    }

    /// Trips the rig by wires of the cells that fail for this long.
    pub async fn tripped_by_its_wires(&self, for_s: f64) {
        self.fault("no_reply", "cells", json!({ "for_s": for_s })).await;
        let trip = self.tripped().await.rig.trip.unwrap();
        assert_eq!(trip.kind, TripKind::Wire, "{trip:?}");
    }

    /// Sends a line to the control socket.
    pub async fn tell(&self, command: Value) -> Value {
        bench::tell(&self.rig, command).await
    }

    /// A fault that begins at once.
    pub async fn fault(&self, kind: &str, device: &str, more: Value) {
        self.tell(bench::fault(kind, device, more)).await;
    }

    /// What the bench truly does.
    pub async fn truth(&self) -> Value {
        self.tell(json!({ "cmd": "status" })).await
    }

    /// The tips are up and nothing moves, in truth and in the status; no axis ever moved sideways
    /// in contact.
    pub async fn is_safe(&self) {
        let status = self.handle.status();
        let end = status.rig.safe_end.clone().expect("a safe end");
        assert_eq!(end.tips, Tips::Raised, "{end:#?}");
        assert!(end.is_stopped() && end.stops.iter().all(|s| s.stood_ms.is_some()), "{end:#?}");
        let mut truth = self.truth().await;
        // An axis that has reached its target settles for some wall milliseconds more.
        let settled = Instant::now() + Duration::from_millis(200);
        let moves = |truth: &Value| {
            truth["axes"].as_array().unwrap().iter().any(|axis| axis["moving"] == true)
        };
        while moves(&truth) && Instant::now() < settled {
            tokio::time::sleep(Duration::from_millis(5)).await;
            truth = self.truth().await;
        }
        assert_eq!(truth["pressing"], false, "{truth:#}");
        assert_eq!(truth["lateral_in_contact"], 0, "{truth:#}");
        no_axis_moves(&truth);
        let z = truth["axes"][2]["position"].as_f64().unwrap();
        assert!(z < truth["surface_z_mm"].as_f64().unwrap() - 1.0, "{truth:#}");
    }

    /// The diary, once written, tells the state that the trip leads to, the trip, the safe end after it, and the
    /// failed attempt after all of them: a process that dies in the safe end leaves no run that resumes by itself.
    pub async fn diary_tells(&self, trip: &str) {
        let kinds = ["run suspending", "trip", "safe_end", "attempt_failed"];
        let start = Instant::now();
        loop {
            let found: Vec<usize> = {
                let taken = self.journal.taken();
                kinds.iter().filter_map(|k| taken.order.iter().rposition(|o| o == k)).collect()
            };
            if found.len() == kinds.len() {
                assert!(found.is_sorted(), "{:?}", self.journal.taken().order);
                break;
            }
            assert!(start.elapsed() < LIMIT, "{:?}", self.journal.taken().order);
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let taken = self.journal.taken();
        let (_, data, _) = taken.events.iter().find(|e| e.0 == "trip").unwrap();
        assert_eq!(data["kind"], trip, "{data}");
        assert_eq!(taken.events.iter().filter(|e| e.0 == "trip").count(), 1, "{:?}", taken.events);
    }

    /// Aborts the run and ends the thread.
    pub async fn abort_and_close(self) {
        self.ask(Request::Abort).await.unwrap();
        self.close().await;
    }

    /// Ends the thread; the diary is written to its end.
    pub async fn close(self) {
        self.journal.set(super::journal::Mood::Sound);
        let _ = self.ask(Request::Shutdown).await;
        let thread = self.thread;
        tokio::task::spawn_blocking(move || thread.join()).await.unwrap().unwrap();
    }
}
