//! What `palpate calibrate skin` refuses, and what is stated of a skin that its fit made worse, run as a person runs
//! it. Fits are tested in `sim-core`: one takes minutes.

use std::path::Path;
use std::process::Output;

use palpate::ids::TrialKey;
use palpate::journal::Journal;
use palpate::record::{ArmReading, TrialRecord};
use palpate::store::{NewRun, RunKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sim_core::calibration::Calibration;
use sim_core::inverse::skin::SkinPrior;
use sim_core::skin::{
    FvuSummary, SkinCalibration, SkinElectrodes, SkinEvidence, SkinField, SkinFields, SkinFoam,
};

use crate::datasets::filled::{end, new_run, points, press, store};
use crate::support::{
    Folder, VIRTUAL_RIG, command, done, not_done, sensor, succeeded, with_responses,
};

/// Presses with one tip each, on different places; 10 of these places are held out.
fn trials() -> Vec<TrialRecord> {
    let (points, mut chance) = (points(), ChaCha8Rng::seed_from_u64(1));
    let mut trial = |configuration: u32| {
        let [column, row] = [configuration / 9, configuration % 9];
        let [x_mm, y_mm] = [60 + 60 * column, 60 + 55 * row].map(f64::from);
        let key = TrialKey { configuration, depth_index: 0 };
        let arm = ArmReading { arm: 1, x_mm, y_mm, force_n: 8.0, cell_v: 1.0, tare_v: 0.5 };
        TrialRecord { arms: vec![arm], ..press(key, 1, &points, &mut chance) }
    };
    (0..64).map(&mut trial).collect()
}

/// Runs a command on a data folder, in it.
fn palpate(data: &Path, arguments: &[&str]) -> Output {
    command(arguments).env("PALPATE_DATA", data).current_dir(data).output().unwrap()
}

#[tokio::test]
async fn too_few_trials_and_unknown_runs_are_named_and_no_file_is_written() {
    let folder = Folder::new("calibrate-skin");
    with_responses(&folder);
    let store = store(&folder).await;
    let new = |kind, name| NewRun { rig: Some(VIRTUAL_RIG.into()), ..new_run(kind, name) };
    let run = store.create_run(new(RunKind::RealHex, "presses")).await.unwrap().uid;
    for trial in trials() {
        store.trial(run, &trial).await.unwrap();
    }
    end(&store, run).await;
    store.close().await;

    let out = ["calibrate", "skin", "--out", "skin.toml"];
    let skin = |more: &[&str]| palpate(&folder, &[&out[..], more].concat());
    let few = format!(
        "run {run}: 40 trials to fit and 10 of other configurations to hold out; a skin needs at \
         least 50 and 5"
    );
    not_done(&skin(&["--run", "1", "--trials", "40"]), 1, &few);
    not_done(&skin(&["--run", "7"]), 1, "no run 7: palpate runs lists all");
    not_done(&skin(&["--run", "x"]), 2, "RUN = x: must be the number, start of the id");
    assert!(!folder.join("skin.toml").exists());
}

/// A skin that explains most of ten held-out trials better than the model before its fit, and one far worse.
fn worse_somewhere() -> Calibration {
    let sensor = sensor();
    let places = |axis: usize| sensor.electrodes_mm().iter().map(|e| e[axis]).collect();
    let field = || SkinField { columns: 2, values: vec![0.1; 4], prior: SkinPrior::default().ln_a };
    let skin = SkinCalibration {
        offsets_mv: Vec::new(),
        evidence: SkinEvidence {
            run: "0199".into(),
            label: "virtual".into(),
            data_sha256: "22".into(),
            model: "sim-0".into(),
            trials: 54,
            held_out: 10,
            doubted: 0,
            noise_v: 1.2e-3,
            model_error: 0.02,
            before: FvuSummary { median: 0.14, mean: 0.15 },
            after: FvuSummary { median: 0.01, mean: 0.63 },
        },
        electrodes: SkinElectrodes {
            x_mm: places(0),
            y_mm: places(1),
            contact_ohm: vec![30.0; 28],
            lead_ohm: vec![500.0; 28],
        },
        fields: SkinFields {
            foam: SkinFoam { step_mm: 0.5, ln_slopes: vec![0.1, 0.0, -0.1] },
            ln_a: field(),
            ln_b: field(),
            ln_c: field(),
            ln_compliance: field(),
            ln_sheet_conductance: field(),
            ln_sheet_anisotropy: 0.0,
        },
    };
    Calibration { sensor: sensor.file.name.clone(), skin: Some(skin), ..Calibration::default() }
}

#[tokio::test]
async fn a_skin_that_is_worse_somewhere_is_stored_with_a_note() {
    let folder = Folder::new("calibrate-worse");
    store(&folder).await.close().await;
    let calibration = worse_somewhere();
    std::fs::write(folder.join("skin.toml"), calibration.to_toml().unwrap()).unwrap();
    let add = ["model", "add-calibration", "skin.toml"];
    let words = "mean FVU 0.150 before and 0.630 after, median 0.140 and 0.010";
    let added = palpate(&folder, &add);
    assert_eq!(succeeded(&added).trim(), calibration.id().unwrap());
    let noted = String::from_utf8_lossy(&added.stderr);
    assert!(noted.contains(words), "{noted}");
    let added = done(&palpate(&folder, &[&add[..], &["--json"]].concat()));
    assert!(added["limitation"].as_str().unwrap().contains(words), "{added}");
}
