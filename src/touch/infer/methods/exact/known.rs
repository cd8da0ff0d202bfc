//! The known trials from which the errors of a skin's model are estimated: chosen from the runs of the store.
//! Uses: `store`, `calibrate::skin`, `infer::untouched`. Never: the model, files.

use sim_core::calibrated::CalibratedSensor;
use sim_core::sensor::Sensor;

use super::rehearsal::LIGHT_N;
use super::{KnownTrial, KnownTrials, Untouched};
use crate::calibrate::skin;
use crate::dataset::pressed::{clock_rate, contacts, force_noise_n, tips_mm};
use crate::ids::TrialId;
use crate::infer::error::{InferError, InferResult};
use crate::infer::untouched::UntouchedSkins;
use crate::problem::Problem;
use crate::state::StoredState;
use crate::store::{Condition, Label, MAX_PAGE, RunKind, RunRow, Store, TrialQuery, TrialRow};

/// Number of newest runs that are searched for the one with the known trials.
const RUNS_LOOKED_AT: u32 = 1000;
/// Largest number of known trials.
const KNOWN_TRIALS: usize = 1000;
/// Largest number of contacts, and largest force, N, of known trials: heavier frames have other
/// errors, and contacts that are hard to distinguish are light.
const KNOWN_CONTACTS: f64 = 3.0;
const KNOWN_FORCE_N: f64 = 40.0;
/// Largest number of contacts of those in which an answer may find a part of them.
const CROWDED_CONTACTS: f64 = 4.0;
/// Largest number of untouched trials.
const UNTOUCHED_TRIALS: usize = 300;
/// Force below which a trial is untouched, N: a twentieth of the signal of the paper's deadband, noise of the
/// cells.
pub const UNTOUCHED_N: f64 = 0.5;

/// Trials of the run that a skin was calibrated to, or else of the newest Real-Hex run on this
/// sensor, or else of the newest imported run on it: taken evenly from the untouched ones, and from those with few
/// contacts above its deadband, of configurations to which no skin is fitted. Empty if the store does not have
/// that run.
///
/// # Errors
/// `InferError` if the store cannot be read.
pub(super) async fn known_trials(
    store: &Store,
    sensor: &CalibratedSensor,
) -> InferResult<KnownTrials> {
    let of_skin = sensor.skin().map(|skin| skin.evidence.run.clone());
    let runs = store.runs(&[], RUNS_LOOKED_AT, None).await?.runs;
    let is_on_sensor = |run: &RunRow, kind: RunKind| {
        let is_measured = run.label != Label::Simulated;
        let same = || Sensor::from_toml(&run.sensor).is_ok_and(|s| s.file == sensor.file);
        run.kind == kind && run.state == StoredState::Ended && is_measured && same()
    };
    let newest = |kind| runs.iter().find(|run| is_on_sensor(run, kind));
    let run = match &of_skin {
        Some(uid) => runs.iter().find(|run| run.uid.to_string() == *uid),
        None => newest(RunKind::RealHex).or_else(|| newest(RunKind::Imported)),
    };
    let Some(run) = run else { return Ok(KnownTrials::default()) };
    let channels = sensor.channels();
    let force_noise_n = run.rig.as_deref().and_then(force_noise_n).unwrap_or(0.0);
    let light = [
        format!("max_force_n__gte={}", run.deadband_n),
        format!("max_force_n__lt={KNOWN_FORCE_N}"),
        format!("contact_count__lte={KNOWN_CONTACTS}"),
    ];
    let all = evenly(store, run, &light, KNOWN_TRIALS * skin::HELD_OUT_IN as usize).await?;
    let more = [
        format!("max_force_n__lt={LIGHT_N}"),
        format!("contact_count__gt={KNOWN_CONTACTS}"),
        format!("contact_count__lte={CROWDED_CONTACTS}"),
    ];
    let more = evenly(store, run, &more, KNOWN_TRIALS * skin::HELD_OUT_IN as usize).await?;
    let skins = UntouchedSkins::before(store, &[ids(&all), ids(&more)].concat()).await?;
    let pressed = |trial: &TrialRow| {
        let contacts = contacts(trial, run.kind, force_noise_n)?;
        // An import may have contacts at the edge, which the model cannot take.
        contacts.iter().all(|c| sensor.holds_tip([c.x_mm, c.y_mm])).then_some(())?;
        skin::is_held_out(&tips_mm(trial, run.kind, &contacts)).then_some(())?;
        let frame_v = complete(trial.voltages_v.clone(), channels)?;
        let (frames, untouched) = (frames(trial), skins.of(trial.trial_id));
        let configuration = trial.configuration;
        Some(KnownTrial { configuration, contacts, frame_v, frames, untouched })
    };
    let crowded = more.iter().filter_map(pressed).take(KNOWN_TRIALS).collect();
    let pressed = all.iter().filter_map(pressed).take(KNOWN_TRIALS).collect();
    // Without a load cell there is no force where nothing touches.
    let untouched = match run.kind {
        RunKind::RealHex => format!("max_force_n__lt={UNTOUCHED_N}"),
        RunKind::RealRandom | RunKind::Imported => "contact_count=0".to_owned(),
    };
    let untouched = evenly(store, run, &[untouched], UNTOUCHED_TRIALS).await?;
    let at = |trial: Option<&TrialRow>| trial.and_then(|t| t.measured_at.or(t.started_at));
    let wall_s = match (at(untouched.first()), at(untouched.last())) {
        (Some(first), Some(last)) => last.as_second().saturating_sub(first.as_second()) as f64,
        _ => 0.0,
    };
    let hours = wall_s * run.rig.as_deref().map_or(1.0, clock_rate) / 3600.0;
    let skins = UntouchedSkins::before(store, &ids(&untouched)).await?;
    let averaged = untouched.iter().map(frames).sum::<f64>() / untouched.len().max(1) as f64;
    let (mut frames_v, mut tared_v) = (Vec::new(), Vec::new());
    for trial in untouched {
        let Some(frame_v) = complete(trial.voltages_v, channels) else { continue };
        frames_v.push(frame_v);
        tared_v.push(skins.last_v(trial.trial_id).map_or_else(Vec::new, <[f32]>::to_vec));
    }
    let untouched = Untouched { frames_v, tared_v, averaged, hours };
    Ok(KnownTrials { pressed, crowded, untouched })
}

/// At most `most` trials of a run that meet conditions, without flags, evenly in their order.
async fn evenly(
    store: &Store,
    run: &RunRow,
    conditions: &[String],
    most: usize,
) -> InferResult<Vec<TrialRow>> {
    let condition = |text: &String| {
        let wrong = |limit| vec![Problem::new("request", "where", text, limit)];
        Condition::parse(text).map_err(wrong).map_err(InferError::Problems)
    };
    let mut query = TrialQuery {
        run: Some(run.uid),
        flagged: Some(false),
        limit: MAX_PAGE,
        filters: conditions.iter().map(condition).collect::<Result<_, _>>()?,
        ..TrialQuery::default()
    };
    // All of them: settings with more tips are late in a run.
    let mut ids = Vec::new();
    loop {
        let page = store.trial_ids(&query).await?;
        ids.extend_from_slice(&page);
        if page.len() < MAX_PAGE as usize {
            break;
        }
        query.after = page.last().copied();
    }
    let count = ids.len().min(most);
    let chosen: Vec<_> = (0..count).map(|i| ids[i * ids.len() / count]).collect();
    Ok(store.trials_with_voltages(&chosen).await?)
}

fn ids(trials: &[TrialRow]) -> Vec<TrialId> {
    trials.iter().map(|trial| trial.trial_id).collect()
}

/// The frame, if it has all channels: one that was measured elsewhere may lack some.
fn complete(frame_v: Option<Vec<f32>>, channels: usize) -> Option<Vec<f32>> {
    frame_v.filter(|v| v.len() == channels && v.iter().all(|v| v.is_finite()))
}

fn frames(trial: &TrialRow) -> f64 {
    f64::from(trial.frame_count.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::ids::RunUid;
    use crate::store::{ImportedTrial, NewRun};

    const SENSOR: &str = include_str!("../../../../../experiments/sensors/ert-28.toml");

    /// Positions of the contacts of an imported trial, mm: one of four is untouched, and one has four contacts. Those of
    /// the last trials are at the edge.
    fn places(trial: u32) -> Vec<[f64; 2]> {
        let count = [0, 1, 4, 1][trial as usize % 4];
        let x_mm = if trial < 160 { 100.0 + f64::from(trial) } else { 4.0 };
        let place = |n: u32| [x_mm, 400.0 - f64::from(trial + 60 * n)];
        (0..count).map(place).collect()
    }

    /// One of the untouched ones lacks a channel.
    fn elsewhere(trial: u32, channels: usize) -> ImportedTrial {
        let contact = |place_mm: [f64; 2]| {
            let [x_mm, y_mm] = place_mm.map(Some);
            crate::store::Contact { x_mm, y_mm, force_n: Some(9.0), diameter_mm: None }
        };
        let mut voltages_v = vec![1e-3; channels];
        if trial == 4 {
            voltages_v[3] = f32::NAN;
        }
        ImportedTrial {
            configuration: trial,
            contacts: places(trial).into_iter().map(contact).collect(),
            voltages_v,
            frame_count: 8,
            ..ImportedTrial::default()
        }
    }

    #[tokio::test]
    async fn an_imported_run_on_the_sensor_has_known_trials() {
        let folder = tempfile::tempdir().unwrap();
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let store = Store::open(&folder.path().join("palpate.db"), Clock::new(1.0)).await.unwrap();
        let none = known_trials(&store, &sensor.clone().into()).await.unwrap();
        assert!(none.pressed.is_empty() && none.untouched.frames_v.is_empty());
        let new = NewRun {
            uid: RunUid::new(),
            experiment: "elsewhere".into(),
            kind: RunKind::Imported,
            definition: "{}".into(),
            seed: None,
            rig: None,
            sensor: SENSOR.into(),
            calibration_id: None,
            plan: None,
            label: Label::Measured,
            version: "0.1.0".into(),
            git_commit: None,
            deadband_n: 0.0,
            tip_diameter_mm: None,
            trials_planned: 200,
            auto_resume: false,
            not_before: None,
            submitted_by: "test".into(),
        };
        let run = store.begin_import(new).await.unwrap();
        let trials = (0..200).map(|n| elsewhere(n, sensor.channels())).collect();
        store.import_trials(run.uid, None, trials).await.unwrap();
        store.end_import(run.uid).await.unwrap();
        let known = known_trials(&store, &sensor.into()).await.unwrap();
        let of_count = |count: usize, trials: std::ops::Range<u32>| {
            let held_out = |of: &Vec<[f64; 2]>| of.len() == count && skin::is_held_out(of);
            trials.map(places).filter(held_out).count()
        };
        let wanted = [1, 4].map(|count| of_count(count, 0..160));
        assert!(of_count(1, 160..200) > 0, "of those at the edge some are held out");
        assert_eq!([known.pressed.len(), known.crowded.len()], wanted);
        assert!(wanted.iter().all(|count| *count > 0), "{wanted:?}");
        assert!(known.crowded.iter().all(|trial| trial.contacts.len() == 4));
        assert!(known.pressed.iter().all(|trial| trial.frames == 8.0));
        assert_eq!(known.untouched.frames_v.len(), 49, "one lacks a channel");
        store.close().await;
    }
}
