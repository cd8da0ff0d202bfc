//! What `palpate calibrate skin` refuses, run as a person runs it. Fits are tested in `sim-core`: one takes minutes.

use std::path::Path;
use std::process::Output;

use palpate::ids::TrialKey;
use palpate::journal::Journal;
use palpate::record::{PlacedContact, TrialRecord};
use palpate::store::{NewRun, RunKind};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::datasets::filled::{end, new_run, placed, points, store};
use crate::support::{Folder, VIRTUAL_RIG, command, not_done, with_responses};

/// Trials of one weight each, on different places; 10 of these places are held out.
fn trials() -> Vec<TrialRecord> {
    let (points, mut chance) = (points(), ChaCha8Rng::seed_from_u64(1));
    let mut trial = |configuration: u32| {
        let [column, row] = [configuration / 9, configuration % 9];
        let [x_mm, y_mm] = [60 + 60 * column, 60 + 55 * row].map(f64::from);
        let key = TrialKey { configuration, depth_index: 0 };
        TrialRecord {
            tips: 1,
            placed: vec![PlacedContact { x_mm, y_mm, force_n: 8.0 }],
            ..placed(key, &points, &mut chance)
        }
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
    let new = NewRun { rig: Some(VIRTUAL_RIG.into()), ..new_run(RunKind::RealRandom, "weights") };
    let run = store.create_run(new).await.unwrap().uid;
    for trial in trials() {
        store.trial(run, &trial).await.unwrap();
    }
    end(&store, run).await;
    store.close().await;

    let out = ["calibrate", "skin", "--out", "skin.toml"];
    let skin = |more: &[&str]| palpate(&folder, &[&out[..], more].concat());
    let few = format!(
        "run {run}: 40 trials to fit and 10 of other configurations to hold out; a skin needs at \
         least 50 and 1"
    );
    not_done(&skin(&["--run", "1", "--trials", "40"]), 1, &few);
    not_done(&skin(&["--run", "7"]), 1, "no run 7: palpate runs lists all");
    not_done(&skin(&["--run", "x"]), 2, "RUN = x: must be the number, start of the id");
    assert!(!folder.join("skin.toml").exists());
}
