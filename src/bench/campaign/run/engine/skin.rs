//! The empty skin of a manual run: tared by a person, then followed while the run waits for placements.
//! Uses: `trial::untouched`. Never: motion, the load cells.

use std::future::pending;
use std::sync::Arc;

use super::{Answer, Engine};
use crate::campaign::run::run_state::PausedWhy;
use crate::campaign::shown::command::{ANSWERED_WITHIN, Refusal};
use crate::campaign::trial::rest::Window;
use crate::campaign::trial::untouched::{Seen, UntouchedMean, UntouchedSkin, WINDOW_FRAMES};
use crate::clock::Clock;
use crate::record::Untouched;
use crate::rig::error::RigError;
use crate::rig::traits::SkinReader;

/// Windows in which a skin that is tared must come to rest.
const TARE_WINDOWS: u32 = 4;
/// Pause after frames that did not arrive, process s.
const PAUSE_S: f64 = 1.0;

/// Why a placement is refused whose zero was measured before the stream was opened again.
const ZERO_OF_EARLIER_STREAM: &str = "confirm is not possible: since the untouched skin was measured, the voltage \
    stream was opened again or its device restarted; take everything off the skin for 5 s, or tare it, and place the \
    weights again";

/// What is known of the empty skin.
#[derive(Debug, Default)]
pub(super) enum EmptySkin {
    /// No untouched frame was measured in this session.
    #[default]
    Unknown,
    /// A person states that it is empty; it must come to rest.
    Tared { answer: Answer, before: Option<Window>, windows: u32 },
    /// It came to rest: each window that differs from the last untouched one by noise alone is untouched, too.
    Followed(Box<UntouchedSkin>),
}

/// What the next window is read from.
pub(super) type SkinWires = (Arc<dyn SkinReader>, Clock);

/// Takes the next window; never returns without wires.
pub(super) async fn next_window(wires: Option<SkinWires>) -> Result<Seen, RigError> {
    let Some((skin, clock)) = wires else { return pending().await };
    let seen = Seen::next(&skin, &clock).await;
    if seen.is_err() {
        clock.sleep(PAUSE_S).await;
    }
    seen
}

impl Engine {
    /// The wires of the next window, if the empty skin is watched: while the run waits for a placement.
    pub(super) fn watched_skin(&self) -> Option<SkinWires> {
        let waits = self.control.run().why() == Some(PausedWhy::ManualTrial);
        let is_watched = waits && !matches!(self.empty_skin, EmptySkin::Unknown);
        let connection = self.connection.as_ref().filter(|_| is_watched)?;
        Some((connection.skin.clone(), connection.clock.clone()))
    }

    /// A person states that nothing touches the skin; answered once it is at rest.
    pub(super) fn tare_skin(&mut self, answer: Answer) {
        let process_s = 2.0 * WINDOW_FRAMES as f64 / self.config.ert().frame_rate_hz();
        let wall_s = process_s / self.config.clock_rate();
        if wall_s > ANSWERED_WITHIN.as_secs_f64() {
            let words = format!(
                "tare is not possible: its {} frames take {wall_s:.0} s; ert.frame_rate_hz must be larger",
                2 * WINDOW_FRAMES
            );
            let _ = answer.send(Err(Refusal::State(words)));
            return;
        }
        self.empty_skin = EmptySkin::Tared { answer, before: None, windows: 0 };
    }

    /// Takes in the next window of the watched skin.
    pub(super) fn saw(&mut self, seen: Result<Seen, RigError>) {
        match (std::mem::take(&mut self.empty_skin), seen) {
            // Its caller was told that it failed, and may be placing weights.
            (EmptySkin::Tared { answer, .. }, _) if answer.is_closed() => {}
            (EmptySkin::Tared { answer, before, windows }, Ok(seen)) => {
                if before.is_some_and(|before| seen.window.rests_after(&before)) {
                    let skin = UntouchedSkin::tared(seen);
                    self.record_untouched(&skin.mean());
                    self.empty_skin = EmptySkin::Followed(Box::new(skin));
                    let _ = answer.send(Ok(()));
                } else if windows < TARE_WINDOWS {
                    let (before, windows) = (Some(seen.window), windows + 1);
                    self.empty_skin = EmptySkin::Tared { answer, before, windows };
                } else {
                    let words =
                        "tare is not possible: the skin is not at rest; take everything off it";
                    let _ = answer.send(Err(Refusal::State(words.into())));
                }
            }
            (EmptySkin::Tared { answer, .. }, Err(error)) => {
                let words = format!("tare is not possible: {error}");
                let _ = answer.send(Err(Refusal::State(words)));
            }
            (EmptySkin::Followed(mut skin), Ok(seen)) => {
                let found = skin.push(seen);
                self.empty_skin = EmptySkin::Followed(skin);
                found.iter().for_each(|found| self.record_untouched(found));
            }
            (kept, _) => self.empty_skin = kept,
        }
    }

    /// Refuses a placement if its zero was measured before the stream was opened again, or its device restarted:
    /// offsets may be others since. A skin that was not tared has no zero.
    pub(super) fn require_zero_of_stream(&self) -> Result<(), Refusal> {
        let (EmptySkin::Followed(skin), Some(open)) = (&self.empty_skin, &self.connection) else {
            return Ok(());
        };
        if skin.stream_since() == open.skin.counters().since {
            return Ok(());
        }
        Err(Refusal::State(ZERO_OF_EARLIER_STREAM.into()))
    }

    /// A person has confirmed that weights are on the skin.
    pub(super) fn weights_are_placed(&mut self) {
        match &mut self.empty_skin {
            EmptySkin::Unknown => {}
            EmptySkin::Tared { .. } => {
                if let EmptySkin::Tared { answer, .. } = std::mem::take(&mut self.empty_skin) {
                    let words = "tare is not possible: a placement was confirmed meanwhile";
                    let _ = answer.send(Err(Refusal::State(words.into())));
                }
            }
            EmptySkin::Followed(skin) => {
                let found = skin.placed();
                found.iter().for_each(|found| self.record_untouched(found));
            }
        }
    }

    fn record_untouched(&self, mean: &UntouchedMean) {
        self.control.untouched(Untouched {
            voltages_v: mean.mean_v.iter().map(|v| *v as f32).collect(),
            at: mean.at,
            frames: mean.frames,
            run: self.control.run_uid(),
            stream_since: mean.stream_since,
        });
    }
}
