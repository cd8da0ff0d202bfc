//! The software stop: one call from anywhere that reaches the wires ahead of every queue, and is
//! repeated until each axis has acknowledged it.
//! Uses: tokio, `rig::traits`. Never: states, storage. It is not a certified emergency stop: that is
//! hardware which removes power; this one only decelerates the axes.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::Instant;
use utoipa::ToSchema;

use crate::rig::link::StopLatch;
use crate::rig::traits::{Axis, Bench};

/// Pause before a stop that was not acknowledged is sent again: it is on the wire within this time
/// once the wire carries again.
const AGAIN: Duration = Duration::from_millis(50);

/// What became of one axis's stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AxisStop {
    /// `x`, `y`, `z` or `radial`.
    pub axis: String,
    /// From the stop's request to the axis's acknowledgement, wall ms; absent: not acknowledged.
    pub acknowledged_ms: Option<f64>,
    /// Why it is not acknowledged.
    pub error: Option<String>,
}

/// A latching stop button. Clones are the same button.
#[derive(Debug, Clone, Default)]
pub struct StopSwitch {
    inner: Arc<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    latch: StopLatch,
    pressed: watch::Sender<bool>,
    press: Mutex<Option<Press>>,
}

/// One press and what came of it.
#[derive(Debug, Clone)]
pub struct Press {
    /// Who or what pressed it.
    pub why: String,
    /// When.
    pub at: Instant,
    stops: BTreeMap<&'static str, AxisStop>,
}

impl Press {
    /// The axes' stops so far.
    pub fn stops(&self) -> Vec<AxisStop> {
        self.stops.values().cloned().collect()
    }

    /// From the press to the last axis's acknowledgement, wall ms; none while one is missing.
    pub fn acknowledged_ms(&self) -> Option<f64> {
        let each: Option<Vec<f64>> = self.stops.values().map(|s| s.acknowledged_ms).collect();
        each?.into_iter().reduce(f64::max)
    }
}

impl StopSwitch {
    /// Latches and wakes the tasks that stop the axes. Idempotent: the first press counts.
    pub fn press(&self, why: &str) {
        let mut slot = self.press_slot();
        self.inner.latch.latch();
        slot.get_or_insert_with(|| Press {
            why: why.into(),
            at: Instant::now(),
            stops: BTreeMap::new(),
        });
        self.inner.pressed.send_replace(true);
    }

    /// The press that is latched, if any.
    pub fn pressed(&self) -> Option<Press> {
        self.press_slot().clone()
    }

    /// Releases the latch of the press that somebody has looked at (by its time; none if there was
    /// none). False, and nothing changes, when it has been pressed anew since.
    pub fn release(&self, seen: Option<Instant>) -> bool {
        let mut slot = self.press_slot();
        if slot.as_ref().map(|press| press.at) != seen {
            return false;
        }
        *slot = None;
        self.inner.pressed.send_replace(false);
        self.inner.latch.clear();
        true
    }

    /// The latch that the drivers consult before they send a motion.
    pub fn latch(&self) -> StopLatch {
        self.inner.latch.clone()
    }

    /// Waits for presses and stops every axis of a bench, each by itself, until dropped. A bench
    /// that is opened while the stop is latched is stopped at once.
    pub async fn serve(self, bench: Bench) {
        let mut pressed = self.inner.pressed.subscribe();
        while pressed.wait_for(|latched| *latched).await.is_ok() {
            self.expect(&bench);
            let stops = bench.axes().map(|axis| self.stop_until_acknowledged(axis.as_ref()));
            futures::future::join_all(stops).await;
            if pressed.wait_for(|latched| !*latched).await.is_err() {
                return;
            }
        }
    }

    /// No axis counts as stopped before it has acknowledged.
    fn expect(&self, bench: &Bench) {
        if let Some(press) = self.press_slot().as_mut() {
            for axis in bench.axes() {
                let axis = axis.name();
                let stop = AxisStop { axis: axis.into(), acknowledged_ms: None, error: None };
                press.stops.entry(axis).or_insert(stop);
            }
        }
    }

    async fn stop_until_acknowledged(&self, axis: &dyn Axis) {
        while let Some(press) = self.pressed() {
            let outcome = axis.stop().await;
            let stop = AxisStop {
                axis: axis.name().into(),
                acknowledged_ms: outcome.is_ok().then(|| press.at.elapsed().as_secs_f64() * 1e3),
                error: outcome.as_ref().err().map(ToString::to_string),
            };
            if let Some(press) = self.press_slot().as_mut() {
                press.stops.insert(axis.name(), stop);
            }
            match outcome {
                Ok(()) => return,
                Err(error) => tracing::error!(axis = axis.name(), %error, "stop not acknowledged"),
            }
            tokio::time::sleep(AGAIN).await;
        }
    }

    fn press_slot(&self) -> MutexGuard<'_, Option<Press>> {
        self.inner.press.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
