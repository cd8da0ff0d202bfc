//! What the offsets of a readout scatter by, from one frame of the untouched skin to the next, and in which waves
//! around the electrodes.
//! PURE. Uses: sim-core's `stats`. Never: a frame with a contact.
//!
//! An offset is that of a pair of electrodes. If it is the difference of the buffers of two electrodes, the
//! offsets of neighbouring pairs have opposite parts, and waves of offsets that turn slowly around the electrodes
//! are small; the frames of contacts have much of these. The spectrum is measured, not assumed.

use serde::{Deserialize, Serialize};
use sim_core::stats::{frequency, pair_sums, waves};

/// Smallest number of frames, for a zero that is one of them.
const LEAST_FRAMES: usize = 5;
/// Numbers of earlier frames whose mean may be the zero of a frame.
const MEANS_OF: [usize; 5] = [1, 2, 4, 8, 16];
/// Weight of equal variances in the spectrum, in squares: with few frames, a wave that was not seen is not absent.
const EQUAL_SQUARES: f64 = 10.0;

/// Scatter of the offsets of the pairs of electrodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scatter {
    /// Standard deviation of the difference of an offset from that of the frame, or the mean of frames, before, V.
    pub sd_v: f64,
    /// Variance by frequency around the electrodes, relative to the mean over all waves; empty without scatter.
    pub spectrum: Vec<f64>,
}

impl Scatter {
    /// Of frames of the untouched skin in the order of time, V; `None` with too few frames, or of different
    /// lengths. A frame with a value that is not finite is skipped.
    pub fn of(frames: &[&[f32]]) -> Option<Self> {
        Self::of_streams(&[frames.to_vec()])
    }

    /// As [`Self::of`], of the frames of each stream: no difference is one between two streams, whose device may have
    /// other offsets.
    pub fn of_streams(streams: &[Vec<&[f32]>]) -> Option<Self> {
        Self::from_means(&offsets(streams)?, 1)
    }

    /// The number of frames whose mean is closest to the next frame, with the scatter of that difference: the mean of
    /// more frames has less noise, and is older. As [`Self::of_streams`].
    pub fn of_best_means(streams: &[Vec<&[f32]>]) -> Option<(usize, Self)> {
        let offsets = offsets(streams)?;
        let of = |count: usize| Some((count, Self::from_means(&offsets, count)?));
        MEANS_OF.into_iter().filter_map(of).min_by(|a, b| a.1.sd_v.total_cmp(&b.1.sd_v))
    }

    /// Of the differences of offsets, V, from the mean of `count` frames before each in its stream.
    fn from_means(streams: &[Vec<Vec<f64>>], count: usize) -> Option<Self> {
        let pairs = streams.iter().flatten().next()?.len();
        let windows: Vec<&[Vec<f64>]> =
            streams.iter().flat_map(|offsets| offsets.windows(count + 1)).collect();
        // As many as `LEAST_FRAMES * count` frames of one stream have.
        if windows.len() < (LEAST_FRAMES - 1) * count {
            return None;
        }
        let changes = windows.len() as f64;
        let waves = waves(pairs);
        let mut sums_v2 = vec![0.0; waves.len()];
        for frames in windows {
            let (after, before) = (&frames[count], mean(&frames[..count]));
            for (sum_v2, wave) in sums_v2.iter_mut().zip(&waves) {
                let change_v = wave.iter().zip(after.iter().zip(&before));
                *sum_v2 += change_v.map(|(w, (a, b))| w * (a - b)).sum::<f64>().powi(2);
            }
        }
        let mean_v2 = sums_v2.iter().sum::<f64>() / (changes * waves.len() as f64);
        Some(Self { sd_v: mean_v2.sqrt(), spectrum: spectrum(&sums_v2, changes, mean_v2) })
    }
}

/// Offsets of the pairs in each frame of each stream, V; `None` if lengths differ, or without a frame.
fn offsets(streams: &[Vec<&[f32]>]) -> Option<Vec<Vec<Vec<f64>>>> {
    let channels = streams.iter().flatten().find(is_finite)?.len();
    let of = |frame: &&[f32]| {
        let frame_v: Vec<f64> = frame.iter().copied().map(f64::from).collect();
        (frame.len() == channels).then(|| of_pairs(&frame_v))
    };
    let of_stream = |stream: &Vec<&[f32]>| -> Option<Vec<Vec<f64>>> {
        stream.iter().filter(is_finite).map(of).collect()
    };
    streams.iter().map(of_stream).collect()
}

/// Whether each value of a frame is finite.
fn is_finite(frame: &&&[f32]) -> bool {
    frame.iter().all(|volts| volts.is_finite())
}

/// Mean of offsets, V.
pub(super) fn mean(offsets: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; offsets.first().map_or(0, Vec::len)];
    for frame in offsets {
        mean.iter_mut().zip(frame).for_each(|(m, v)| *m += v / offsets.len() as f64);
    }
    mean
}

/// Mean of each pair of electrodes over the injections, V.
pub(super) fn of_pairs(frame_v: &[f64]) -> Vec<f64> {
    let sums = pair_sums(frame_v);
    let injections = sums.len() as f64;
    sums.into_iter().map(|sum| sum / injections).collect()
}

/// The relative variance of each frequency, from the sums of squares of the waves.
fn spectrum(sums_v2: &[f64], changes: f64, mean_v2: f64) -> Vec<f64> {
    let sound = mean_v2 > 0.0 && mean_v2.is_finite();
    let last = sums_v2.len().checked_sub(1).filter(|_| sound).map(frequency);
    let Some(last) = last else { return Vec::new() };
    let (mut sums, mut counts) = (vec![EQUAL_SQUARES; last + 1], vec![EQUAL_SQUARES; last + 1]);
    for (wave, sum_v2) in sums_v2.iter().enumerate() {
        sums[frequency(wave)] += sum_v2 / mean_v2;
        counts[frequency(wave)] += changes;
    }
    let shares: Vec<f64> = sums.iter().zip(&counts).map(|(sum, count)| sum / count).collect();
    let all: f64 = (0..sums_v2.len()).map(|wave| shares[frequency(wave)]).sum();
    shares.iter().map(|share| share * sums_v2.len() as f64 / all).collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const PAIRS: usize = 28;

    /// Frames with offsets of 1 mV: independent ones, or differences of the buffers of neighbours.
    fn frames(count: usize, of_buffers: bool) -> Vec<Vec<f32>> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut one = || {
            let own_v: Vec<f64> = (0..PAIRS)
                .map(|_| 1e-3 * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>())
                .collect();
            let offset_v = |pair: usize| {
                let next_v = own_v[(pair + 1) % PAIRS];
                if of_buffers { (own_v[pair] - next_v) / 2f64.sqrt() } else { own_v[pair] }
            };
            (0..PAIRS * PAIRS).map(|i| offset_v(i % PAIRS) as f32).collect()
        };
        (0..count).map(|_| one()).collect()
    }

    fn slices(frames: &[Vec<f32>]) -> Vec<&[f32]> {
        frames.iter().map(Vec::as_slice).collect()
    }

    fn scatter(frames: &[Vec<f32>]) -> Option<Scatter> {
        Scatter::of(&slices(frames))
    }

    #[test]
    fn differences_of_buffers_have_little_of_slow_waves() {
        let Scatter { sd_v, spectrum } = scatter(&frames(300, true)).unwrap();
        assert!((1e3 * sd_v / 2f64.sqrt() - 1.0).abs() < 0.05, "{sd_v}");
        assert_eq!(spectrum.len(), PAIRS / 2 + 1);
        for (turns, share) in spectrum.iter().enumerate() {
            let wanted = 1.0 - (std::f64::consts::TAU * turns as f64 / PAIRS as f64).cos();
            assert!((share - wanted).abs() < 0.05 + 0.25 * wanted, "{turns}: {share} for {wanted}");
        }
        let equal = scatter(&frames(300, false)).unwrap().spectrum;
        assert!(equal.iter().all(|share| (share - 1.0).abs() < 0.3), "{equal:?}");
    }

    #[test]
    fn the_mean_of_many_frames_is_the_zero_of_offsets_that_do_not_drift() {
        let best = |frames: &[Vec<f32>]| Scatter::of_best_means(&[slices(frames)]).unwrap();
        let still = frames(300, false);
        let (count, Scatter { sd_v, .. }) = best(&still);
        assert_eq!(count, 16);
        assert!((1e3 * sd_v - (1.0 + 1.0 / 16.0f64).sqrt()).abs() < 0.03, "{sd_v}");
        assert_eq!(best(&still[..20]).0, 4, "of few frames few are a mean");
        let mut walks = still;
        for i in 1..walks.len() {
            let (earlier, later) = walks.split_at_mut(i);
            later[0].iter_mut().zip(&earlier[i - 1]).for_each(|(v, before)| *v += before);
        }
        assert_eq!(best(&walks).0, 1, "offsets that walk are those of the last frame");
    }

    #[test]
    fn no_difference_is_one_between_two_streams() {
        let mut all = frames(300, false);
        // The device of the second stream has other offsets, of 50 mV.
        let shift = |frame: &mut Vec<f32>| frame.iter_mut().step_by(2).for_each(|v| *v += 0.05);
        all[150..].iter_mut().for_each(shift);
        let streams = [slices(&all[..150]), slices(&all[150..])];
        let (count, Scatter { sd_v, .. }) = Scatter::of_best_means(&streams).unwrap();
        assert_eq!(count, 16);
        assert!((1e3 * sd_v - (1.0 + 1.0 / 16.0f64).sqrt()).abs() < 0.05, "{sd_v}");
        let one = Scatter::of_streams(&streams).unwrap();
        assert!((1e3 * one.sd_v - 2f64.sqrt()).abs() < 0.05, "{one:?}");
        let as_one = Scatter::of(&slices(&all)).unwrap();
        assert!(as_one.sd_v > 1.5 * one.sd_v, "{as_one:?}");
        let pairs = |count: usize| all.chunks(2).take(count).map(slices).collect::<Vec<_>>();
        assert_eq!(Scatter::of_streams(&pairs(LEAST_FRAMES - 2)), None, "too few differences");
        assert!(Scatter::of_streams(&pairs(LEAST_FRAMES - 1)).is_some());
    }

    #[test]
    fn a_frame_that_is_not_finite_is_skipped() {
        let sound = frames(20, true);
        let mut broken = sound.clone();
        for (at, value) in [(12, f32::NAN), (5, f32::INFINITY)] {
            broken.insert(at, vec![1e-3; PAIRS * PAIRS]);
            broken[at][3] = value;
        }
        assert_eq!(scatter(&broken), scatter(&sound));
        assert!(scatter(&sound).is_some_and(|scatter| scatter.sd_v > 0.0));
        assert_eq!(scatter(&broken[5..10]), None, "too few");
    }

    #[test]
    fn few_frames_state_little() {
        assert_eq!(scatter(&frames(4, true)), None);
        let few = scatter(&frames(6, true)).unwrap().spectrum;
        assert!(few[0] > 0.3 && few[0] < few[PAIRS / 2], "{few:?}");
        let mean = (0..PAIRS).map(|wave| few[frequency(wave)]).sum::<f64>() / PAIRS as f64;
        assert!((mean - 1.0).abs() < 1e-12, "{mean}");
        let same = vec![vec![1e-3f32; PAIRS * PAIRS]; 9];
        assert_eq!(scatter(&same), Some(Scatter { sd_v: 0.0, spectrum: Vec::new() }));
        assert_eq!(scatter(&[same, vec![Vec::new()]].concat()), None);
    }
}
