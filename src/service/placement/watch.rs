//! Follows the frames while a run waits for a placement, and keeps the verdict on it.
//! Uses: `campaign` (status, frames), `infer::serving`, `store` (the run's sensor), `placement::verdict`.
//! Never: a request to the campaign, a wait of the campaign for an inference.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sim_core::sensor::Sensor;
use tokio::sync::watch;
use tokio::time::{Instant, timeout};
use utoipa::ToSchema;

use super::calm::{Calm, Mean};
use super::verdict::{AskedContact, Verdict, judge};
use crate::campaign::run::run_state::PausedWhy;
use crate::campaign::shown::command::Handle;
use crate::campaign::shown::placement::VerdictKind;
use crate::campaign::shown::status::{Status, Wanted};
use crate::dataset::background::background;
use crate::ids::RunUid;
use crate::infer::answer::FoundContact;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::{Frames, Method};
use crate::infer::serving::Serving;
use crate::infer::untouched::Tared;
use crate::infer::untouched_frame::UntouchedBefore;
use crate::journal::error_chain;
use crate::record::PlacedContact;
use crate::store::Store;

/// Shortest time between two inferences without a confirmation, wall: `exact` takes a tenth of it.
const EVERY: Duration = Duration::from_millis(500);
/// Time after a confirmation at which the frames are judged even if the skin is not at rest, wall.
const PATIENCE: Duration = Duration::from_millis(2500);
/// Longest wait of a confirmation for its verdict, wall: reached on an overloaded machine only.
const VERDICT_WITHIN: Duration = Duration::from_secs(8);
/// Reason of a verdict if no method serves.
const NOBODY_SERVES: &str = "no model serves: the placement is not judged";
/// Reason of a verdict before the first frames.
const NOT_READ: &str = "the skin was not read yet";

/// A placement that a run waits for.
#[derive(Debug, Clone, PartialEq)]
pub struct Awaited {
    /// Uid of the run that waits.
    pub run: RunUid,
    /// Index of the placement.
    pub trial: u32,
    /// Requested position and force of each weight, mm and N.
    pub contacts: Vec<PlacedContact>,
}

impl Awaited {
    /// Reads it from the status; `None` if no run waits for a placement.
    pub fn of(status: &Status) -> Option<Self> {
        let run = status.run.as_ref()?;
        let waits = run.paused_why == Some(PausedWhy::ManualTrial);
        match run.wanted.as_ref().filter(|_| waits)? {
            Wanted::Placement { trial, contacts } => {
                Some(Self { run: run.uid, trial: *trial, contacts: contacts.clone() })
            }
            Wanted::Tips { .. } => None,
        }
    }
}

/// What a method feels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Felt {
    /// Method that was used.
    pub method: Method,
    /// Id of the model, or ids joined by `+`.
    pub model: String,
    /// The contacts, strongest first.
    pub contacts: Vec<FoundContact>,
}

/// A placement as it is judged now.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// Uid of the run that waits.
    pub run: RunUid,
    /// Index of the placement.
    pub trial: u32,
    /// The weights with the names of their points.
    pub asked: Vec<AskedContact>,
    /// Whether the skin is at rest; `None` before two windows of frames.
    pub at_rest: Option<bool>,
    /// What is felt; `None` before the first inference.
    pub felt: Option<Felt>,
    /// Verdict on the newest frames, with its reasons.
    pub verdict: Verdict,
    /// Verdict of the last inference; `None` before the first.
    inferred: Option<Verdict>,
    /// Time at which the first frame of the verdict arrived; `None` if it needed no frame.
    since: Option<Instant>,
}

impl Judged {
    /// A placement whose frames were not read yet.
    pub fn unread(awaited: &Awaited) -> Self {
        Self::new(awaited, None, Verdict::without(VerdictKind::Unsure, NOT_READ))
    }

    fn new(awaited: &Awaited, sensor: Option<&Sensor>, verdict: Verdict) -> Self {
        Self {
            run: awaited.run,
            trial: awaited.trial,
            asked: AskedContact::all(&awaited.contacts, sensor),
            at_rest: None,
            felt: None,
            verdict,
            inferred: None,
            since: None,
        }
    }

    /// Verdict on a confirmation if the skin was not judged again within `limit`: what it contradicted when it was last
    /// judged is still contradicted.
    fn without_answer(&self, limit: Duration) -> Verdict {
        let limit_s = limit.as_secs();
        match self.inferred.clone().filter(|last| last.kind == VerdictKind::Wrong) {
            Some(mut wrong) => {
                wrong.words.push(format!("the skin was not judged again within {limit_s} s"));
                wrong
            }
            None => {
                let why = format!("the skin was not judged within {limit_s} s: check its frames");
                Verdict::without(VerdictKind::Unsure, why)
            }
        }
    }
}

/// The watch of one rig. Clones share it.
#[derive(Clone)]
pub struct PlacementWatch {
    inner: Arc<Inner>,
}

struct Inner {
    campaign: Handle,
    serving: Serving,
    store: Store,
    judged: watch::Sender<Option<Judged>>,
    /// Time of a confirmation that waits for its verdict.
    demand: watch::Sender<Option<Instant>>,
}

impl PlacementWatch {
    /// Creates the watch; [`Self::work`] keeps it.
    pub fn new(campaign: Handle, serving: Serving, store: Store) -> Self {
        let (judged, demand) = (watch::Sender::new(None), watch::Sender::new(None));
        Self { inner: Arc::new(Inner { campaign, serving, store, judged, demand }) }
    }

    /// The placement that is, or was last, awaited; `None` before the first.
    pub fn judged(&self) -> Option<Judged> {
        self.inner.judged.borrow().clone()
    }

    /// Judges an awaited placement from frames that arrive from now on. If that takes too long, `Wrong` where the last
    /// verdict was, otherwise `Unsure`; `Unknown` if no method serves.
    pub async fn judge_now(&self, run: RunUid, trial: u32) -> Verdict {
        if self.inner.serving.current().best().is_none() {
            return Verdict::without(VerdictKind::Unknown, NOBODY_SERVES);
        }
        self.next_verdict(run, trial, VERDICT_WITHIN).await
    }

    /// The verdict on frames that arrive from now on, awaited for `limit`.
    async fn next_verdict(&self, run: RunUid, trial: u32, limit: Duration) -> Verdict {
        let mut judged = self.inner.judged.subscribe();
        // A second confirmation waits for the verdict of the first: it must not delay it.
        let mut from = Instant::now();
        self.inner.demand.send_if_modified(|demand| match demand {
            Some(earlier) => {
                from = *earlier;
                false
            }
            none => {
                *none = Some(from);
                true
            }
        });
        let is_asked = |judged: &Judged| judged.run == run && judged.trial == trial;
        let is_judged = |judged: &Option<Judged>| {
            let judged = judged.as_ref().filter(|judged| is_asked(judged));
            judged.is_some_and(|j| j.since.is_some_and(|since| since >= from))
        };
        let found = timeout(limit, judged.wait_for(is_judged)).await;
        let found = found.ok().and_then(Result::ok).and_then(|judged| judged.clone());
        self.inner.demand.send_if_modified(|demand| demand.take_if(|d| *d == from).is_some());
        match (found, self.judged().filter(is_asked)) {
            (Some(judged), _) => judged.verdict,
            (None, Some(last)) => last.without_answer(limit),
            (None, None) => Verdict::without(VerdictKind::Unsure, NOT_READ),
        }
    }

    /// The untouched skin that was measured last in a run.
    async fn untouched(&self, run: RunUid) -> Option<UntouchedBefore> {
        let skin = self.inner.campaign.untouched().filter(|skin| skin.run == Some(run))?;
        let tared = Tared::of_run(&self.inner.store, run).await;
        let tared = tared.inspect_err(|error| {
            tracing::warn!(error = error_chain(error), "the untouched skin of a run is unknown");
        });
        let wall_s = Timestamp::now().duration_since(skin.at).as_secs_f64();
        Some(tared.ok()?.before(&skin, wall_s))
    }

    /// Follows every placement until the campaign's thread ends.
    pub async fn work(self) {
        let mut status = self.inner.campaign.watch_status();
        loop {
            let awaited = Awaited::of(&status.borrow_and_update());
            match awaited {
                Some(awaited) => self.follow(&awaited, &mut status).await,
                None if status.changed().await.is_err() => return,
                None => {}
            }
        }
    }

    /// The sensor of a run; `None` if its text cannot be read.
    async fn sensor_of(&self, run: RunUid) -> Option<Arc<Sensor>> {
        let row = self.inner.store.run(run).await;
        let row = row.inspect_err(|error| {
            tracing::warn!(error = error_chain(error), "the sensor of a placement is unknown");
        });
        Sensor::from_toml(&row.ok()??.sensor).ok().map(Arc::new)
    }

    /// Follows the frames of one placement while it is awaited.
    async fn follow(&self, awaited: &Awaited, status: &mut watch::Receiver<Status>) {
        let sensor = self.sensor_of(awaited.run).await;
        let mut follower = Follower::of(self, awaited, sensor);
        follower.publish();
        let mut frames = self.inner.campaign.watch_frames();
        let mut demand = self.inner.demand.subscribe();
        // A frame from before the request shows the skin before the weights were lifted.
        frames.borrow_and_update();
        loop {
            tokio::select! {
                changed = status.changed() => {
                    let goes_on = changed.is_ok()
                        && Awaited::of(&status.borrow_and_update()).as_ref() == Some(awaited);
                    if !goes_on {
                        return;
                    }
                }
                changed = demand.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    if demand.borrow_and_update().is_some() {
                        // Only frames from now on.
                        follower.calm = Calm::default();
                    }
                }
                changed = frames.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    let frame = frames.borrow_and_update().clone();
                    if let Some(at_rest) = frame.and_then(|frame| follower.calm.push(frame)) {
                        follower.window(at_rest).await;
                    }
                }
            }
        }
    }
}

/// The work on one placement.
struct Follower<'a> {
    watch: &'a PlacementWatch,
    sensor: Option<Arc<Sensor>>,
    calm: Calm,
    judged: Judged,
    /// Time of the last inference.
    inferred: Option<Instant>,
}

impl<'a> Follower<'a> {
    fn of(watch: &'a PlacementWatch, awaited: &Awaited, sensor: Option<Arc<Sensor>>) -> Self {
        let verdict = match watch.inner.serving.current().best() {
            Some(_) => Verdict::without(VerdictKind::Unsure, NOT_READ),
            None => Verdict::without(VerdictKind::Unknown, NOBODY_SERVES),
        };
        let judged = Judged::new(awaited, sensor.as_deref(), verdict);
        Self { watch, sensor, calm: Calm::default(), judged, inferred: None }
    }

    fn publish(&self) {
        self.watch.inner.judged.send_replace(Some(self.judged.clone()));
    }

    /// A window of frames is complete.
    async fn window(&mut self, at_rest: bool) {
        let demand = *self.watch.inner.demand.borrow();
        let best = self.watch.inner.serving.current().best();
        self.judged.at_rest = Some(at_rest);
        match (best, self.calm.mean()) {
            (Some(method), Some(mean)) => {
                let asked = demand.map(|at| at.elapsed());
                let last = self.inferred.map(|at| at.elapsed());
                if is_due(at_rest, asked, last) {
                    self.infer(method, mean, at_rest).await;
                } else if !at_rest {
                    self.judged.verdict =
                        Verdict::without(VerdictKind::Unsure, "the skin is not at rest");
                    self.judged.since = None;
                }
            }
            _ => {
                self.judged.felt = None;
                self.judged.verdict = Verdict::without(VerdictKind::Unknown, NOBODY_SERVES);
            }
        }
        self.publish();
    }

    async fn infer(&mut self, method: Method, mean: Mean, at_rest: bool) {
        self.inferred = Some(Instant::now());
        let pipeline = self.watch.inner.serving.current();
        let Mean { volts, frames, since } = mean;
        let untouched = self.watch.untouched(self.judged.run).await;
        let work = move || {
            let untouched = untouched.as_ref();
            let frames = Frames { voltages_v: &volts, averaged: frames, untouched };
            pipeline.answer(method, &frames, ForceMaps::Without)
        };
        let answered = match background(work).await {
            Ok(Ok(answered)) => answered,
            Ok(Err(error)) => return self.fail(since, &error_chain(&error)),
            Err(error) => return self.fail(since, &error_chain(&error)),
        };
        let Some(reading) = answered.readings.into_iter().next() else { return };
        let judged = &mut self.judged;
        judged.verdict = judge(&judged.asked, &reading, at_rest, self.sensor.as_deref());
        judged.inferred = Some(judged.verdict.clone());
        judged.felt = Some(Felt { method, model: answered.model, contacts: reading.contacts });
        judged.since = Some(since);
    }

    fn fail(&mut self, since: Instant, why: &str) {
        self.judged.felt = None;
        self.judged.verdict = Verdict::without(VerdictKind::Unsure, why);
        self.judged.since = Some(since);
    }
}

/// Whether a window is followed by an inference. `asked`: time since a confirmation that waits for its
/// verdict; `last`: time since the last inference.
fn is_due(at_rest: bool, asked: Option<Duration>, last: Option<Duration>) -> bool {
    match asked {
        Some(asked) => at_rest || asked >= PATIENCE,
        None => at_rest && last.is_none_or(|last| last >= EVERY),
    }
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;
    use crate::campaign::bench::estop::StopSwitch;
    use crate::campaign::shown::command::channel;
    use crate::campaign::shown::show;
    use crate::clock::Clock;
    use crate::infer::answer::Reading;
    use crate::infer::registry::Registry;
    use crate::rig::setup::RigSetup;

    /// A watch whose readings are those of the test.
    async fn scripted() -> (PlacementWatch, TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let (data, clock) = (folder.path(), Clock::new(1.0));
        let store = Store::open(&data.join("palpate.db"), clock.clone()).await.unwrap();
        let text = include_str!("../../../experiments/rigs/virtual.toml");
        let setup = RigSetup::from_toml("virtual.toml", text).unwrap();
        let (campaign, _) = channel(StopSwitch::default(), show::closed(&setup));
        let text = include_str!("../../../experiments/sensors/ert-28.toml");
        let (sensor, models) =
            (Sensor::from_toml(text), Registry::open(store.clone(), data, clock));
        let serving =
            Serving::new(store.clone(), models.unwrap(), sensor.unwrap(), text.into(), data);
        (PlacementWatch::new(campaign, serving, store), folder)
    }

    #[tokio::test]
    async fn a_second_confirmation_is_answered_by_frames_after_it() {
        let (watch, _folder) = scripted().await;
        let contacts = vec![PlacedContact { x_mm: 100.0, y_mm: 80.0, force_n: 4.905 }];
        let awaited = Awaited { run: RunUid::new(), trial: 3, contacts };
        let publish = |x_mm: f64, since: Instant| {
            let felt = FoundContact { x_mm, y_mm: 80.0, force_n: Some(4.9), ..Default::default() };
            let reading = Reading { contacts: vec![felt], ..Reading::default() };
            let mut judged = Judged::unread(&awaited);
            judged.verdict = judge(&judged.asked, &reading, true, None);
            judged.since = Some(since);
            watch.inner.judged.send_replace(Some(judged));
        };
        let mut kinds = Vec::new();
        // The weight is on another point, and then where it was asked; each time the skin showed the opposite before.
        for (before_mm, now_mm) in [(100.0, 160.0), (160.0, 100.0)] {
            let before = Instant::now();
            let follow = async {
                let mut demand = watch.inner.demand.subscribe();
                drop(demand.wait_for(Option::is_some).await.unwrap());
                publish(before_mm, before);
                tokio::task::yield_now().await;
                publish(now_mm, Instant::now());
            };
            // In this order at each turn: the confirmation reads what was before.
            let (verdict, ()) =
                tokio::join!(biased; watch.next_verdict(awaited.run, 3, VERDICT_WITHIN), follow);
            kinds.push(verdict.kind);
            assert_eq!(*watch.inner.demand.borrow(), None, "no person waits any more");
        }
        assert_eq!(kinds, [VerdictKind::Wrong, VerdictKind::Right]);
    }

    #[tokio::test]
    async fn without_an_answer_what_was_wrong_stays_wrong() {
        let (watch, _folder) = scripted().await;
        let contacts = vec![PlacedContact { x_mm: 100.0, y_mm: 80.0, force_n: 4.905 }];
        let awaited = Awaited { run: RunUid::new(), trial: 3, contacts };
        let verdict =
            async |trial| watch.next_verdict(awaited.run, trial, Duration::from_millis(10)).await;
        assert_eq!(verdict(3).await.kind, VerdictKind::Unsure, "no frame was read");
        let mut judged = Judged::unread(&awaited);
        for (last, kind) in
            [(VerdictKind::Wrong, VerdictKind::Wrong), (VerdictKind::Right, VerdictKind::Unsure)]
        {
            judged.inferred = Some(Verdict::without(last, "weight 1 is felt elsewhere"));
            // A hand came after it: the verdict that is shown is another.
            judged.verdict = Verdict::without(VerdictKind::Unsure, "the skin is not at rest");
            watch.inner.judged.send_replace(Some(judged.clone()));
            let without_answer = verdict(3).await;
            assert_eq!(without_answer.kind, kind, "{without_answer:?}");
            assert!(without_answer.words.concat().contains("within 0 s"), "{without_answer:?}");
            assert_eq!(verdict(4).await.kind, VerdictKind::Unsure, "another placement");
        }
    }

    #[test]
    fn a_confirmation_is_answered_at_once_at_rest_and_after_its_patience_anyway() {
        let (soon, late) = (Some(Duration::from_millis(10)), Some(PATIENCE));
        assert!(is_due(true, None, None) && is_due(true, None, Some(EVERY)));
        assert!(!is_due(true, None, soon), "not again at once");
        assert!(is_due(true, soon, soon), "a person waits");
        assert!(!is_due(false, soon, None) && is_due(false, late, None));
        assert!(!is_due(false, None, None), "no frame of a hand on the skin is read");
        assert!(VERDICT_WITHIN > PATIENCE + EVERY, "the forced inference has time");
    }
}
