//! The frames of a trial: nothing is stored of them if the computer was suspended as they were taken, no request waits
//! for them, and a trial whose weights move under them is flagged.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use tokio::sync::broadcast;
use tokio::time::Instant;

use super::super::Attempts;
use super::{begin, engine, job, parts, surface, suspensions, tripped, with_handle};
use crate::campaign::bench::interlock::TripKind;
use crate::campaign::bench::stand_in::{frame, soon};
use crate::campaign::run::control::Control;
use crate::campaign::run::eta::Pace;
use crate::campaign::run::halt::Halt;
use crate::campaign::run::job::Job;
use crate::campaign::run::run_state::{PausedWhy, RunState};
use crate::campaign::shown::command::Request;
use crate::campaign::shown::placement::Confirmation;
use crate::campaign::shown::status::{Phase, Status};
use crate::campaign::trial::manual::{self, Confirmed};
use crate::campaign::trial::press::Pressing;
use crate::clock::Clock;
use crate::record::Flag;
use crate::rig::error::RigError;
use crate::rig::traits::{Frame, SkinReader, StreamCounters};
use crate::schedule::experiment::Measure;
use crate::schedule::manual::{PlannedContact, PlannedPlacement};
use crate::schedule::plan::{Kind, Step};

/// A skin whose computer is suspended as the frame of a trial is taken, or which never sends that frame.
struct Late {
    skin: Arc<dyn SkinReader>,
    /// Seconds for which the computer was suspended; none if the frame does not come.
    suspended_s: Option<Arc<AtomicU64>>,
}

#[async_trait]
impl SkinReader for Late {
    fn latest(&self) -> Option<Arc<Frame>> {
        self.skin.latest()
    }

    fn follow(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.skin.follow()
    }

    fn counters(&self) -> StreamCounters {
        self.skin.counters()
    }

    async fn take(&self, not_before: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError> {
        // Not in the windows in which it settles, nor those of a tare.
        if count == 1 {
            match &self.suspended_s {
                Some(suspended_s) => suspended_s.store(3600, Ordering::SeqCst),
                None => std::future::pending().await,
            }
        }
        self.skin.take(not_before, count).await
    }
}

/// Measures a placement.
async fn placed(skin: Arc<dyn SkinReader>, control: &mut Control, job: &Job) -> Result<(), Halt> {
    let measure = Measure { settle_ms: 0.0, ..Measure::default() };
    let placement = PlannedPlacement { index: 0, contacts: Vec::new() };
    let confirmation = Confirmation::of("ada".into());
    let confirmed = Confirmed { run: job.run, confirmation, measure: &measure, attempt: 1 };
    manual::measure(&skin, &Clock::new(1.0), control, confirmed, &placement).await
}

#[tokio::test]
async fn nothing_is_stored_of_weights_under_which_the_computer_was_suspended() {
    let (job, (_, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    let suspended_s = Some(suspensions(&mut engine));
    let skin = engine.connection.as_ref().map(|open| open.skin.clone()).expect("open wires");
    let late = Arc::new(Late { skin, suspended_s });
    let measured = placed(late, &mut engine.control, &job).await;
    assert!(matches!(measured, Err(Halt::Trip(_))), "{measured:?}");
}

#[tokio::test]
async fn nothing_is_stored_of_weights_under_which_the_stream_was_opened_again() {
    let (job, (axes, mut engine)) = (job(), engine());
    begin(&mut engine, &job);
    *axes.skin.takes.lock() = Duration::from_millis(50);
    let skin: Arc<dyn SkinReader> = axes.skin.clone();
    let again = async { *axes.skin.since.lock() = Some(jiff::Timestamp::UNIX_EPOCH) };
    // In this order: the frames are awaited before it is opened again.
    let (measured, ()) = futures::join!(placed(skin, &mut engine.control, &job), again);
    let Err(Halt::Failed(words)) = &measured else { panic!("{measured:?}") };
    assert!(words.contains("opened again"), "{words}");
}

#[tokio::test]
async fn nothing_is_stored_of_a_reference_press_under_which_the_computer_was_suspended() {
    let (mut job, (axes, mut engine)) = (job(), engine());
    job.plan.measure.settle_ms = 0.0;
    begin(&mut engine, &job);
    let suspended_s = Some(suspensions(&mut engine));
    let (stage, control) = parts(&mut engine);
    stage.bench.skin = Arc::new(Late { skin: stage.bench.skin.clone(), suspended_s });
    (stage.tips, stage.surface) = (1, Some(surface()));
    stage.config.limits.frame_age_ms = 60_000;
    stage.config.limits.sample_age_ms = Some(60_000);
    let press = job.plan.steps.iter().find_map(|step| match step {
        Step::Reference(press) => Some(press),
        _ => None,
    });
    let pressing = Pressing { run: job.run, plan: &job.plan, attempt: 1 };
    let pressed = pressing.reference(stage, control, press.expect("a reference")).await;
    tripped(pressed, TripKind::Service);
    engine.control.flush().await.unwrap();
    let events = axes.journal.events.lock().clone();
    assert!(!events.iter().any(|kind| kind == "reference"), "{events:?}");
}

#[tokio::test]
async fn the_event_of_a_reference_press_has_the_flags_that_its_trial_would_have() {
    for settle_n in [f64::INFINITY, -1.0] {
        let (mut job, (axes, mut engine)) = (job(), engine());
        let measure = &mut job.plan.measure;
        (measure.settle_ms, measure.settle_max_ms, measure.settle_n) = (0.0, 0.0, settle_n);
        begin(&mut engine, &job);
        let (stage, control) = parts(&mut engine);
        (stage.tips, stage.surface) = (1, Some(surface()));
        stage.config.limits.frame_age_ms = 60_000;
        stage.config.limits.sample_age_ms = Some(60_000);
        let press = job.plan.steps.iter().find_map(|step| match step {
            Step::Reference(press) => Some(press),
            _ => None,
        });
        let pressing = Pressing { run: job.run, plan: &job.plan, attempt: 1 };
        pressing.reference(stage, control, press.expect("a reference")).await.unwrap();
        engine.control.flush().await.unwrap();
        let of_kind = axes.journal.events.lock().iter().position(|kind| kind == "reference");
        let told = axes.journal.told.lock()[of_kind.expect("its event")].to_string();
        assert_eq!(told.contains("unsettled"), settle_n < 0.0, "{told}");
    }
}

#[tokio::test]
async fn a_pause_of_a_placement_does_not_wait_for_its_frames() {
    let (job, (_, mut engine, handle)) = (job(), with_handle());
    begin(&mut engine, &job);
    let skin = engine.connection.as_ref().map(|open| open.skin.clone()).expect("open wires");
    let late = Arc::new(Late { skin, suspended_s: None });
    let mut status = handle.watch_status();
    let pause = async {
        let is_measured =
            |now: &Status| now.run.as_ref().is_some_and(|run| run.phase == Phase::Measure);
        drop(status.wait_for(is_measured).await.unwrap());
        handle.ask(Request::PauseNow).await
    };
    let both = async { tokio::join!(placed(late, &mut engine.control, &job), pause) };
    let (measured, paused) = soon(both).await;
    assert!(matches!(measured, Err(Halt::Asked)) && paused.is_ok(), "{measured:?} {paused:?}");
    assert_eq!(engine.control.run(), RunState::Suspending(PausedWhy::Operator));
}

/// Frames of a trial that is long enough to show a change.
const MEASURED_FRAMES: u32 = 30;

/// A skin that is at rest before the frames of a trial are taken, and changes by this number of counts after half of
/// them.
struct Moving {
    skin: Arc<dyn SkinReader>,
    change: i16,
}

#[async_trait]
impl SkinReader for Moving {
    fn latest(&self) -> Option<Arc<Frame>> {
        self.skin.latest()
    }

    fn follow(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.skin.follow()
    }

    fn counters(&self) -> StreamCounters {
        self.skin.counters()
    }

    async fn take(&self, not_before: Instant, count: usize) -> Result<Vec<Arc<Frame>>, RigError> {
        if count < MEASURED_FRAMES as usize {
            return self.skin.take(not_before, count).await;
        }
        let one = |sequence: u32| {
            let change = if sequence > MEASURED_FRAMES / 2 { self.change } else { 0 };
            // The voltages of an injection sum to zero.
            let counts = (0..784).map(|c| if c % 2 == 0 { change } else { -change });
            frame(sequence, counts.collect())
        };
        Ok((1..).take(count).map(one).collect())
    }
}

/// Flags of the trials that the journal receives of a run of one placement, which a person has confirmed.
async fn flags_of_a_placement(change: i16) -> Vec<Vec<Flag>> {
    let (mut job, (axes, mut engine)) = (job(), engine());
    let contacts = vec![PlannedContact { x_mm: 100.0, y_mm: 80.0, force_n: 4.905 }];
    job.plan.steps = vec![Step::Manual(PlannedPlacement { index: 0, contacts })];
    job.plan.measure =
        Measure { frames_per_trial: MEASURED_FRAMES, settle_ms: 0.0, ..Measure::default() };
    (job.plan.kind, job.plan.depths_mm) = (Kind::RealRandom, Vec::new());
    begin(&mut engine, &job);
    let open = engine.connection.as_mut().expect("open wires");
    open.skin = Arc::new(Moving { skin: open.skin.clone(), change });
    let confirmed = Some((0, Confirmation::of("ada".into())));
    let mut attempts = Attempts { confirmed, ..Attempts::default() };
    let advanced = engine.advance(&job, &mut Pace::predicted(1.0), &mut attempts).await;
    assert!(matches!(advanced, Ok(None)), "{advanced:?}");
    axes.journal.flags.lock().clone()
}

#[tokio::test]
async fn a_placement_whose_signal_changes_while_it_is_measured_is_stored_as_unsettled() {
    for (change, flags) in [(0, Vec::new()), (4, vec![Flag::Unsettled])] {
        assert_eq!(flags_of_a_placement(change).await, [flags], "{change} mV");
    }
}
