//! Judgement of a fitted skin on held-out trials: whether it explains them better than the model before the fit.
//! PURE. Uses: `plain`, sim-core's quantiles and evidence of a skin. Never: the fit, files.

use serde::Serialize;
use sim_core::skin::{SkinEvidence, rounded};
use sim_core::stats;

use crate::plain::counted;

/// FVU from which a model explains nothing of a frame.
const UNEXPLAINED: f64 = 1.0;
/// At most one held-out trial of this many, rounded up, is an outlier.
const OUTLIERS_IN: usize = 20;
/// Number of trials that was enough on every skin of `docs/figures.md`: 1,200 with contacts and 200 untouched ones.
const ENOUGH_TRIALS: &str = "1,400";

/// A statistic of the FVU of held-out trials.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Change {
    /// With the model that the fit began from.
    pub before: f64,
    /// With the fitted skin.
    pub after: f64,
}

impl Change {
    fn is_lower(self) -> bool {
        self.after < self.before
    }
}

/// Whether a fitted skin explains held-out trials better than the model before the fit, and by what.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Judgement {
    /// Whether median and mean are lower after the fit.
    pub better: bool,
    /// Number of held-out trials.
    pub held_out: usize,
    /// Median FVU of all held-out trials.
    pub median: Change,
    /// Number of trials that the mean excludes, since the model before the fit explains nothing of them.
    pub outliers: usize,
    /// Mean FVU of the other held-out trials.
    pub mean: Change,
}

/// Judges a fit by the FVU of each held-out trial before and after it, in the same order.
///
/// Median and mean must be lower. The median does not depend on how wrong the skin is on nearly half of the
/// trials: a fit to few trials is good next to their positions and can be far off elsewhere. The mean depends on
/// it, and also on a single trial with a wrong label or frame. Of such a trial the model before the fit explains
/// nothing, either: the mean excludes the worst such trials, one in twenty at most. A trial that only the fit made
/// bad remains.
pub fn judge(before: &[f64], after: &[f64]) -> Judgement {
    let mut pairs: Vec<[f64; 2]> = before.iter().zip(after).map(|(&b, &a)| [b, a]).collect();
    pairs.sort_by(|one, other| other[0].total_cmp(&one[0]));
    let most = pairs.len().div_ceil(OUTLIERS_IN);
    let outliers = pairs.iter().take(most).take_while(|pair| pair[0] >= UNEXPLAINED).count();
    let others = &pairs[outliers..];
    let median = |side: usize| stats::median(pairs.iter().map(|pair| pair[side]));
    let mean =
        |side: usize| others.iter().map(|pair| pair[side]).sum::<f64>() / others.len() as f64;
    let median = [0, 1].map(|side| rounded(median(side).unwrap_or(f64::NAN)));
    let mean = [0, 1].map(|side| rounded(mean(side)));
    let [median, mean] = [median, mean].map(|[before, after]| Change { before, after });
    let better = median.is_lower() && mean.is_lower();
    Judgement { better, held_out: pairs.len(), median, outliers, mean }
}

impl Judgement {
    /// Name of the judged mean: which trials it excludes.
    pub fn mean_name(&self) -> String {
        match self.outliers {
            0 => "mean".to_owned(),
            some => format!("mean without {}", counted(some as u64, "outlier", "outliers")),
        }
    }

    /// Why the skin of a fit that is not better is not written, and what to do: one sentence.
    pub fn refusal(&self) -> String {
        let (name, Change { before, after }) = match self.median.is_lower() {
            false => ("median".to_owned(), self.median),
            true => (self.mean_name(), self.mean),
        };
        format!(
            "the fitted skin explains {} held-out trials no better than the model before the fit, and is \
             not written: {name} FVU {before:.3} before and {after:.3} after; fit more trials at more \
             positions, by a longer run or --trials: {ENOUGH_TRIALS} were enough on the skins measured",
            self.held_out,
        )
    }
}

/// What limits the answers of a skin, by the stored evidence of its fit: `None` if neither mean nor median of all
/// held-out trials is higher than before the fit. A mean that rose only by outliers is stated, too: the evidence
/// does not name them.
pub fn limitation(evidence: &SkinEvidence) -> Option<String> {
    let SkinEvidence { trials, held_out, before, after, .. } = evidence;
    if after.mean <= before.mean && after.median <= before.median {
        return None;
    }
    Some(format!(
        "the skin explains some of {held_out} held-out trials worse than the model before its fit: mean \
         FVU {:.3} before and {:.3} after, median {:.3} and {:.3}; it was fitted to {trials} trials, and \
         {ENOUGH_TRIALS} at more positions were enough on the skins measured: calibrate again",
        before.mean, after.mean, before.median, after.median,
    ))
}

#[cfg(test)]
mod tests {
    use sim_core::inverse::skin::summary;

    use super::*;

    /// Median and mean are 0.15.
    const BEFORE: [f64; 10] = [0.12, 0.15, 0.18, 0.11, 0.14, 0.16, 0.13, 0.17, 0.15, 0.19];

    /// FVU of trials that are explained well, except for the last one.
    fn good_except(last: f64) -> [f64; 10] {
        let mut after = [0.01; 10];
        after[9] = last;
        after
    }

    fn evidence(before: &[f64], after: &[f64]) -> SkinEvidence {
        let of = |fvus: &[f64]| summary(fvus).unwrap();
        SkinEvidence {
            run: "0199".into(),
            label: "virtual".into(),
            data_sha256: "22".into(),
            model: "sim-0".into(),
            trials: 54,
            held_out: before.len(),
            doubted: 0,
            noise_v: 1.2e-3,
            model_error: 0.02,
            before: of(before),
            after: of(after),
        }
    }

    #[test]
    fn a_fit_that_lowers_median_and_mean_is_better_and_has_no_limitation() {
        let after = good_except(0.11);
        let judged = judge(&BEFORE, &after);
        assert!(judged.better && (judged.held_out, judged.outliers) == (10, 0), "{judged:?}");
        assert_eq!(judged.median, Change { before: 0.15, after: 0.01 });
        assert_eq!(judged.mean, Change { before: 0.15, after: 0.02 });
        assert_eq!(limitation(&evidence(&BEFORE, &after)), None);
    }

    #[test]
    fn a_fit_that_is_far_off_somewhere_is_no_better_whatever_its_median() {
        let after = good_except(6.21);
        let judged = judge(&BEFORE, &after);
        assert!(judged.median.is_lower() && !judged.better, "{judged:?}");
        let words = judged.refusal();
        assert!(words.starts_with("the fitted skin explains 10 held-out trials no "), "{words}");
        assert!(words.contains(": mean FVU 0.150 before and 0.630 after; fit more"), "{words}");
        let words = limitation(&evidence(&BEFORE, &after)).unwrap();
        assert!(words.contains("mean FVU 0.150 before and 0.630 after, median 0.150 and 0.010"));
        assert!(words.contains("fitted to 54 trials, and 1,400 at more positions"), "{words}");
    }

    #[test]
    fn a_trial_that_was_measured_wrongly_does_not_decide() {
        let mut before = BEFORE;
        before[9] = 1.2;
        let judged = judge(&before, &good_except(7.0));
        assert!(judged.better && judged.outliers == 1, "{judged:?}");
        assert_eq!(judged.mean, Change { before: 0.1456, after: 0.01 });
        assert_eq!(judged.mean_name(), "mean without 1 outlier");
        // Nor does it hide that all others became worse.
        before[9] = 9.0;
        let mut after = [0.2; 10];
        after[9] = 2.0;
        assert!(!judge(&before, &after).better);
    }

    #[test]
    fn one_trial_in_twenty_is_an_outlier_at_most() {
        let outliers = |trials: usize| judge(&vec![1.5; trials], &vec![0.1; trials]).outliers;
        assert_eq!([5, 20, 21, 300].map(outliers), [1, 1, 2, 15]);
    }

    #[test]
    fn the_median_is_judged_too_and_equal_is_no_better() {
        let mut after = [0.16; 10];
        after[..4].fill(0.01);
        let judged = judge(&BEFORE, &after);
        assert!(judged.mean.is_lower() && !judged.better, "{judged:?}");
        let words = judged.refusal();
        assert!(words.contains(": median FVU 0.150 before and 0.160 after"), "{words}");
        assert!(!judge(&BEFORE, &BEFORE).better && !judge(&[], &[]).better);
    }
}
