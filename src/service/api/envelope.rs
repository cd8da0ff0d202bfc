//! Fewer samples of the load cells with the same extremes, for pictures.
//! PURE. Uses: `campaign::shown::samples`. Never: a smoothed value.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::campaign::shown::samples::ForceSample;
use crate::record::ARMS;

/// Samples of the load cells, oldest first; one entry of each list per sample. Where samples were
/// combined, two entries have the extremes of each value in the order of their occurrence, at the times
/// of the first and the last of these samples.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SamplesOut {
    /// Wall times, ms since 1970.
    pub at_ms: Vec<i64>,
    /// Machine z, mm, rounded to 1 um; null if z was not read with the sample.
    pub z_mm: Vec<Option<f64>>,
    /// Forces of arms 1 to 6 after subtraction of the tare, N, rounded to 1 mN; null for a disconnected
    /// cell.
    pub forces_n: Vec<[Option<f64>; ARMS]>,
}

impl SamplesOut {
    /// Returns the samples as columns.
    pub fn of(samples: &[ForceSample]) -> Self {
        let thousandths = |value: Option<f64>| value.map(|v| (v * 1e3).round() / 1e3);
        Self {
            at_ms: samples.iter().map(|s| s.at_ms).collect(),
            z_mm: samples.iter().map(|s| thousandths(s.z_mm)).collect(),
            forces_n: samples.iter().map(|s| s.forces_n.map(thousandths)).collect(),
        }
    }
}

/// Returns at most `most` samples, at least 2, with the extremes of each value.
pub fn envelope(samples: &[ForceSample], most: usize) -> Vec<ForceSample> {
    if samples.len() <= most.max(2) {
        return samples.to_vec();
    }
    let pieces = (most / 2).max(1);
    let at = |piece: usize| piece * samples.len() / pieces;
    (0..pieces).flat_map(|piece| combined(&samples[at(piece)..at(piece + 1)])).collect()
}

/// Two samples with the extremes of each value of some samples; these themselves if they are fewer.
fn combined(samples: &[ForceSample]) -> Vec<ForceSample> {
    let [first, .., last] = samples else { return samples.to_vec() };
    let z_mm = extremes(samples.iter().map(|s| s.z_mm));
    let forces_n: [_; ARMS] =
        std::array::from_fn(|arm| extremes(samples.iter().map(|s| s.forces_n[arm])));
    let of = |at_ms, n: usize| ForceSample {
        at_ms,
        z_mm: z_mm[n],
        forces_n: forces_n.map(|extremes| extremes[n]),
    };
    vec![of(first.at_ms, 0), of(last.at_ms, 1)]
}

/// Smallest and largest value, in the order of their occurrence; `None` without values.
fn extremes(values: impl Iterator<Item = Option<f64>>) -> [Option<f64>; 2] {
    let known = || values.enumerate().filter_map(|(i, value)| Some((i, value?)));
    let mut all = known();
    let Some(first) = all.next() else { return [None; 2] };
    let (mut least, mut most) = (first, first);
    for value in all {
        if value.1 < least.1 {
            least = value;
        }
        if value.1 > most.1 {
            most = value;
        }
    }
    if least.0 <= most.0 { [Some(least.1), Some(most.1)] } else { [Some(most.1), Some(least.1)] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(count: usize) -> Vec<ForceSample> {
        let sample = |i: usize| ForceSample {
            at_ms: i as i64,
            z_mm: (i.is_multiple_of(3)).then_some(i as f64),
            forces_n: [Some((i as f64).sin()), None, Some(-(i as f64)), None, None, None],
        };
        (0..count).map(sample).collect()
    }

    fn bounds(samples: &[ForceSample], value: impl Fn(&ForceSample) -> Option<f64>) -> [f64; 2] {
        let known = || samples.iter().filter_map(&value);
        [known().fold(f64::MAX, f64::min), known().fold(f64::MIN, f64::max)]
    }

    #[test]
    fn fewer_samples_have_the_same_extremes() {
        for (count, most) in [(1001, 50), (51, 50), (3, 2), (7, 3), (5, 0)] {
            let all = samples(count);
            let few = envelope(&all, most);
            assert!(few.len() <= most.max(2), "{count}, {most}: {}", few.len());
            assert!(few.is_sorted_by_key(|s| s.at_ms));
            let values: [fn(&ForceSample) -> Option<f64>; 3] =
                [|s| s.z_mm, |s| s.forces_n[0], |s| s.forces_n[2]];
            for value in values {
                assert_eq!(bounds(&few, value), bounds(&all, value), "{count}, {most}");
            }
            assert!(few.iter().all(|s| s.forces_n[1].is_none()));
        }
        assert_eq!(envelope(&samples(50), 50), samples(50));
        assert_eq!(envelope(&[], 50), []);
    }

    #[test]
    fn extremes_keep_their_order() {
        let of = |values: &[f64]| extremes(values.iter().map(|v| Some(*v)));
        assert_eq!(of(&[2.0, 9.0, 1.0]), [Some(9.0), Some(1.0)]);
        assert_eq!(of(&[2.0, 1.0, 9.0, 3.0]), [Some(1.0), Some(9.0)]);
        assert_eq!(extremes([None, Some(4.0), None].into_iter()), [Some(4.0); 2]);
    }
}
