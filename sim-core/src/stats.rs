//! Quantiles of samples; the norm of a frame, its fraction of variance unexplained, and its sums over the injections;
//! waves around a ring of numbers.
//! Uses: nothing. Never: weights, missing values (callers remove them).
//!
//! There are two quantiles. [`quantile`] interpolates and is that of every reported number.
//! [`upper_quantile`] returns a value of the sample; noise, limits and factors that earlier results
//! depend on were determined with it, and the two differ for an even number of values.
//!
//! NaN: a quantile or median of values with a NaN is NaN, as in numpy.

/// Returns the values in ascending order of `f64::total_cmp`, as the quantiles take them.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// Quantile of sorted values in their unit, interpolated linearly between the neighbours of position
/// `share (n - 1)` (type 7 of Hyndman and Fan; the default of numpy and R). `None` without values.
///
/// `sorted`: `n` values from [`sorted`]. `share`: 0 to 1.
///
/// # Panics
/// If `share` is not within 0 to 1.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    check(sorted, share);
    let place = share * (sorted.len().checked_sub(1)? as f64);
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    // The difference of two infinite values would be NaN.
    let between = if low == high { low } else { low + (high - low) * place.fract() };
    Some(nan(sorted).unwrap_or(between))
}

/// Quantile of sorted values without interpolation: the value with index `floor(share n)`, counted
/// from 0, at most the last one. For a share of 0.5 it is the middle value, or the upper one of two.
/// `None` without values.
///
/// `sorted`: `n` values from [`sorted`]. `share`: 0 to 1.
///
/// # Panics
/// If `share` is not within 0 to 1.
pub fn upper_quantile(sorted: &[f64], share: f64) -> Option<f64> {
    check(sorted, share);
    let last = sorted.len().checked_sub(1)?;
    let at = (share * sorted.len() as f64) as usize;
    Some(nan(sorted).unwrap_or(sorted[at.min(last)]))
}

/// Median of values in any order: [`quantile`] with a share of 0.5, the mean of the middle two for an
/// even number of values. `None` without values.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    quantile(&sorted(values), 0.5)
}

/// Sums of a frame over its injections: one per pair of electrodes, in the unit of the frame.
///
/// `frame`: a value per channel, injection-major, as many injections as pairs.
pub fn pair_sums(frame: &[f64]) -> Vec<f64> {
    let pairs = frame.len().isqrt().max(1);
    let mut sums = vec![0.0; pairs];
    for injection in frame.chunks(pairs) {
        sums.iter_mut().zip(injection).for_each(|(sum, value)| *sum += value);
    }
    sums
}

/// Orthonormal waves around a ring of `count` numbers: the constant one, then cosine and sine of each frequency.
pub fn waves(count: usize) -> Vec<Vec<f64>> {
    let wave = |index: usize| -> Vec<f64> {
        let turn = std::f64::consts::TAU * frequency(index) as f64 / count as f64;
        let alone = index == 0 || 2 * frequency(index) == count;
        let height = ((if alone { 1.0 } else { 2.0 }) / count as f64).sqrt();
        let value = |at: usize| {
            let angle = turn * at as f64;
            height * if index == 0 || index % 2 == 1 { angle.cos() } else { angle.sin() }
        };
        (0..count).map(value).collect()
    };
    (0..count).map(wave).collect()
}

/// Frequency of a wave of [`waves`]: its number of turns around the ring.
pub fn frequency(wave: usize) -> usize {
    wave.div_ceil(2)
}

/// Fraction of variance unexplained of one frame (paper, Eq. 2): the sum of squared differences over
/// that of the measured voltages around their mean. `None` if the measured frame is constant or empty.
///
/// `measured_v`, `modelled_v`: voltages of the same channels, V.
pub fn fvu(measured_v: &[f32], modelled_v: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mean = measured_v.iter().map(|&v| f64::from(v)).sum::<f64>() / measured_v.len() as f64;
    let around_mean = || std::iter::repeat(mean);
    let variance = squared_error(measured_v, around_mean());
    (variance > 0.0).then(|| squared_error(measured_v, modelled_v) / variance)
}

/// Sum of squared differences of a measured and a modelled frame, V^2; shapes as for [`fvu`].
pub fn squared_error(measured_v: &[f32], modelled_v: impl IntoIterator<Item = f64>) -> f64 {
    let pairs = measured_v.iter().zip(modelled_v);
    pairs.map(|(&measured, modelled)| (f64::from(measured) - modelled).powi(2)).sum()
}

/// Euclidean norm of a frame, in its unit.
pub fn norm(frame: &[f32]) -> f64 {
    frame.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt()
}

fn check(sorted: &[f64], share: f64) {
    assert!((0.0..=1.0).contains(&share), "a share is 0 to 1, not {share}");
    debug_assert!(sorted.is_sorted_by(|a, b| a.total_cmp(b).is_le()), "the values are not sorted");
}

/// A NaN of sorted values: `f64::total_cmp` moves it to an end, which one depends on its sign.
fn nan(sorted: &[f64]) -> Option<f64> {
    [sorted.first(), sorted.last()].into_iter().flatten().copied().find(|value| value.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_type_7() {
        // numpy.quantile([1, 2, 4, 8], [0, 0.1, 0.25, 0.5, 0.75, 0.9, 1]).
        let expected = [1.0, 1.3, 1.75, 3.0, 5.0, 6.8, 8.0];
        for (share, expected) in [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0].into_iter().zip(expected) {
            let found = quantile(&[1.0, 2.0, 4.0, 8.0], share).unwrap();
            assert!((found - expected).abs() < 1e-12, "{share}: {found}");
        }
        assert_eq!(quantile(&[7.0], 0.99), Some(7.0));
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn medians_take_values_in_any_order() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(2.5));
        assert_eq!(median([]), None);
    }

    #[test]
    fn an_upper_quantile_is_a_value_of_the_sample() {
        let values = [1.0, 2.0, 4.0, 8.0];
        let found =
            [0.0, 0.2, 0.25, 0.5, 0.75, 0.9, 1.0].map(|share| upper_quantile(&values, share));
        assert_eq!(found, [1.0, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0].map(Some));
        assert_eq!(upper_quantile(&[1.0, 2.0, 4.0], 0.5), Some(2.0));
        assert_eq!(upper_quantile(&[], 0.5), None);
    }

    #[test]
    fn a_nan_of_either_sign_makes_quantiles_nan() {
        for nan in [f64::NAN, -f64::NAN] {
            assert!(median([1.0, nan, 2.0]).unwrap().is_nan());
            assert!(upper_quantile(&sorted([1.0, nan, 2.0]), 0.5).unwrap().is_nan());
        }
    }

    #[test]
    fn infinite_values_are_values() {
        assert_eq!(median([f64::INFINITY, 1.0, f64::INFINITY]), Some(f64::INFINITY));
        assert_eq!(median([f64::INFINITY; 2]), Some(f64::INFINITY));
    }

    #[test]
    #[should_panic(expected = "a share is 0 to 1")]
    fn a_percentage_is_no_share() {
        quantile(&[1.0, 2.0], 50.0);
    }

    #[test]
    fn waves_are_orthonormal_and_turn_as_often_as_stated() {
        for count in [1, 2, 5, 28] {
            let waves = waves(count);
            for (i, a) in waves.iter().enumerate() {
                for (j, b) in waves.iter().enumerate() {
                    let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    let wanted = f64::from(u8::from(i == j));
                    assert!((product - wanted).abs() < 1e-12, "{count}: {i} {j} {product}");
                }
            }
        }
        assert_eq!([0, 1, 2, 3, 26, 27].map(frequency), [0, 1, 1, 2, 13, 14]);
        let turns = |wave: &[f64]| wave.windows(2).filter(|v| v[0] * v[1] < 0.0).count();
        let waves = waves(28);
        assert_eq!((turns(&waves[0]), turns(&waves[27])), (0, 27));
    }

    #[test]
    fn a_norm_is_that_of_all_values() {
        assert_eq!((norm(&[3.0, -4.0]), norm(&[])), (5.0, 0.0));
    }

    #[test]
    fn a_pair_is_summed_over_the_injections() {
        assert_eq!(pair_sums(&[1.0, 10.0, 2.0, 30.0]), [3.0, 40.0]);
        assert_eq!(pair_sums(&[]), [0.0]);
    }

    #[test]
    fn a_perfect_model_leaves_nothing_and_the_mean_explains_nothing() {
        let measured = [1.0, 2.0, 3.0, 6.0];
        assert_eq!(fvu(&measured, [1.0, 2.0, 3.0, 6.0]), Some(0.0));
        assert_eq!(fvu(&measured, [3.0; 4]), Some(1.0));
        // Calculated manually: (0.25 + 0 + 1 + 0.25) / (4 + 1 + 0 + 9).
        assert_eq!(fvu(&measured, [1.5, 2.0, 2.0, 6.5]), Some(1.5 / 14.0));
    }

    #[test]
    fn a_constant_frame_has_no_variance_to_explain() {
        assert_eq!(fvu(&[2.0; 3], [1.0; 3]), None);
        assert_eq!(fvu(&[], []), None);
        assert_eq!(squared_error(&[2.0; 3], [1.0; 3]), 3.0);
    }
}
