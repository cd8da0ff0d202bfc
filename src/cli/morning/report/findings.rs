//! Findings: conclusions from the facts of a run.
//! PURE. Uses: `facts`, sim-core's quantiles. Never: a request, a limit that is not named here.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use jiff::SignedDuration;
use sim_core::stats::{median, quantile, sorted};

use super::super::answers::{TrialFacts, duration_words, state_words, stored_words};
use super::facts::Facts;
use crate::cli::output::{counted, grouped};
use crate::event::Importance;
use crate::state::{PausedWhy, StoredState};
use crate::store::RunKind;

/// Share of attempts that may fail.
const RETRIES: f64 = 0.01;
/// FVU of the twins of contacts above which the model fits badly.
const FVU: f64 = 0.5;
/// Distance of an outlier from the third quartile, interquartile ranges, and its least FVU.
const OUTLIER_IQR: f64 = 3.0;
const OUTLIER_FVU: f64 = 0.5;
/// Fewest trials of an arm, and deviation of its median force from that of the other arms.
const ARM_TRIALS: usize = 8;
const STIFFNESS: f64 = 0.15;
/// Relative change of the force of the reference press.
const REFERENCE: f64 = 0.05;
/// Growth of the median FVU from the first to the last third of the trials with as many tips.
const FVU_GROWTH: f64 = 1.5;
const FVU_TRIALS: usize = 30;
/// Longest pause that is not worth a sentence.
const PAUSE: SignedDuration = SignedDuration::from_secs(60);

/// A conclusion with the next step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// How much it matters: data that is missing or wrong asks a person to act.
    pub level: Importance,
    /// One or two sentences.
    pub words: String,
}

/// Returns the findings, the most important first.
pub fn findings(facts: &Facts) -> Vec<Finding> {
    let mut all = Vec::new();
    all.extend(end(facts));
    all.extend(skipped(facts));
    all.extend(trips(facts));
    all.extend(pauses(facts));
    all.extend(retries(facts));
    all.extend(flags(&facts.trials));
    all.extend(twins(facts));
    all.extend(fit(facts));
    all.extend(fit_over_time(&facts.trials));
    all.extend(stiffness(&facts.trials));
    all.extend(references(facts));
    all.sort_by_key(|finding| Reverse(finding.level));
    all
}

fn act(words: String) -> Option<Finding> {
    Some(Finding { level: Importance::Act, words })
}

fn look(words: String) -> Option<Finding> {
    Some(Finding { level: Importance::Look, words })
}

fn end(facts: &Facts) -> Option<Finding> {
    let (run, summary) = (facts.run(), &facts.summary);
    let (stored, planned) = (summary.trials_stored, run.trials_planned);
    let state = state_words(run);
    if run.exit_status.is_none() {
        return look(format!(
            "The run has not ended: it is {state}, with {} trials stored. This report is of what is \
             stored now.",
            stored_words(stored, planned)
        ));
    }
    if stored + summary.trials_skipped >= planned {
        return None;
    }
    let reason = run.reason.as_deref();
    // "stopped at 56 of 264 trials" states both already.
    if let Some(reason) = reason.filter(|reason| reason.starts_with(&state)) {
        return act(format!("The run ended short of its plan: {reason}."));
    }
    let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
    act(format!(
        "The run ended short of its plan ({state}{reason}): {} trials are stored.",
        stored_words(stored, planned)
    ))
}

fn skipped(facts: &Facts) -> Option<Finding> {
    let first = facts.summary.skips.first()?;
    let count = facts.summary.skips.len() as u64;
    act(format!(
        "{} skipped; {} trials are missing. The first is configuration {}: {}.",
        counted(count, "configuration was", "configurations were"),
        grouped(facts.summary.trials_skipped),
        first.configuration,
        first.reason
    ))
}

fn trips(facts: &Facts) -> Option<Finding> {
    let trips: Vec<_> = facts.events.iter().filter(|event| event.kind == "trip").collect();
    let last = trips.last()?;
    look(format!(
        "The rig tripped {}; the last at {}: {}.",
        counted(trips.len() as u64, "time", "times"),
        crate::cli::times::second(last.at),
        last.words
    ))
}

fn pauses(facts: &Facts) -> Option<Finding> {
    let waits = facts.states.iter().filter(|span| {
        let is_wait = matches!(span.state, StoredState::Paused | StoredState::Interrupted);
        is_wait && !matches!(span.why, Some(PausedWhy::TipChange | PausedWhy::ManualTrial))
    });
    let took: Vec<SignedDuration> =
        waits.filter_map(|span| Some(span.to?.duration_since(span.from))).collect();
    let sum: SignedDuration = took.iter().sum();
    if sum < PAUSE {
        return None;
    }
    let times = counted(took.len() as u64, "time", "times");
    look(format!("The run was paused or interrupted {times}, {} in all.", duration_words(sum)))
}

fn retries(facts: &Facts) -> Option<Finding> {
    let (retries, stored) = (facts.summary.retries, facts.summary.trials_stored);
    if retries as f64 <= RETRIES * stored as f64 {
        return None;
    }
    let first = facts.events.iter().find(|event| event.kind == "attempt_failed");
    let first = first.map_or_else(String::new, |event| format!(" The first: {}.", event.words));
    look(format!("{} failed.{first}", counted(retries, "attempt", "attempts")))
}

fn flags(trials: &[TrialFacts]) -> Option<Finding> {
    let mut counts = BTreeMap::<&str, u64>::new();
    for flag in trials.iter().flat_map(|trial| &trial.flags) {
        *counts.entry(flag).or_default() += 1;
    }
    let flagged = trials.iter().filter(|trial| !trial.flags.is_empty()).count();
    if flagged == 0 {
        return None;
    }
    let listed: Vec<String> =
        counts.iter().map(|(flag, count)| format!("{flag} {count}")).collect();
    look(format!(
        "{} marked as possibly faulty ({}).",
        counted(flagged as u64, "trial is", "trials are"),
        listed.join(", ")
    ))
}

fn twins(facts: &Facts) -> Option<Finding> {
    let twins = &facts.twins;
    match (twins.pending, twins.failures) {
        (0, 0) => None,
        (0, failures) => {
            look(format!("The model cannot simulate {}.", counted(failures, "trial", "trials")))
        }
        (pending, _) => look(format!(
            "{} no twin yet: the service makes them while it runs, and this report lacks them.",
            counted(pending, "trial has", "trials have")
        )),
    }
}

/// FVUs of trials with contacts and without flags.
fn fvus(trials: &[TrialFacts]) -> impl Iterator<Item = (f64, &TrialFacts)> {
    let sound = trials.iter().filter(|trial| trial.contact_count > 0 && trial.flags.is_empty());
    sound.filter_map(|trial| Some((trial.fvu?, trial)))
}

/// Trials whose FVU is far above the others, the worst first.
pub fn outliers(trials: &[TrialFacts]) -> Vec<&TrialFacts> {
    let all = sorted(fvus(trials).map(|(fvu, _)| fvu));
    let (Some(q1), Some(q3)) = (quantile(&all, 0.25), quantile(&all, 0.75)) else {
        return Vec::new();
    };
    let limit = (q3 + OUTLIER_IQR * (q3 - q1)).max(OUTLIER_FVU);
    let mut far: Vec<(f64, &TrialFacts)> = fvus(trials).filter(|(fvu, _)| *fvu > limit).collect();
    far.sort_by(|a, b| b.0.total_cmp(&a.0));
    far.into_iter().map(|(_, trial)| trial).collect()
}

fn fit(facts: &Facts) -> Option<Finding> {
    if let Some(fvu) = facts.fit.median_fvu.filter(|fvu| *fvu > FVU) {
        let run = facts.run();
        // Placed weights are for the evaluation of a calibration, which needs presses of other forces.
        let next = match run.kind {
            RunKind::RealRandom => String::new(),
            RunKind::RealHex | RunKind::Imported => format!(
                " Calibrate the model to this skin: palpate calibrate skin --run {}.",
                run.scan_id
            ),
        };
        return look(format!(
            "The twins explain little of the frames: median FVU {fvu:.2} of trials with contacts.{next}"
        ));
    }
    let far = outliers(&facts.trials);
    let worst = far.first()?;
    look(format!(
        "{} their twins far worse than the others; the worst is t{} with FVU {:.2}: palpate show t{}.",
        counted(far.len() as u64, "trial with contacts fits", "trials with contacts fit"),
        worst.trial_id,
        worst.fvu.unwrap_or(f64::NAN),
        worst.trial_id
    ))
}

fn fit_over_time(trials: &[TrialFacts]) -> Option<Finding> {
    let mut by_tips = BTreeMap::<u8, Vec<f64>>::new();
    for (fvu, trial) in fvus(trials) {
        by_tips.entry(trial.tips).or_default().push(fvu);
    }
    by_tips.into_iter().filter(|(_, fvus)| fvus.len() >= FVU_TRIALS).find_map(|(tips, fvus)| {
        let third = fvus.len() / 3;
        let first = median(fvus[..third].iter().copied())?;
        let last = median(fvus[fvus.len() - third..].iter().copied())?;
        if last < FVU_GROWTH * first || last - first < 0.1 {
            return None;
        }
        look(format!(
            "The twins fit worse with time: median FVU {first:.2} in the first third, {last:.2} in \
             the last, with {}. Has the skin or a cable changed?",
            counted(tips.into(), "tip", "tips")
        ))
    })
}

/// Forces of each arm at the deepest common depth, by the number of tips.
fn stiffness(trials: &[TrialFacts]) -> Option<Finding> {
    let deepest = trials.iter().filter_map(|t| t.depth_mm).fold(f64::MIN, f64::max);
    let mut by_tips = BTreeMap::<u8, BTreeMap<usize, Vec<f64>>>::new();
    for trial in trials.iter().filter(|t| t.depth_mm.is_some_and(|mm| mm > deepest - 0.005)) {
        for (arm, force_n) in trial.forces_n.iter().enumerate() {
            if let Some(force_n) = force_n {
                by_tips.entry(trial.tips).or_default().entry(arm + 1).or_default().push(*force_n);
            }
        }
    }
    by_tips.into_iter().find_map(|(tips, arms)| {
        if arms.len() < 2 || arms.values().any(|forces| forces.len() < ARM_TRIALS) {
            return None;
        }
        let medians =
            || arms.iter().filter_map(|(arm, f)| Some((*arm, median(f.iter().copied())?)));
        let middle = median(medians().map(|(_, force_n)| force_n)).filter(|n| *n > 1.0)?;
        let far = medians().filter(|(arm, force_n)| {
            // Places differ between trials: a deviation counts if it is three standard errors.
            let error = arms.get(arm).map_or(f64::MAX, |forces| standard_error(forces));
            (force_n - middle).abs() > (STIFFNESS * middle).max(3.0 * error)
        });
        let (arm, force_n) =
            far.max_by(|a, b| (a.1 - middle).abs().total_cmp(&(b.1 - middle).abs()))?;
        look(format!(
            "Arm {arm} differs from the others: median {force_n:.1} N at {deepest:.1} mm, against \
             {middle:.1} N, with {}. Check its tip and its cell.",
            counted(tips.into(), "tip", "tips")
        ))
    })
}

/// Standard error of a median, from the quartiles (1.25 sd / sqrt n for a normal distribution).
fn standard_error(values: &[f64]) -> f64 {
    let sorted = sorted(values.iter().copied());
    let quartile = |share| quantile(&sorted, share).unwrap_or(0.0);
    let sd = (quartile(0.75) - quartile(0.25)) / 1.349;
    1.2533 * sd / (sorted.len().max(1) as f64).sqrt()
}

fn references(facts: &Facts) -> Option<Finding> {
    // Presses with different numbers of tips are at different places.
    let mut ends = BTreeMap::<(usize, u8), (f64, f64)>::new();
    for press in &facts.references {
        for arm in &press.arms {
            let end = ends.entry((press.arms.len(), arm.arm)).or_insert((arm.force_n, arm.force_n));
            end.1 = arm.force_n;
        }
    }
    let change = |(first, last): &(f64, f64)| (last - first) / first;
    let worst = ends
        .iter()
        .filter(|(_, ends)| ends.0 > 1.0)
        .max_by(|a, b| change(a.1).abs().total_cmp(&change(b.1).abs()))
        .filter(|(_, ends)| change(ends).abs() > REFERENCE)?;
    let ((_, arm), (first, last)) = worst;
    look(format!(
        "The reference press has changed by {:+.0} %: arm {arm} read {first:.2} N first and \
         {last:.2} N last. The skin creeps, or the cell drifts.",
        100.0 * change(worst.1)
    ))
}
