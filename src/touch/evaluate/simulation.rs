//! The fit of simulated twins to measured trials: the numbers of the paper's Fig. 7B to 7F, and of each pair of
//! electrodes.
//! PURE. Uses: `store::Fit`, sim-core's quantiles. Never: the frames of all trials (the fit of each is stored with
//! its twin).

use serde::{Deserialize, Serialize};
use sim_core::stats::{median, quantile, sorted};
use utoipa::ToSchema;

use crate::ids::TrialId;
use crate::record::CONTACTS_MAX;
use crate::store::Fit;

/// Width of a bin of forces, N.
pub const FORCE_BIN_N: f64 = 1.0;
/// Forces above this are in the last bin, N: the paper's plots end here.
pub const FORCE_END_N: f64 = 50.0;
/// Mean FVU that defines the deadband: within it most of the variance is unexplained.
const DEADBAND_FVU: f64 = 0.5;
/// Width of the window over which the mean FVU is taken, N: more trials than in one bin.
const DEADBAND_WINDOW_N: f64 = 3.0;
/// Largest number of trials whose frames are compared pair by pair.
const PAIR_TRIALS: usize = 40;

/// The fit of a run's twins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SimulationReport {
    /// Number of trials in the report.
    pub trials: u64,
    /// Number of trials excluded because of a flag.
    pub flagged: u64,
    /// Number of trials by their number of contacts, 0 to 6, after the run's deadband.
    pub contact_counts: [u64; CONTACTS_MAX + 1],
    /// Median RMSE of trials with contacts, V.
    pub median_rmse_v: Option<f64>,
    /// Median FVU of trials with contacts.
    pub median_fvu: Option<f64>,
    /// Deadband, N: the lowest force from which the trials of the next 3 N have a mean FVU under
    /// 0.5. Below it the voltages hardly depend on the force.
    pub deadband_n: Option<f64>,
    /// Means by the largest force of a trial and its number of contacts (Fig. 7B, 7E).
    pub by_force: Vec<ForceBin>,
    /// Distribution by the number of contacts, 1 to 6 (Fig. 7C, 7F), without trials in the
    /// deadband.
    pub by_contacts: Vec<ContactBoxes>,
    /// Means by position, single tips above the deadband (Fig. 7D).
    pub by_point: Vec<PointFit>,
    /// Number of trials behind `by_pair`: the newest with contacts and without flags, at most 40.
    pub pair_trials: u64,
    /// Fit of the readings of each pair of neighbouring electrodes; a pair without variance is absent.
    pub by_pair: Vec<PairFit>,
}

/// Trials with a given number of contacts in one bin of forces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ForceBin {
    /// Number of contacts; all numbers if absent.
    pub contacts: Option<u8>,
    /// Lower end of the bin, N.
    pub from_n: f64,
    /// Number of trials in the bin.
    pub trials: u64,
    /// Mean RMSE, V.
    pub mean_rmse_v: f64,
    /// Mean FVU of these trials, a share.
    pub mean_fvu: f64,
}

/// Trials with a given number of contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ContactBoxes {
    /// Number of contacts.
    pub contacts: u8,
    /// Number of trials.
    pub trials: u64,
    /// Distribution of the RMSE, V.
    pub rmse_v: BoxPlot,
    /// Distribution of the FVU.
    pub fvu: BoxPlot,
}

/// Tukey's box plot: quartiles, and the outermost values within 1.5 times their distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BoxPlot {
    /// Smallest value within 1.5 times the quartiles' distance below `q1`.
    pub low: f64,
    /// First quartile: a quarter of the values is at most this.
    pub q1: f64,
    /// Median of the values, in their unit.
    pub median: f64,
    /// Third quartile: three quarters of the values are at most this.
    pub q3: f64,
    /// Largest value within 1.5 times the quartiles' distance above `q3`.
    pub high: f64,
    /// Share of values beyond the whiskers.
    pub outliers: f64,
}

/// Single tips at one position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PointFit {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// Number of trials.
    pub trials: u64,
    /// Mean FVU of these trials, a share.
    pub mean_fvu: f64,
}

/// Fit of the readings between two neighbouring electrodes, over all sinks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PairFit {
    /// The pair, from 0: the reading is the potential of the first minus that of the second.
    pub electrodes: [usize; 2],
    /// Over trials and sinks: squared differences from the twins over the variance of the readings.
    pub fvu: f64,
}

/// Returns the trials whose frames `with_frames` compares.
pub fn newest_touched(fits: &[Fit]) -> Vec<TrialId> {
    let touched = fits.iter().rev().filter(|f| !f.flagged && f.contact_count > 0);
    touched.take(PAIR_TRIALS).map(|f| f.trial).collect()
}

/// Computes the report of trials with a twin, and the fit of each pair of electrodes from the measured and the
/// simulated frames of some of them, V, injection-major.
pub fn with_frames(fits: &[Fit], frames: &[(&[f32], &[f32])]) -> SimulationReport {
    let channels = frames.first().map_or(0, |(measured, _)| measured.len());
    let electrodes = channels.isqrt();
    // The voltages of a skin that has not as many injections as pairs belong to no pair.
    let frames = if electrodes * electrodes == channels { frames } else { &frames[..0] };
    SimulationReport {
        pair_trials: frames.len() as u64,
        by_pair: pair_fits(frames, electrodes),
        ..report(fits)
    }
}

/// Eq. 2 along some trials for each pair of electrodes: its variance is that of each reading around its mean.
/// Missing channels are skipped, and pairs without variance.
///
/// `frames`: measured and simulated frame of each trial, V, injection-major.
pub fn pair_fits(frames: &[(&[f32], &[f32])], electrodes: usize) -> Vec<PairFit> {
    let fit = |pair: usize| {
        let (mut unexplained, mut variance) = (0.0, 0.0);
        for reading in (0..electrodes).map(|sink| electrodes * sink + pair) {
            let known = || {
                let both = frames.iter().filter_map(move |(measured, simulated)| {
                    Some((f64::from(*measured.get(reading)?), f64::from(*simulated.get(reading)?)))
                });
                both.filter(|(measured, simulated)| measured.is_finite() && simulated.is_finite())
            };
            let mean = known().map(|(measured, _)| measured).sum::<f64>() / known().count() as f64;
            for (measured, simulated) in known() {
                variance += (measured - mean).powi(2);
                unexplained += (measured - simulated).powi(2);
            }
        }
        let electrodes = [pair, (pair + 1) % electrodes];
        (variance > 0.0).then(|| PairFit { electrodes, fvu: unexplained / variance })
    };
    (0..electrodes).filter_map(fit).collect()
}

/// Computes the report of trials with a twin, without pairs of electrodes.
pub fn report(fits: &[Fit]) -> SimulationReport {
    let sound: Vec<&Fit> = fits.iter().filter(|f| !f.flagged).collect();
    let mut contact_counts = [0; CONTACTS_MAX + 1];
    for fit in &sound {
        contact_counts[usize::from(fit.contact_count).min(CONTACTS_MAX)] += 1;
    }
    let touched: Vec<&Fit> = sound.iter().copied().filter(|f| f.contact_count > 0).collect();
    let all_counts = by_force(&sound, None);
    let deadband_n = deadband_n(&all_counts);
    let mut bins = all_counts;
    for contacts in 0..=CONTACTS_MAX as u8 {
        let of_count: Vec<&Fit> =
            sound.iter().copied().filter(|f| f.contact_count == contacts).collect();
        bins.extend(by_force(&of_count, Some(contacts)));
    }
    SimulationReport {
        trials: sound.len() as u64,
        flagged: (fits.len() - sound.len()) as u64,
        contact_counts,
        median_rmse_v: median(touched.iter().map(|f| f.rmse_v)),
        median_fvu: median(touched.iter().filter_map(|f| f.fvu)),
        deadband_n,
        by_force: bins,
        by_contacts: (1..=CONTACTS_MAX as u8).filter_map(|n| boxes(&touched, n)).collect(),
        by_point: by_point(&touched),
        pair_trials: 0,
        by_pair: Vec::new(),
    }
}

fn bin_of(force_n: f64) -> usize {
    ((force_n.clamp(0.0, FORCE_END_N) / FORCE_BIN_N) as usize)
        .min((FORCE_END_N / FORCE_BIN_N) as usize - 1)
}

fn by_force(fits: &[&Fit], contacts: Option<u8>) -> Vec<ForceBin> {
    let mut sums = vec![(0_u64, 0.0, 0.0); (FORCE_END_N / FORCE_BIN_N) as usize];
    for fit in fits {
        if let (Some(force_n), Some(fvu)) = (fit.max_force_n, fit.fvu) {
            let sum = &mut sums[bin_of(force_n)];
            *sum = (sum.0 + 1, sum.1 + fit.rmse_v, sum.2 + fvu);
        }
    }
    sums.into_iter()
        .enumerate()
        .filter(|(_, (trials, ..))| *trials > 0)
        .map(|(bin, (trials, rmse_v, fvu))| ForceBin {
            contacts,
            from_n: bin as f64 * FORCE_BIN_N,
            trials,
            mean_rmse_v: rmse_v / trials as f64,
            mean_fvu: fvu / trials as f64,
        })
        .collect()
}

/// Lower end of the first bin from which the bins of the window have a mean below the threshold.
fn deadband_n(bins: &[ForceBin]) -> Option<f64> {
    bins.iter().enumerate().find_map(|(first, bin)| {
        let window = bins[first..].iter().take_while(|b| b.from_n < bin.from_n + DEADBAND_WINDOW_N);
        let (trials, fvu) = window.fold((0.0, 0.0), |(trials, fvu), b| {
            (trials + b.trials as f64, fvu + b.trials as f64 * b.mean_fvu)
        });
        (fvu < DEADBAND_FVU * trials).then_some(bin.from_n)
    })
}

fn boxes(touched: &[&Fit], contacts: u8) -> Option<ContactBoxes> {
    let of_count = || touched.iter().filter(move |f| f.contact_count == contacts);
    Some(ContactBoxes {
        contacts,
        trials: of_count().count() as u64,
        rmse_v: BoxPlot::of(of_count().map(|f| f.rmse_v))?,
        fvu: BoxPlot::of(of_count().filter_map(|f| f.fvu))?,
    })
}

impl BoxPlot {
    /// Computes the box plot of values; `None` without values.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let sorted = sorted(values);
        let (q1, q3) = (quantile(&sorted, 0.25)?, quantile(&sorted, 0.75)?);
        let reach = 1.5 * (q3 - q1);
        let inside = || sorted.iter().copied().filter(|v| *v >= q1 - reach && *v <= q3 + reach);
        Some(Self {
            low: inside().next()?,
            q1,
            median: quantile(&sorted, 0.5)?,
            q3,
            high: inside().next_back()?,
            outliers: 1.0 - inside().count() as f64 / sorted.len() as f64,
        })
    }
}

fn by_point(touched: &[&Fit]) -> Vec<PointFit> {
    // Positions to a tenth of a millimetre: only tips on a point are compared.
    let mut places = std::collections::BTreeMap::<[i64; 2], PointFit>::new();
    for fit in touched {
        if let (Some([x_mm, y_mm]), Some(fvu)) = (fit.single_tip_mm, fit.fvu) {
            let place = [(x_mm * 10.0).round() as i64, (y_mm * 10.0).round() as i64];
            let fresh = PointFit { x_mm, y_mm, trials: 0, mean_fvu: 0.0 };
            let point = places.entry(place).or_insert(fresh);
            point.trials += 1;
            point.mean_fvu += (fvu - point.mean_fvu) / point.trials as f64;
        }
    }
    places.into_values().collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::{BoxPlot, newest_touched, pair_fits, report, with_frames};
    use crate::ids::TrialId;
    use crate::store::Fit;

    /// The fit of a trial.
    pub fn fit(contact_count: u8, force_n: f64, fvu: f64) -> Fit {
        Fit {
            trial: TrialId(1),
            tips: 1,
            contact_count,
            max_force_n: Some(force_n),
            single_tip_mm: Some([100.0, 200.0]),
            flagged: false,
            rmse_v: 0.01,
            fvu: Some(fvu),
        }
    }

    #[test]
    fn the_deadband_ends_where_the_fit_stays_good() {
        let fits = [
            fit(0, 0.5, 1.0),
            fit(0, 2.5, 0.4), // by chance
            fit(0, 3.5, 0.9),
            fit(1, 5.5, 0.3),
            fit(1, 8.5, 0.2),
            fit(1, 99.0, 0.1),
        ];
        let report = report(&fits);
        assert_eq!(report.deadband_n, Some(5.0));
        assert_eq!(report.contact_counts, [3, 3, 0, 0, 0, 0, 0]);
        assert_eq!(report.median_fvu, Some(0.2));
        let [point] = &report.by_point[..] else { panic!("one place") };
        assert_eq!(point.trials, 3);
        assert!((point.mean_fvu - 0.2).abs() < 1e-12);
    }

    #[test]
    fn flagged_trials_are_left_out_and_counted() {
        let bad = Fit { flagged: true, ..fit(1, 20.0, 9.0) };
        let report = report(&[fit(1, 20.0, 0.1), bad]);
        assert_eq!((report.trials, report.flagged), (1, 1));
        assert_eq!(report.median_fvu, Some(0.1));
    }

    #[test]
    fn pairs_are_those_of_the_newest_sound_trials_and_skip_missing_channels() {
        let numbered = |n: i64| Fit { trial: TrialId(n), ..fit(1, 20.0, 0.1) };
        let mut fits: Vec<Fit> = (1..=50).map(numbered).collect();
        fits[48].flagged = true;
        fits[49].contact_count = 0;
        let newest = newest_touched(&fits);
        assert_eq!((newest.len(), newest[0], newest[39]), (40, TrialId(48), TrialId(9)));
        // Two electrodes; the last reading of the twin is off by 1 V, and missing in the third trial.
        let measured =
            [[1.0_f32, -1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0], [0.0, 0.0, 0.0, f32::NAN]];
        let simulated = measured.map(|[a, b, c, d]| [a, b, c, d + 1.0]);
        let frames: Vec<(&[f32], &[f32])> =
            measured.iter().zip(&simulated).map(|(m, s)| (&m[..], &s[..])).collect();
        let report = with_frames(&fits, &frames);
        assert_eq!((report.trials, report.pair_trials), (49, 3));
        let pairs: Vec<_> = report.by_pair.iter().map(|p| (p.electrodes, p.fvu)).collect();
        assert_eq!(pairs, [([0, 1], 0.0), ([1, 0], 0.5)]);
        assert!(pair_fits(&[], 2).is_empty());
        assert!(with_frames(&fits, &[]).by_pair.is_empty());
        let pad = [[1.0_f32, 2.0, 3.0], [2.0, 1.0, 3.0]];
        let frames: Vec<(&[f32], &[f32])> = pad.iter().map(|v| (&v[..], &v[..])).collect();
        let report = with_frames(&fits, &frames);
        assert_eq!((report.pair_trials, report.by_pair), (0, vec![]), "three voltages, no pair");
    }

    #[test]
    fn nothing_measured_gives_no_numbers() {
        let report = report(&[]);
        assert_eq!((report.median_fvu, report.deadband_n), (None, None));
        assert!(report.by_contacts.is_empty());
    }

    #[test]
    fn a_box_has_its_whiskers_within_reach() {
        let values = [1.0, 2.0, 3.0, 4.0, 100.0];
        let b = BoxPlot::of(values.into_iter()).unwrap();
        assert_eq!((b.low, b.q1, b.median, b.q3, b.high), (1.0, 2.0, 3.0, 4.0, 4.0));
        assert!((b.outliers - 0.2).abs() < 1e-12);
    }
}
