//! The untouched skin before stored trials, from the store.
//! Uses: `store`, `dataset::pressed` (the clock rate of a rig), `scatter`, `untouched_frame`.
//! Never: a trial's frame.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::scatter::Scatter;
use super::untouched_frame::UntouchedBefore;
use crate::dataset::pressed::clock_rate;
use crate::ids::{RunUid, TrialId};
use crate::record::Untouched;
use crate::store::{BeforeTrial, Store, StoreError};

/// Largest number of untouched frames from which the scatter of a run's offsets is estimated.
const SCATTER_OF: u32 = 300;

/// Frames of the untouched skin before trials of any runs.
#[derive(Debug, Default)]
pub struct UntouchedSkins {
    before: HashMap<TrialId, BeforeTrial>,
    runs: HashMap<RunUid, Tared>,
}

/// What is known of the untouched skin in a run.
#[derive(Debug, Clone)]
pub struct Tared {
    /// Process seconds per wall second.
    clock_rate: f64,
    /// What the offsets differ by between two frames of the untouched skin.
    scatter: Option<Scatter>,
}

impl Tared {
    /// Reads what is known of a run.
    ///
    /// # Errors
    /// `StoreError` if the store fails or a frame is damaged.
    pub async fn of_run(store: &Store, run: RunUid) -> Result<Self, StoreError> {
        let rig = store.run(run).await?.and_then(|row| row.rig);
        let frames = store.untouched_frames(run, SCATTER_OF).await?;
        let frames: Vec<&[f32]> = frames.iter().map(|skin| skin.voltages_v.as_slice()).collect();
        let clock_rate = rig.as_deref().map_or(1.0, clock_rate);
        Ok(Self { clock_rate, scatter: Scatter::of(&frames) })
    }

    /// The untouched skin before frames that are `wall_s` younger.
    pub fn before(&self, skin: &Untouched, wall_s: f64) -> UntouchedBefore {
        let hours = (self.clock_rate * wall_s / 3600.0).max(0.0);
        UntouchedBefore {
            voltages_v: skin.voltages_v.clone(),
            frames: skin.frames.max(1) as f64,
            hours,
            scatter: self.scatter.clone(),
        }
    }
}

impl UntouchedSkins {
    /// Reads them for these trials.
    ///
    /// # Errors
    /// `StoreError` if the store fails or a frame is damaged.
    pub async fn before(store: &Store, trials: &[TrialId]) -> Result<Self, StoreError> {
        let before = store.untouched_before(trials).await?;
        let mut runs = HashMap::new();
        for run in before.values().filter_map(|before| before.skin.run) {
            if let Entry::Vacant(unread) = runs.entry(run) {
                unread.insert(Tared::of_run(store, run).await?);
            }
        }
        Ok(Self { before, runs })
    }

    /// The one before a trial; `None` if none was measured in its run.
    pub fn of(&self, trial: TrialId) -> Option<UntouchedBefore> {
        let BeforeTrial { skin, trial_started_at } = self.before.get(&trial)?;
        let run = self.runs.get(&skin.run?)?;
        Some(run.before(skin, trial_started_at.duration_since(skin.at).as_secs_f64()))
    }
}
