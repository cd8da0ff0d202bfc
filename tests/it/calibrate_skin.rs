//! `palpate calibrate skin`, run as a person runs it: from the trials of a run to a calibration that a service stores.
//! The skin is that of the model with another foam: fits of other skins are tested in `sim-core`.

use std::path::Path;
use std::process::Output;
use std::sync::Arc;

use palpate::ids::TrialKey;
use palpate::journal::Journal;
use palpate::record::{FrameRecord, PlacedContact, TrialRecord};
use palpate::simulate::model::unit_responses;
use palpate::store::{NewRun, RunKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use sim_core::calibration::Calibration;
use sim_core::forward::{Contact, ForwardModel, Workspace};
use sim_core::sensor::Sensor;

use crate::datasets::filled::{end, new_run, placed, points, store};
use crate::support::{
    Folder, VIRTUAL_RIG, command, done, not_done, sensor, skin_cache, succeeded, with_responses,
};

/// Weights, each on another place; 10 of these places are held out.
const TRIALS: u32 = 64;
const VOLTS_PER_COUNT: f32 = 12.0 / 32_768.0;

/// Trials of one weight each on a skin whose foam conducts better than that of the sensor file.
fn trials() -> Vec<TrialRecord> {
    let mut file = sensor().file;
    file.piezo.a_ohm *= 0.6;
    let responses = unit_responses(&sensor(), &skin_cache()).unwrap();
    let skin = ForwardModel::new(Sensor::new(file).unwrap(), Arc::new(responses)).unwrap();
    let (points, mut chance) = (points(), ChaCha8Rng::seed_from_u64(1));
    let mut work = Workspace::default();
    let mut trial = |configuration: u32| {
        let [column, row] = [configuration / 9, configuration % 9];
        let [x_mm, y_mm] = [60 + 60 * column, 60 + 55 * row].map(f64::from);
        let force_n = f64::from(8 + 6 * (configuration % 4));
        let clean_v = skin.voltages(&[Contact { x_mm, y_mm, force_n }], &mut work).unwrap();
        let count = |v: &f64| (v / f64::from(VOLTS_PER_COUNT)).round() as i16;
        let counts = clean_v.iter().map(count).collect();
        let volts_per_count = VOLTS_PER_COUNT;
        let frame = FrameRecord { sequence: 1, device_time_us: 2, volts_per_count, counts };
        let key = TrialKey { configuration, depth_index: 0 };
        TrialRecord {
            tips: 1,
            placed: vec![PlacedContact { x_mm, y_mm, force_n }],
            frames: vec![frame],
            ..placed(key, &points, &mut chance)
        }
    };
    (0..TRIALS).map(&mut trial).collect()
}

/// Runs a command on a data folder, in it.
fn palpate(data: &Path, arguments: &[&str]) -> Output {
    command(arguments).env("PALPATE_DATA", data).current_dir(data).output().unwrap()
}

#[tokio::test]
async fn a_run_yields_a_calibration_that_a_service_takes_and_a_lack_of_trials_is_named() {
    let folder = Folder::new("calibrate-skin");
    with_responses(&folder);
    let store = store(&folder).await;
    let new = NewRun { rig: Some(VIRTUAL_RIG.into()), ..new_run(RunKind::RealRandom, "weights") };
    let run = store.create_run(new).await.unwrap().uid;
    for trial in trials() {
        store.trial(run, &trial).await.unwrap();
    }
    end(&store, run).await;
    store.close().await;

    let skin = |more: &[&str]| palpate(&folder, &[&["calibrate", "skin"][..], more].concat());
    let few = format!(
        "run {run}: 40 trials to fit and 10 of other configurations to hold out; a skin needs at \
         least 50 and 1"
    );
    not_done(&skin(&["--run", "1", "--trials", "40"]), 1, &few);
    not_done(&skin(&["--run", "7"]), 1, "no run 7: palpate runs lists all");
    not_done(&skin(&["--run", "x"]), 2, "RUN = x: must be the number, start of the id");
    assert!(!folder.join("skin.toml").exists());

    let files = ["--out", "skin.toml", "--plot", "skin.svg"];
    let fitted = done(&skin(&[&["--run", "last", "--json"][..], &files].concat()));
    let evidence = &fitted["evidence"];
    assert_eq!((&evidence["trials"], &evidence["held_out"]), (&json!(54), &json!(10)));
    let median = |side: &str| evidence[side]["median"].as_f64().unwrap();
    assert!(median("after") < median("before") / 2.0, "{evidence}");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    assert!(read("skin.svg").starts_with("<svg"));
    let calibration = Calibration::from_toml(&read("skin.toml")).unwrap();
    let id = calibration.id().unwrap();
    assert_eq!(fitted["id"], id);
    assert_eq!(calibration.skin.unwrap().evidence.run, run.to_string());

    let added = succeeded(&palpate(&folder, &["model", "add-calibration", "skin.toml"]));
    assert!(added.contains(&id), "{added}");
    assert_eq!(read(&format!("calibrations/{id}.toml")), read("skin.toml"));
}
