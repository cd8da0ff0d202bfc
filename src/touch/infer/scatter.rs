//! What the offsets of a readout scatter by, from one frame of the untouched skin to the next.
//! PURE. Uses: sim-core's `stats`. Never: a frame with a contact.

use sim_core::stats::pair_sums;

/// Smallest number of frames.
const LEAST_FRAMES: usize = 5;

/// Standard deviation of the change of the offset of a pair of electrodes from one frame of the untouched skin to the
/// next, V; `None` with too few frames, or of different lengths. A frame with a value that is not finite is skipped.
pub fn scatter_v(frames: &[&[f32]]) -> Option<f64> {
    let is_finite = |frame: &&[f32]| frame.iter().all(|volts| volts.is_finite());
    let frames: Vec<&[f32]> = frames.iter().copied().filter(is_finite).collect();
    let first = frames.first().filter(|_| frames.len() >= LEAST_FRAMES)?;
    if frames.iter().any(|frame| frame.len() != first.len()) {
        return None;
    }
    let mut squares = Vec::new();
    for (before, after) in frames.iter().zip(&frames[1..]) {
        let change_v: Vec<f64> = before.iter().zip(*after).map(|(a, b)| f64::from(b - a)).collect();
        squares.extend(of_pairs(&change_v).iter().map(|v| v * v));
    }
    Some((squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Mean of each pair of electrodes over the injections, V.
pub(super) fn of_pairs(frame_v: &[f64]) -> Vec<f64> {
    let sums = pair_sums(frame_v);
    let injections = sums.len() as f64;
    sums.into_iter().map(|sum| sum / injections).collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const PAIRS: usize = 28;

    /// Frames with independent offsets of 1 mV.
    fn frames(count: usize) -> Vec<Vec<f32>> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut one = || {
            let offset_v: Vec<f64> = (0..PAIRS)
                .map(|_| 1e-3 * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>())
                .collect();
            (0..PAIRS * PAIRS).map(|i| offset_v[i % PAIRS] as f32).collect()
        };
        (0..count).map(|_| one()).collect()
    }

    fn scatter(frames: &[Vec<f32>]) -> Option<f64> {
        scatter_v(&frames.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }

    #[test]
    fn the_scatter_is_that_of_changes_and_a_frame_that_is_not_finite_is_skipped() {
        let sound = frames(100);
        let sd_v = scatter(&sound).unwrap();
        assert!((1e3 * sd_v / 2f64.sqrt() - 1.0).abs() < 0.05, "{sd_v}");
        let mut broken = sound.clone();
        for (at, value) in [(12, f32::NAN), (5, f32::INFINITY)] {
            broken.insert(at, vec![1e-3; PAIRS * PAIRS]);
            broken[at][3] = value;
        }
        assert_eq!(scatter(&broken), scatter(&sound));
        assert_eq!(scatter(&broken[5..10]), None, "too few");
        let same = vec![vec![1e-3f32; PAIRS * PAIRS]; 9];
        assert_eq!(scatter(&same), Some(0.0));
        assert_eq!(scatter(&[same, vec![Vec::new()]].concat()), None);
    }
}
