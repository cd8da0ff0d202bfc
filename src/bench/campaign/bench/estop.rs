//! The software stop: one call, from any thread, that overtakes every queue of the wires and is
//! repeated until each axis has acknowledged it and stands.
//! Uses: tokio, `rig::traits`. Never: states, storage. It is not a certified emergency stop: that
//! is hardware which removes power. This stop only decelerates the axes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use futures::stream::FuturesUnordered;
use futures::{FutureExt, StreamExt};
use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::Instant;
use utoipa::ToSchema;

use crate::rig::link::StopLatch;
use crate::rig::traits::{Axis, AxisStatus, Bench};

/// Pause before a stop that was not acknowledged is sent again. Once the wire works again, the stop
/// is sent within this time.
const RESEND_PAUSE: Duration = Duration::from_millis(50);
/// Longest time from an acknowledged stop until the axis stands; then the stop is sent again.
const STANDS_WITHIN: Duration = Duration::from_secs(2);
/// Shortest time between two readings that show an axis at rest after its stop, also their pause.
pub(super) const STAND_PAUSE: Duration = Duration::from_millis(50);
/// Largest change of position between two readings of an axis at rest, in its unit.
const STAND_CHANGE: f64 = 0.025;

/// Result of the stop of one axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisStop {
    /// `x`, `y`, `z` or `radial`.
    pub axis: String,
    /// Time from the request of the stop to the acknowledgement of the axis, wall ms; absent while
    /// it is not acknowledged.
    pub acknowledged_ms: Option<f64>,
    /// Time from the request of the stop to the reading that found the axis at rest, wall ms; absent while it is
    /// not known to be at rest. In a safe end under an e-stop it is absent: the stops of the e-stop are read.
    pub stood_ms: Option<f64>,
    /// Why it is not acknowledged, or may still move; absent without a fault.
    pub error: Option<String>,
}

impl AxisStop {
    /// The stop of an axis that has not acknowledged it yet.
    pub fn of(axis: &str) -> Self {
        Self { axis: axis.into(), acknowledged_ms: None, stood_ms: None, error: None }
    }

    /// The time of the first press holds, unless a further one finds the axis silent.
    fn acknowledged(&mut self, after_ms: f64) {
        if self.acknowledged_ms.is_none() {
            (self.acknowledged_ms, self.error) = (Some(after_ms), None);
        }
    }

    pub(in crate::campaign) fn stood(&mut self, after_ms: f64) {
        self.stood_ms.get_or_insert(after_ms);
        self.error = None;
    }

    /// Whether the axis has acknowledged the stop and was not found moving after it.
    pub fn is_done(&self) -> bool {
        self.acknowledged_ms.is_some() && self.error.is_none()
    }
}

/// A latching stop button. All clones are the same button.
#[derive(Debug, Clone, Default)]
pub struct StopSwitch {
    inner: Arc<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    latch: StopLatch,
    /// Number of the newest press while it is latched; none while it is released.
    latched: watch::Sender<Option<u64>>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    press: Option<Press>,
    /// Presses so far, also while it was latched.
    presses: u64,
}

/// One press and the stops that it caused.
#[derive(Debug, Clone)]
pub struct Press {
    /// Who or what pressed it, and the reason.
    pub why: String,
    /// Monotonic time of the press.
    pub at: Instant,
    stops: BTreeMap<&'static str, AxisStop>,
}

impl Press {
    /// Stops of the axes, as far as they are known.
    pub fn stops(&self) -> Vec<AxisStop> {
        self.stops.values().cloned().collect()
    }

    /// Time from the press to the acknowledgement of the last axis, wall ms; none while one is
    /// missing.
    pub fn acknowledged_ms(&self) -> Option<f64> {
        let each: Option<Vec<f64>> = self.stops.values().map(|s| s.acknowledged_ms).collect();
        each?.into_iter().reduce(f64::max)
    }
}

impl StopSwitch {
    /// Latches and wakes the tasks that stop the axes. While it is latched, the first press is the one that is
    /// shown; each further one sends the stops again, and is counted, so that no reset which was requested before
    /// it releases it.
    pub fn press(&self, why: &str) {
        let mut state = self.state();
        self.inner.latch.latch();
        state.presses += 1;
        if state.press.is_none() {
            state.press =
                Some(Press { why: why.into(), at: Instant::now(), stops: BTreeMap::new() });
        }
        self.inner.latched.send_replace(Some(state.presses));
    }

    /// Presses so far.
    pub fn presses(&self) -> u64 {
        self.state().presses
    }

    /// The latched press, if any.
    pub fn pressed(&self) -> Option<Press> {
        self.state().press.clone()
    }

    /// Waits for a press after the first `presses`.
    pub async fn pressed_after(&self, presses: u64) {
        let mut latched = self.inner.latched.subscribe();
        let is_later = |press: &Option<u64>| press.is_some_and(|press| press > presses);
        // The sender lives as long as this switch.
        let _ = latched.wait_for(is_later).await.map(|_| ());
    }

    /// Releases the latch if there was no press after the first `presses`, those that the caller knew of.
    /// Otherwise returns false and changes nothing.
    pub fn release(&self, presses: u64) -> bool {
        let mut state = self.state();
        if state.presses != presses {
            return false;
        }
        state.press = None;
        self.inner.latched.send_replace(None);
        self.inner.latch.clear();
        true
    }

    /// The latch that the drivers consult before they send a motion.
    pub fn latch(&self) -> StopLatch {
        self.inner.latch.clone()
    }

    /// Waits for presses and stops every axis of a bench, each independently, until dropped. If the
    /// stop is already latched, it stops the bench immediately.
    pub async fn serve(self, bench: Bench) {
        let mut latched = self.inner.latched.subscribe();
        let mut served = None;
        // A release and the next press may both come before this task runs again: the number differs.
        let is_new = |press: &Option<u64>, served| press.is_some() && *press != served;
        let mut stops: FuturesUnordered<BoxFuture<'_, &'static str>> = FuturesUnordered::new();
        let mut unstopped: BTreeSet<&'static str> = BTreeSet::new();
        loop {
            let pressed =
                async { latched.wait_for(|press| is_new(press, served)).await.map(|press| *press) };
            tokio::select! {
                biased;
                Some(axis) = stops.next() => {
                    unstopped.remove(axis);
                }
                pressed = pressed => {
                    let Ok(press) = pressed else { return };
                    if served.is_none() {
                        self.forget_stops();
                    }
                    served = press;
                    self.expect(&bench);
                    for axis in bench.axes() {
                        if unstopped.insert(axis.name()) {
                            stops.push(self.stop_until_it_stands(axis.as_ref()).boxed());
                        }
                    }
                }
            }
        }
    }

    /// Nothing is known of axes that were stopped over other wires, which were closed.
    fn forget_stops(&self) {
        if let Some(press) = self.state().press.as_mut() {
            press.stops.clear();
        }
    }

    /// Lists every axis, so that none counts as stopped before it has acknowledged, nor, after a further press, before
    /// it was read at rest again.
    fn expect(&self, bench: &Bench) {
        if let Some(press) = self.state().press.as_mut() {
            for axis in bench.axes() {
                let axis = axis.name();
                press.stops.entry(axis).or_insert_with(|| AxisStop::of(axis)).stood_ms = None;
            }
        }
    }

    /// Returns the name of the axis once it has acknowledged a stop that was sent after the last press, and stands.
    async fn stop_until_it_stands(&self, axis: &dyn Axis) -> &'static str {
        let mut logged = None;
        while let Some(press) = self.pressed() {
            let presses = self.presses();
            let stopped = axis.stop().await;
            let after_ms = || press.at.elapsed().as_secs_f64() * 1e3;
            let stood = match stopped {
                Ok(()) => {
                    let acknowledged_ms = after_ms();
                    self.note(&press, axis.name(), |stop| stop.acknowledged(acknowledged_ms));
                    tokio::select! {
                        biased;
                        () = self.pressed_after(presses) => continue,
                        stood = stands(axis) => stood,
                    }
                }
                Err(error) => {
                    self.note(&press, axis.name(), |stop| stop.acknowledged_ms = None);
                    Err(error.to_string())
                }
            };
            match stood {
                Ok(()) => {
                    let stood_ms = after_ms();
                    self.note(&press, axis.name(), |stop| stop.stood(stood_ms));
                    break;
                }
                Err(words) => {
                    self.note(&press, axis.name(), |stop| {
                        (stop.stood_ms, stop.error) = (None, Some(words.clone()));
                    });
                    // The stop is sent every 50 ms: a cause is logged once.
                    if logged.as_ref() != Some(&words) {
                        let axis = axis.name();
                        tracing::error!(axis, error = words, "the axis is not stopped");
                    }
                    logged = Some(words);
                }
            }
            tokio::time::sleep(RESEND_PAUSE).await;
        }
        axis.name()
    }

    /// Changes what is known of the stop of an axis, unless the press that it was sent for was released meanwhile.
    fn note(&self, of: &Press, axis: &'static str, change: impl FnOnce(&mut AxisStop)) {
        if let Some(press) = self.state().press.as_mut().filter(|press| press.at == of.at) {
            change(press.stops.entry(axis).or_insert_with(|| AxisStop::of(axis)));
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.inner.state.lock()
    }
}

/// Readings of an axis after its stop. A drive in alarm reports rest even if its axis coasts: it stands once two readings
/// show it at rest at one place.
#[derive(Debug, Default)]
pub(super) struct RestReadings {
    /// Time and position of the first of the last readings at rest.
    first: Option<(Instant, f64)>,
}

impl RestReadings {
    /// Takes a reading. Returns whether the axis has been at rest since one at least `apart` earlier, wall time.
    pub(super) fn show_rest(&mut self, now: &AxisStatus, apart: Duration) -> bool {
        let at = Instant::now();
        let is_there = |place: f64| (now.position - place).abs() <= STAND_CHANGE;
        match self.first {
            Some((since, place)) if !now.moving && is_there(place) => at - since >= apart,
            _ => {
                self.first = (!now.moving).then_some((at, now.position));
                false
            }
        }
    }
}

/// Reads an axis that has acknowledged its stop until it stands.
pub(in crate::campaign) async fn stands(axis: &dyn Axis) -> Result<(), String> {
    let deadline = Instant::now() + STANDS_WITHIN;
    let mut readings = RestReadings::default();
    loop {
        let now = match axis.status().await {
            Ok(now) => now,
            Err(error) => return Err(format!("acknowledged, and may still move: {error}")),
        };
        if readings.show_rest(&now, STAND_PAUSE) {
            return Ok(());
        }
        if Instant::now() > deadline {
            return Err("acknowledged, and STILL MOVES".into());
        }
        tokio::time::sleep(STAND_PAUSE).await;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use tokio::task::JoinHandle;

    use super::*;
    use crate::campaign::bench::stand_in::{self, StandIns};

    /// A switch, axes, and the task that sends them its stops; the end of a test ends it.
    fn served() -> (StopSwitch, StandIns, JoinHandle<()>) {
        let (stop, axes) = (StopSwitch::default(), StandIns::default());
        let serving = tokio::spawn(stop.clone().serve(axes.bench()));
        (stop, axes, serving)
    }

    /// Waits until every axis has acknowledged the stop of the first press, and `stops` were received.
    async fn acknowledged(stop: &StopSwitch, axes: &StandIns, stops: u64) -> f64 {
        let known = || stop.pressed().and_then(|press| press.acknowledged_ms());
        stand_in::until(|| axes.stops() >= stops && known().is_some()).await;
        known().expect("it is acknowledged")
    }

    #[tokio::test]
    async fn a_further_press_sends_the_stops_again_and_shows_the_time_of_the_first() {
        let (stop, axes, _serving) = served();
        stop.press("first");
        let first_ms = acknowledged(&stop, &axes, 4).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
        stop.press("second");
        assert_eq!(acknowledged(&stop, &axes, 8).await, first_ms);
        assert_eq!(stop.pressed().unwrap().why, "first");
    }

    #[tokio::test]
    async fn a_further_press_stops_the_others_again_while_one_axis_is_silent() {
        let (stop, axes, _serving) = served();
        axes.x.replies.store(false, Ordering::SeqCst);
        for stops in [3, 6] {
            stop.press("silent");
            stand_in::until(|| axes.stops() >= stops).await;
            assert_eq!(stop.pressed().unwrap().acknowledged_ms(), None);
        }
        axes.x.replies.store(true, Ordering::SeqCst);
        acknowledged(&stop, &axes, 7).await;
    }

    /// Waits until this holds for the stops of the latched press.
    async fn until(stop: &StopSwitch, done: impl Fn(&[AxisStop]) -> bool) {
        stand_in::until(|| stop.pressed().is_some_and(|press| done(&press.stops()))).await;
    }

    /// Whether every axis stands.
    fn stand(stops: &[AxisStop]) -> bool {
        stops.len() == 4 && stops.iter().all(|stop| stop.stood_ms.is_some())
    }

    #[tokio::test]
    async fn an_axis_that_acknowledges_and_moves_on_is_named_and_stopped_again_until_it_stands() {
        let (stop, axes, _serving) = served();
        axes.x.status.lock().moving = true;
        stop.press("coasts");
        let is_named = |stop: &AxisStop| {
            let moves = stop.error.as_ref().is_some_and(|words| words.contains("STILL MOVES"));
            stop.axis == "x" && stop.acknowledged_ms.is_some() && stop.stood_ms.is_none() && moves
        };
        until(&stop, |stops| stops.iter().any(is_named)).await;
        let stood = stop.pressed().unwrap().stops();
        assert_eq!(stood.iter().filter(|stop| stop.stood_ms.is_some()).count(), 3, "{stood:?}");
        assert_eq!(axes.y.stops.load(Ordering::SeqCst), 1);
        axes.x.status.lock().moving = false;
        let stands = |stop: &AxisStop| stop.stood_ms.is_some() && stop.error.is_none();
        until(&stop, |stops| stops.iter().all(stands)).await;
        assert!(axes.x.stops.load(Ordering::SeqCst) > 1, "sent again");
    }

    #[tokio::test]
    async fn after_a_further_press_no_axis_counts_as_standing_before_it_was_read_again() {
        let (stop, axes, _serving) = served();
        stop.press("hands");
        until(&stop, stand).await;
        // It is moved at its panel.
        axes.x.status.lock().moving = true;
        stop.press("it moves");
        let is_read =
            |stop: &AxisStop| stop.axis == "x" && stop.is_done() && stop.stood_ms.is_none();
        until(&stop, |stops| stops.iter().any(is_read)).await;
        axes.x.status.lock().moving = false;
        until(&stop, stand).await;
    }

    #[tokio::test]
    async fn over_new_wires_no_axis_counts_as_stopped_before_it_has_acknowledged_there() {
        let (stop, axes, serving) = served();
        stop.press("hands");
        until(&stop, stand).await;
        serving.abort();
        let _ = serving.await;
        axes.x.replies.store(false, Ordering::SeqCst);
        tokio::spawn(stop.clone().serve(axes.bench()));
        let is_silent = |stop: &AxisStop| stop.axis == "x" && stop.stood_ms.is_none();
        until(&stop, |stops| stops.iter().any(is_silent)).await;
        assert_eq!(stop.pressed().unwrap().acknowledged_ms(), None);
    }

    #[test]
    fn a_press_outlasts_every_reset_that_was_requested_before_it() {
        let stop = StopSwitch::default();
        stop.press("first");
        let requested = stop.presses();
        stop.press("second");
        assert!(!stop.release(requested));
        assert_eq!(stop.pressed().unwrap().why, "first");
        assert!(stop.release(stop.presses()) && stop.pressed().is_none());
        // Also of a reset that was decided while it was not pressed.
        let decided = stop.presses();
        stop.press("third");
        assert!(!stop.release(decided) && stop.pressed().is_some());
    }
}
