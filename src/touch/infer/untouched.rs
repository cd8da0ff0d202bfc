//! The untouched skin before stored trials, from the store.
//! Uses: `store`, `dataset::pressed` (the clock rate of a rig), `scatter`, `untouched_frame`.
//! Never: a trial's frame.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::scatter::{Scatter, mean, of_pairs};
use super::untouched_frame::UntouchedBefore;
use crate::dataset::pressed::clock_rate;
use crate::ids::{RunUid, TrialId};
use crate::record::Untouched;
use crate::store::{BeforeTrial, Store, StoreError};

/// Largest number of untouched frames from which the scatter of a run's offsets is estimated.
const SCATTER_OF: u32 = 300;
/// Largest age of a frame in the mean, process h: after a pause offsets have drifted.
const MEAN_WITHIN_HOURS: f64 = 1.0;

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
    means: Option<Means>,
}

/// The zero as the mean of several frames of the untouched skin.
#[derive(Debug, Clone)]
struct Means {
    /// Number of frames whose mean is closest to the next one.
    count: usize,
    /// What the offsets of the next frame differ by from that mean.
    scatter: Scatter,
    /// All frames of the run, oldest first.
    frames: Vec<Offsets>,
}

/// Offsets in a frame of the untouched skin.
#[derive(Debug, Clone)]
struct Offsets {
    /// Wall time of the frame, ms.
    at_ms: i64,
    /// Wall time since which its stream was open, ms; none if it is not known.
    stream_since_ms: Option<i64>,
    /// Of the pairs, V.
    of_pairs_v: Vec<f64>,
}

impl Offsets {
    fn of(skin: &Untouched) -> Self {
        let (at_ms, of_pairs_v) = (skin.at.as_millisecond(), pairs_of(skin));
        let stream_since_ms = skin.stream_since.map(|since| since.as_millisecond());
        Self { at_ms, stream_since_ms, of_pairs_v }
    }
}

impl Tared {
    /// Reads what is known of a run whose zero is one frame.
    ///
    /// # Errors
    /// `StoreError` if the store fails or a frame is damaged.
    pub async fn of_run(store: &Store, run: RunUid) -> Result<Self, StoreError> {
        Self::read(store, run, SCATTER_OF).await.map(|(tared, _)| tared)
    }

    /// Reads what is known of a run whose zero is the mean of several frames.
    async fn with_means(store: &Store, run: RunUid) -> Result<Self, StoreError> {
        let (tared, frames) = Self::read(store, run, u32::MAX).await?;
        let Some((count, scatter)) = Scatter::of_best_means(&first_of_streams(&frames)) else {
            return Ok(tared);
        };
        let means = Means { count, scatter, frames: frames.iter().map(Offsets::of).collect() };
        Ok(Self { means: Some(means), ..tared })
    }

    async fn read(
        store: &Store,
        run: RunUid,
        most: u32,
    ) -> Result<(Self, Vec<Untouched>), StoreError> {
        let rig = store.run(run).await?.and_then(|row| row.rig);
        let frames = store.untouched_frames(run, most).await?;
        let clock_rate = rig.as_deref().map_or(1.0, clock_rate);
        let scatter = Scatter::of_streams(&first_of_streams(&frames));
        Ok((Self { clock_rate, scatter, means: None }, frames))
    }

    /// The untouched skin before frames that are `wall_s` younger.
    pub fn before(&self, skin: &Untouched, wall_s: f64) -> UntouchedBefore {
        let one = UntouchedBefore {
            voltages_v: skin.voltages_v.clone(),
            frames: skin.frames.max(1) as f64,
            hours: self.hours(wall_s),
            scatter: self.scatter.clone(),
        };
        let Some(Means { count, scatter, frames }) = &self.means else { return one };
        let at_ms = skin.at.as_millisecond();
        let Some(own) = frames.iter().rposition(|frame| frame.at_ms == at_ms) else { return one };
        let stream_since_ms = frames[own].stream_since_ms;
        // A stream that was opened again, or whose device has restarted, may have other offsets.
        let is_like = |frame: &&Offsets| {
            frame.stream_since_ms == stream_since_ms
                && self.hours(1e-3 * at_ms.abs_diff(frame.at_ms) as f64) < MEAN_WITHIN_HOURS
        };
        let last = frames[..=own].iter().rev().take(*count).take_while(is_like);
        let offsets: Vec<Vec<f64>> = last.map(|frame| frame.of_pairs_v.clone()).collect();
        let better_v: Vec<f64> =
            mean(&offsets).iter().zip(pairs_of(skin)).map(|(mean, own)| mean - own).collect();
        let moved = skin.voltages_v.iter().zip(better_v.iter().cycle());
        UntouchedBefore {
            voltages_v: moved.map(|(v, by)| (f64::from(*v) + by) as f32).collect(),
            frames: one.frames * offsets.len() as f64,
            scatter: if offsets.len() == *count { Some(scatter.clone()) } else { one.scatter },
            hours: one.hours,
        }
    }

    /// Process hours in a wall time.
    fn hours(&self, wall_s: f64) -> f64 {
        (self.clock_rate * wall_s / 3600.0).max(0.0)
    }
}

/// The frames from which scatter is estimated, V, those of each stream apart.
fn first_of_streams(frames: &[Untouched]) -> Vec<Vec<&[f32]>> {
    let first = &frames[..frames.len().min(SCATTER_OF as usize)];
    first
        .chunk_by(|a, b| a.stream_since == b.stream_since)
        .map(|stream| stream.iter().map(|skin| skin.voltages_v.as_slice()).collect())
        .collect()
}

/// Offsets of the pairs of electrodes in a frame, V.
fn pairs_of(skin: &Untouched) -> Vec<f64> {
    of_pairs(&skin.voltages_v.iter().copied().map(f64::from).collect::<Vec<_>>())
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
                unread.insert(Tared::with_means(store, run).await?);
            }
        }
        Ok(Self { before, runs })
    }

    /// The frame before a trial alone, V; none if none was measured in its run.
    pub fn last_v(&self, trial: TrialId) -> Option<&[f32]> {
        self.before.get(&trial).map(|before| before.skin.voltages_v.as_slice())
    }

    /// The one before a trial, with the mean offsets of those before it that were measured in its run; `None` if none was.
    pub fn of(&self, trial: TrialId) -> Option<UntouchedBefore> {
        let BeforeTrial { skin, trial_started_at } = self.before.get(&trial)?;
        let run = self.runs.get(&skin.run?)?;
        Some(run.before(skin, trial_started_at.duration_since(skin.at).as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of two pairs after these minutes.
    fn skin(minutes: i64, offset_v: f32, of_channel_v: f32) -> Untouched {
        let voltages_v = vec![offset_v + of_channel_v, 0.0, offset_v - of_channel_v, 0.0];
        let at = format!("2026-11-28T{:02}:{:02}:00Z", minutes / 60, minutes % 60);
        let at = at.parse().unwrap();
        Untouched { voltages_v, at, frames: 4, run: None, stream_since: None }
    }

    #[test]
    fn scatter_is_estimated_from_the_first_frames_of_each_stream() {
        let again = skin(3, 0.0, 0.0).at;
        let of_minute = |at: i64| {
            let stream_since = (at >= 3).then_some(again);
            Untouched { stream_since, ..skin(at, at as f32, 0.0) }
        };
        let few: Vec<Untouched> = (0..5).map(of_minute).collect();
        let first_v = |stream: &Vec<&[f32]>| (stream.len(), stream[0][0]);
        let streams: Vec<_> = first_of_streams(&few).iter().map(first_v).collect();
        assert_eq!(streams, [(3, 0.0), (2, 3.0)]);
        let many: Vec<Untouched> = (0..400).map(of_minute).collect();
        let streams: Vec<_> = first_of_streams(&many).iter().map(Vec::len).collect();
        assert_eq!(streams, [3, SCATTER_OF as usize - 3]);
        assert!(first_of_streams(&[]).is_empty());
    }

    #[test]
    fn the_zero_is_the_mean_of_the_last_recent_frames_of_the_run() {
        let of = |sd_v: f64| Scatter { sd_v, spectrum: Vec::new() };
        let skins =
            [(0, 8.0), (70, 1.0), (71, 3.0), (72, 5.0), (73, 9.0)].map(|(at, v)| skin(at, v, 0.5));
        let frames = skins.iter().map(Offsets::of).collect();
        let tared = Tared {
            clock_rate: 1.0,
            scatter: Some(of(1.0)),
            means: Some(Means { count: 3, scatter: of(0.5), frames }),
        };
        let zero = tared.before(&skins[3], 36.0);
        assert_eq!(
            zero.voltages_v,
            [3.5, 0.0, 2.5, 0.0],
            "the mean offset, and the rest of the last frame"
        );
        assert_eq!((zero.frames, zero.hours, zero.scatter), (12.0, 0.01, Some(of(0.5))));
        // The frame of 70 minutes before has drifted; the scatter of a mean of three does not hold for two.
        let zero = tared.before(&skins[2], 0.0);
        assert_eq!((zero.voltages_v[0], zero.frames, zero.scatter), (2.5, 8.0, Some(of(1.0))));
        // Between 71 and 72 minutes the stream was opened again.
        let mut again = tared.clone();
        let means = again.means.as_mut().unwrap();
        means.frames[3..].iter_mut().for_each(|frame| frame.stream_since_ms = Some(0));
        let zero = again.before(&skins[3], 36.0);
        assert_eq!((zero.voltages_v[0], zero.frames, zero.scatter), (5.5, 4.0, Some(of(1.0))));
        let alone = Tared { means: None, ..tared };
        assert_eq!(alone.before(&skins[3], 0.0).voltages_v, skins[3].voltages_v);
    }
}
