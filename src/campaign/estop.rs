//! The software stop: one call from anywhere that reaches the wires ahead of every queue.
//! Uses: tokio, `rig::traits`. Never: states, storage. It is not a certified emergency stop: that is
//! hardware which removes power; this one only decelerates the axes.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::Instant;

use crate::rig::link::StopLatch;
use crate::rig::traits::Bench;

/// A latching stop button.
#[derive(Debug, Clone, Default)]
pub struct StopSwitch {
    inner: Arc<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    latch: StopLatch,
    pressed: Notify,
    press: Mutex<Option<Press>>,
}

/// One press and what came of it.
#[derive(Debug, Clone)]
pub struct Press {
    /// Who or what pressed it.
    pub why: String,
    /// When.
    pub at: Instant,
    /// From the press until the last axis had acknowledged its stop.
    pub acknowledged_after: Option<Duration>,
}

impl StopSwitch {
    /// Latches and wakes the task that stops the axes. Idempotent: the first press counts.
    pub fn press(&self, why: &str) {
        {
            let mut press = self.inner.press.lock().unwrap_or_else(PoisonError::into_inner);
            if press.is_none() {
                *press =
                    Some(Press { why: why.into(), at: Instant::now(), acknowledged_after: None });
            }
        }
        self.inner.latch.latch();
        self.inner.pressed.notify_one();
    }

    /// The press that is latched, if any.
    pub fn pressed(&self) -> Option<Press> {
        self.inner.press.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Releases the latch.
    pub fn release(&self) {
        *self.inner.press.lock().unwrap_or_else(PoisonError::into_inner) = None;
        self.inner.latch.clear();
    }

    /// The latch that the drivers consult before they send a motion.
    pub fn latch(&self) -> StopLatch {
        self.inner.latch.clone()
    }

    /// Waits for presses and stops every axis at once, until it is dropped.
    pub async fn serve(self, bench: Bench) {
        loop {
            self.inner.pressed.notified().await;
            let stops = bench.axes().map(|axis| {
                let axis = axis.clone();
                async move {
                    if let Err(error) = axis.stop().await {
                        tracing::error!(axis = axis.name(), %error, "stop was not acknowledged");
                    }
                }
            });
            futures::future::join_all(stops).await;
            let mut press = self.inner.press.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(press) = press.as_mut() {
                press.acknowledged_after.get_or_insert_with(|| press.at.elapsed());
            }
        }
    }
}
