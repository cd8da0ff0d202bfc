//! From a run's trials to a calibrated skin: the selection of trials, the fit, and its accuracy on
//! held-out trials.
//! PURE. Uses: `judgement`, sim-core's `inverse::skin`, sha2. Never: files, requests for trials.

use std::collections::BTreeMap;
use std::sync::Arc;

use sha2::{Digest, Sha256};
use sim_core::forward::{Contact, ForwardModel};
use sim_core::inverse::skin::{
    self, MeasuredTrial, SkinFit, SkinFitError, SkinFitOptions, SkinProgress,
};
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;
use sim_core::skin::{SkinCalibration, SkinEvidence, rounded};

use super::judgement::{Judgement, judge};
use crate::digest::Hashing;
use crate::ids::RunUid;
use crate::record::Label;

/// One configuration of this many is held out.
pub const HELD_OUT_IN: u64 = 5;
/// Largest number of untouched skins, in addition to the fitted trials: the offsets are their mean,
/// with an error of a fourteenth of a frame's noise.
const UNTOUCHED: usize = 200;
/// Smallest number of trials for a fit.
pub const LEAST_TRIALS: usize = 50;
/// Smallest number of held-out trials: of fewer a single one judges the fit.
pub const LEAST_HELD_OUT: usize = 5;
/// Sides of a stratum: position, mm, and force, N.
const STRATUM_MM: f64 = 90.0;
const STRATUM_N: f64 = 10.0;
/// Positions closer than this are the same, mm: repeats of a configuration.
const REPEATED_MM: f64 = 1.0;

/// A trial that may be used: its contacts, without its frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Id of the trial.
    pub trial: i64,
    /// Positions of its tips, mm, whether they press or not: repeats of a configuration are equal.
    pub tips_mm: Vec<[f64; 2]>,
    /// Contacts that pressed the skin.
    pub contacts: Vec<Contact>,
}

/// Trials for the fit and for its validation, as indices.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Choice {
    /// For the fit; untouched skins among them determine the readout's offsets.
    pub fitted: Vec<usize>,
    /// Held out, none of a configuration that is fitted.
    pub held_out: Vec<usize>,
}

/// Chooses up to `wanted` trials to fit and a quarter of that number to hold out, spread evenly
/// over number of contacts, position and force of the strongest; and some untouched skins. A
/// contact has at least `least_n`; trials with weaker ones only are skipped. The same candidates
/// give the same choice, in any order.
pub fn choose(candidates: &[Candidate], wanted: usize, least_n: f64) -> Choice {
    let mut sides = [BTreeMap::new(), BTreeMap::new()];
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by_key(|&i| scrambled(candidates[i].trial.to_le_bytes()));
    for &i in &order {
        let candidate = &candidates[i];
        let Some(stratum) = stratum(&candidate.contacts, least_n) else { continue };
        let held_out = is_held_out(&candidate.tips_mm);
        sides[usize::from(held_out)].entry(stratum).or_insert_with(Vec::new).push(i);
    }
    let [fitted, held_out] = sides;
    let (mut fitted, held_out) = (dealt(fitted, wanted), dealt(held_out, wanted.div_ceil(4)));
    fitted.extend(order.into_iter().filter(|&i| candidates[i].contacts.is_empty()).take(UNTOUCHED));
    fitted.sort_unstable();
    Choice { fitted, held_out }
}

/// Takes one trial of each stratum in turn, then a second of each, up to `wanted`. The order is
/// random: if there are more strata than wanted trials, all counts, positions and forces are still
/// represented.
fn dealt(strata: BTreeMap<Stratum, Vec<usize>>, wanted: usize) -> Vec<usize> {
    let mut strata: Vec<(Stratum, Vec<usize>)> = strata.into_iter().collect();
    strata.sort_by_key(|(stratum, _)| scrambled(stratum.iter().flat_map(|n| n.to_le_bytes())));
    let deepest = strata.iter().map(|(_, of)| of.len()).max().unwrap_or(0);
    let rounds =
        (0..deepest).flat_map(|round| strata.iter().filter_map(move |(_, of)| of.get(round)));
    let mut chosen: Vec<usize> = rounds.take(wanted).copied().collect();
    chosen.sort_unstable();
    chosen
}

/// Number of contacts; cell of position and force of the strongest one.
type Stratum = [usize; 4];

fn stratum(contacts: &[Contact], least_n: f64) -> Option<Stratum> {
    let pressing = || contacts.iter().filter(|c| c.force_n >= least_n);
    let strongest = pressing().max_by(|a, b| a.force_n.total_cmp(&b.force_n))?;
    let cell = |value: f64, side: f64| (value / side) as usize;
    Some([
        pressing().count(),
        cell(strongest.x_mm, STRATUM_MM),
        cell(strongest.y_mm, STRATUM_MM),
        cell(strongest.force_n, STRATUM_N),
    ])
}

/// Whether trials with tips at these positions are held out from fits, whether they press or not.
pub fn is_held_out(tips_mm: &[[f64; 2]]) -> bool {
    configuration(tips_mm).is_multiple_of(HELD_OUT_IN)
}

/// A number for the positions of the tips.
fn configuration(tips_mm: &[[f64; 2]]) -> u64 {
    let step = |mm: f64| (mm / REPEATED_MM).round() as i64;
    let mut places: Vec<[i64; 2]> = tips_mm.iter().map(|&[x, y]| [step(x), step(y)]).collect();
    places.sort_unstable();
    scrambled(places.iter().flatten().flat_map(|n| n.to_le_bytes()))
}

/// A pseudorandom number from bytes.
fn scrambled(bytes: impl IntoIterator<Item = u8>) -> u64 {
    let bytes: Vec<u8> = bytes.into_iter().collect();
    let digest = Sha256::digest(&bytes);
    u64::from_le_bytes(std::array::from_fn(|i| digest[i]))
}

/// Origin of the trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source {
    /// Uid of the run.
    pub run: RunUid,
    /// Label of the rig.
    pub label: Label,
}

/// A fitted skin with the numbers behind its accuracy.
#[derive(Debug, Clone)]
pub struct CalibratedSkin {
    /// Result for the calibration file.
    pub skin: SkinCalibration,
    /// FVU of each held-out trial before the fit.
    pub before: Vec<f64>,
    /// FVU of each held-out trial after the fit.
    pub after: Vec<f64>,
    /// Whether the fit is better than its start, by these.
    pub judgement: Judgement,
    /// Number of fitted parameters.
    pub parameters: usize,
    /// Cost before the first step and after each that was kept; it may rise where electrodes were moved.
    pub costs: Vec<f64>,
}

/// Why a run does not yield a calibrated skin.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum SkinError {
    #[error(
        "run {run}: {fitted} trials to fit and {held_out} of other configurations to hold out; a \
         skin needs at least {LEAST_TRIALS} and {LEAST_HELD_OUT}"
    )]
    TooFew { run: RunUid, fitted: usize, held_out: usize },
    #[error(transparent)]
    Fit(#[from] SkinFitError),
}

/// Fits a skin to trials and evaluates it on held-out ones. `sensor` describes all such skins (its
/// file, and an earlier calibration of Eq. 1 and moduli); `responses` are those of the sensor.
///
/// # Errors
/// `SkinError::TooFew` if there are too few trials; `Fit` if the fit fails.
pub fn calibrate(
    sensor: &Sensor,
    responses: &Arc<UnitResponses>,
    [fitted, held_out]: [&[MeasuredTrial]; 2],
    source: Source,
    options: &SkinFitOptions,
    progress: &mut dyn FnMut(SkinProgress),
) -> Result<CalibratedSkin, SkinError> {
    if fitted.len() < LEAST_TRIALS || held_out.len() < LEAST_HELD_OUT {
        let (fitted, held_out) = (fitted.len(), held_out.len());
        return Err(SkinError::TooFew { run: source.run, fitted, held_out });
    }
    let start = ForwardModel::new(sensor, Arc::clone(responses)).map_err(SkinFitError::from)?;
    let fit = skin::fit(sensor, Arc::clone(responses), fitted, options, progress)?;
    let model = fit.model(sensor, Arc::clone(responses)).map_err(SkinFitError::from)?;
    let before = skin::fvus(&start, held_out).map_err(SkinFitError::from)?;
    let after = skin::fvus(&model, held_out).map_err(SkinFitError::from)?;
    let SkinFit { fields, electrodes, offsets_mv, parameters, costs, doubted } = fit;
    let of = |fvus: &[f64]| skin::summary(fvus).expect("there are held-out trials");
    let evidence = SkinEvidence {
        run: source.run.to_string(),
        label: source.label.as_str().into(),
        data_sha256: data_sha256(fitted.iter().chain(held_out)),
        model: start.model_hash().into(),
        trials: fitted.len(),
        held_out: held_out.len(),
        doubted: doubted.len(),
        noise_v: rounded(options.errors.noise_v),
        model_error: rounded(options.errors.model_error),
        before: of(&before),
        after: of(&after),
    };
    let skin = SkinCalibration { offsets_mv, evidence, electrodes, fields };
    let judgement = judge(&before, &after);
    Ok(CalibratedSkin { skin, before, after, judgement, parameters, costs })
}

/// sha256 over contacts and frames, in order.
fn data_sha256<'a>(trials: impl Iterator<Item = &'a MeasuredTrial>) -> String {
    let mut digest = Hashing::default();
    for trial in trials {
        digest.update((trial.contacts.len() as u64).to_le_bytes());
        digest_trial(&mut digest, &trial.contacts, &trial.frame_v);
    }
    digest.finish()
}

/// Adds the contacts of a trial and its frame, V, to a digest.
pub fn digest_trial(digest: &mut Hashing, contacts: &[Contact], frame_v: &[f32]) {
    for contact in contacts {
        for value in [contact.x_mm, contact.y_mm, contact.force_n] {
            digest.update(value.to_le_bytes());
        }
    }
    frame_v.iter().for_each(|v| digest.update(v.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::paper::{self, MODEL};

    /// Tips at random positions of a small lattice, some of them barely touching.
    fn candidates(count: i64) -> Vec<Candidate> {
        (0..count)
            .map(|trial| {
                let draw =
                    |k: u64| scrambled([trial as u64, k].iter().flat_map(|n| n.to_le_bytes()));
                let tips: Vec<Contact> = (0..1 + draw(0) % 3)
                    .map(|tip| Contact {
                        x_mm: 60.0 + 60.0 * (draw(1) % 4) as f64 + 80.0 * tip as f64,
                        y_mm: 60.0 + 60.0 * (draw(2) % 4) as f64,
                        force_n: 0.5 * (draw(3 + tip) % 90) as f64,
                    })
                    .collect();
                Candidate {
                    trial,
                    tips_mm: tips.iter().map(|t| [t.x_mm, t.y_mm]).collect(),
                    contacts: tips.into_iter().filter(|t| t.force_n > 0.1).collect(),
                }
            })
            .collect()
    }

    #[test]
    fn no_configuration_is_on_both_sides_and_every_trial_has_a_contact() {
        let candidates = candidates(3000);
        let choice = choose(&candidates, 400, 5.0);
        assert!((405..=600).contains(&choice.fitted.len()) && choice.held_out.len() == 100);
        let stands = |side: &[usize]| -> Vec<u64> {
            side.iter().map(|&i| configuration(&candidates[i].tips_mm)).collect()
        };
        let fitted = stands(&choice.fitted);
        assert!(stands(&choice.held_out).iter().all(|c| !fitted.contains(c)));
        for &i in choice.fitted.iter().chain(&choice.held_out) {
            let contacts = &candidates[i].contacts;
            assert!(contacts.is_empty() || contacts.iter().any(|c| c.force_n >= 5.0));
        }
        let untouched =
            |side: &[usize]| side.iter().filter(|&&i| candidates[i].contacts.is_empty()).count();
        assert!(untouched(&choice.fitted) > 5 && untouched(&choice.held_out) == 0);
    }

    #[test]
    fn strata_are_filled_evenly_and_the_order_of_trials_does_not_matter() {
        let mut candidates = candidates(3000);
        let choice = choose(&candidates, 400, 5.0);
        let mut counts = BTreeMap::new();
        // Untouched skins are in no stratum.
        for stratum in choice.fitted.iter().filter_map(|&i| stratum(&candidates[i].contacts, 5.0)) {
            *counts.entry(stratum).or_insert(0) += 1;
        }
        let most = counts.values().max().copied().unwrap_or(0);
        let mut there = BTreeMap::new();
        for c in
            candidates.iter().filter(|c| !configuration(&c.tips_mm).is_multiple_of(HELD_OUT_IN))
        {
            if let Some(stratum) = stratum(&c.contacts, 5.0) {
                *there.entry(stratum).or_insert(0) += 1;
            }
        }
        // A stratum with fewer trials than the fullest one must be empty.
        for (stratum, count) in &counts {
            assert!(*count + 1 >= most || *count == there[stratum], "{stratum:?}: {count}");
        }
        let numbers = |candidates: &[Candidate], side: &[usize]| {
            let mut numbers: Vec<i64> = side.iter().map(|&i| candidates[i].trial).collect();
            numbers.sort_unstable();
            numbers
        };
        let before = numbers(&candidates, &choice.fitted);
        candidates.reverse();
        let turned = choose(&candidates, 400, 5.0);
        assert_eq!(numbers(&candidates, &turned.fitted), before);
    }

    #[test]
    fn fewer_trials_than_strata_are_of_all_counts_and_places() {
        let candidates = candidates(3000);
        let choice = choose(&candidates, 60, 5.0);
        let strata: Vec<Stratum> =
            choice.fitted.iter().filter_map(|&i| stratum(&candidates[i].contacts, 5.0)).collect();
        for (axis, values) in [(0, 1..=3), (1, 0..=3), (2, 0..=2)] {
            for value in values {
                let there = strata.iter().filter(|s| s[axis] == value).count();
                assert!(there >= 6, "{there} of {} with {value} on axis {axis}", strata.len());
            }
        }
    }

    #[test]
    fn too_few_trials_are_refused_in_words() {
        let (sensor, responses) = (paper::sensor(), MODEL.responses());
        let run = RunUid::default();
        let source = Source { run, label: Label::Virtual };
        let options = SkinFitOptions::for_trials(0, 1);
        let error = calibrate(&sensor, responses, [&[], &[]], source, &options, &mut |_| {});
        let words = error.unwrap_err().to_string();
        let expected = format!("run {run}: 0 trials to fit and 0 of other configurations");
        assert!(words.starts_with(&expected), "{words}");
    }
}
