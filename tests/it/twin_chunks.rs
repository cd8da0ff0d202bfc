//! Twins of a run in chunks, as real processes make them without its database: byte for byte those of the service,
//! each stored once, and refused if another one is stored.

use std::path::Path;
use std::process::Output;
use std::time::Duration;

use palpate::ids::{TrialId, TrialKey};
use palpate::journal::Journal;
use palpate::store::{RunKind, TrialQuery, Twin, TwinOutcome};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};
use sqlx::Connection;

use crate::datasets::filled::{Filled, end, folder, new_run, points, press, store, twin_model};
use crate::support::{
    VIRTUAL_RIG, answered, command, copy_folder, database, done, finished, is_refused, not_done,
    with_extension, with_responses,
};

/// Number of trials of the run, and of a chunk.
const TRIALS: u32 = 44;
const CHUNK_TRIALS: &str = "10";
/// Longest wait for the twins of the service.
const TWINS_WITHIN: Duration = Duration::from_secs(120);

/// A run of 44 trials without twins; a contact of one is off the skin.
async fn pressed(data: &Path) {
    let store = store(data).await;
    let points = points();
    let mut chance = ChaCha8Rng::seed_from_u64(19);
    let mut new = new_run(RunKind::RealHex, "made-up-hex");
    // Twins need the noise of a rig's forces.
    new.rig = Some(VIRTUAL_RIG.into());
    let run = store.create_run(new).await.unwrap().uid;
    for configuration in 0..TRIALS / 11 {
        for depth_index in 0..11 {
            let key = TrialKey { configuration, depth_index };
            let mut trial = press(key, 3, &points, &mut chance);
            if (configuration, depth_index) == (2, 9) {
                trial.arms[1].x_mm = -5.0;
            }
            store.trial(run, &trial).await.unwrap();
        }
    }
    end(&store, run).await;
    store.close().await;
}

async fn palpate(arguments: &[&str]) -> Output {
    finished(command(arguments)).await
}

async fn gather(lab: &Filled, order: &str) -> Output {
    palpate(&["cluster", "gather", order, "--json", "--url", &lab.url("")]).await
}

/// Sends a file of twins to a run, which must be refused in these words.
async fn refused(lab: &Filled, run: &str, file: Vec<u8>, words: &str) {
    let form = Form::new().part("file", Part::bytes(file).file_name("chunk"));
    let url = lab.url(&format!("/api/v1/runs/{run}/twins"));
    is_refused(answered(lab.http.post(url).multipart(form)).await, 422, words);
}

fn any_chunk(order: &str) -> Vec<u8> {
    std::fs::read(&with_extension(&Path::new(order).join("results"), "parquet")[0]).unwrap()
}

/// A trial with its twin, as it is stored.
#[derive(Debug, PartialEq)]
struct WithTwin {
    trial: TrialId,
    frame: Option<Vec<u32>>,
    rmse_v: Option<f64>,
    fvu: Option<f64>,
    model: Option<String>,
}

async fn with_twins(data: &Path) -> Vec<WithTwin> {
    let store = store(data).await;
    let query = TrialQuery { limit: 1000, with_voltages: true, ..TrialQuery::default() };
    let trials = store.trials(&query).await.unwrap();
    store.close().await;
    let bits = |frame_v: Vec<f32>| frame_v.into_iter().map(f32::to_bits).collect();
    let with_twin = |trial: palpate::store::TrialRow| WithTwin {
        trial: trial.trial_id,
        frame: trial.sim_voltages_v.map(bits),
        rmse_v: trial.rmse_v,
        fvu: trial.fvu,
        model: trial.sim_model,
    };
    trials.into_iter().map(with_twin).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn twins_of_two_processes_are_those_of_the_service() {
    let data = folder("twin-chunks");
    pressed(&data).await;
    with_responses(&data);
    let others = folder("twin-chunks-others");
    let [of_service, of_other] = ["of-service", "of-other"].map(|name| others.join(name));
    copy_folder(&data, &of_service);
    copy_folder(&data, &of_other);
    // A node has the cache alone.
    let node = folder("twin-chunks-node");
    copy_folder(&data.join("cache"), &node);
    let [order, node] = [others.join("order"), node].map(|path| path.display().to_string());
    let (order, node) = (order.as_str(), node.as_str());

    // This service makes no twins.
    let lab = Filled::serve(data).await;
    let url = lab.url("");
    let options = ["cluster", "sbatch", "twins", "1", "--json", "--folder", order];
    let place = ["--url", url.as_str(), "--data", node, "--chunk-trials", CHUNK_TRIALS];
    let ordering = [&options[..], &place[..]].concat();
    let ordered = done(&palpate(&ordering).await);
    assert_eq!((&ordered["kind"], &ordered["chunks"]), (&json!("twins"), &json!(5)));
    assert_eq!(done(&palpate(&ordering).await)["changed"], false);

    let task = async |number: &'static str| {
        let options = ["cluster", "make", order, "--json", "--data", node];
        palpate(&[&options[..], &["--task", number, "--tasks", "2"]].concat()).await
    };
    let (one, two) = tokio::join!(task("0"), task("1"));
    assert_eq!((&done(&one)["made"], &done(&two)["made"]), (&json!(3), &json!(2)));
    assert!(!Path::new(node).join("palpate.db").exists(), "a node needs no database");

    // All are stored, once.
    for (stored, present) in [(TRIALS, 0), (0, TRIALS)] {
        let gathered = done(&gather(&lab, order).await);
        assert_eq!((&gathered["stored"], &gathered["present"]), (&json!(stored), &json!(present)));
        let count = lab.get("/api/v1/runs/1/twins").await;
        assert_eq!((&count["twins"], &count["pending"]), (&json!(TRIALS - 1), &json!(0)));
        assert_eq!(count["failures"], 1);
    }
    let gathered = palpate(&["cluster", "gather", order, "--out", "twins", "--url", &url]).await;
    not_done(&gathered, 2, "must be absent");
    let data = lab.end().await;
    let of_chunks = with_twins(&data).await;
    let frames = of_chunks.iter().filter(|trial| trial.frame.is_some()).count();
    assert_eq!(frames, TRIALS as usize - 1);

    // The service makes the same twins, and takes the chunks as what it has.
    let lab = Filled::serve_as(of_service.clone(), |options| options.twin_workers = 1).await;
    lab.until("/api/v1/runs/1/twins", TWINS_WITHIN, |count| count["pending"] == 0).await;
    let gathered = done(&gather(&lab, order).await);
    assert_eq!((&gathered["stored"], &gathered["present"]), (&json!(0), &json!(TRIALS)));
    lab.end().await;
    assert_eq!(with_twins(&of_service).await, of_chunks);

    // Another twin of trial 17, in the second chunk, stays, and nothing of this chunk is stored. The second run has
    // other trials.
    pressed(&of_other).await;
    let store = store(&of_other).await;
    let model = twin_model(of_chunks[0].model.as_ref().unwrap());
    let model = store.twin_model(model).await.unwrap();
    let outcome = TwinOutcome::Frame { voltages_v: vec![0.25; 784], rmse_v: 1.0, fvu: None };
    store.insert_twins(model, vec![Twin { trial: TrialId(17), outcome }]).await.unwrap();
    store.close().await;
    let lab = Filled::serve(of_other.clone()).await;
    let inputs = lab.get("/api/v1/runs/2/twins/inputs?limit=10").await;
    assert_eq!((&inputs["trials"], &inputs["next"]), (&json!(10), &json!(TRIALS + 10)));
    let inputs = lab.get(&format!("/api/v1/runs/2/twins/inputs?after={}", TRIALS + 40)).await;
    assert_eq!((&inputs["trials"], &inputs["next"]), (&json!(4), &Value::Null));
    lab.refuses_get("/api/v1/runs/2/twins/inputs?limit=0", 400, "must be from 1 to 10000").await;
    refused(&lab, "2", any_chunk(order), "is of run").await;
    refused(&lab, "1", b"no Parquet".to_vec(), "cannot be read").await;
    assert_eq!(lab.get("/api/v1/runs/2/twins").await["pending"], TRIALS);

    let gathered = gather(&lab, order).await;
    let words = String::from_utf8_lossy(&gathered.stderr).into_owned();
    assert!(!gathered.status.success(), "{words}");
    assert!(words.contains("chunk 1: trial 17: its stored twin differs"), "{words}");
    assert_eq!(lab.get("/api/v1/runs/1/twins").await["twins"], 11);
    lab.end().await;
    let trials = with_twins(&of_other).await;
    let frame = trials[16].frame.as_ref().unwrap();
    assert!(frame.iter().all(|bits| *bits == 0.25_f32.to_bits()), "the stored twin was replaced");
    for folder in [data, others, node.into()] {
        std::fs::remove_dir_all(folder).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_trial_keeps_no_other_run_from_its_twins() {
    let data = folder("twin-damage");
    pressed(&data).await;
    // Of the newest run, which gets its twins first.
    pressed(&data).await;
    with_responses(&data);
    let mut file = database(&data).await;
    let first = i64::from(TRIALS) + 1;
    let damage = "UPDATE trial_voltages SET voltages_v = zeroblob(3136) WHERE trial = ?1";
    let damaged = sqlx::query(damage).bind(first).execute(&mut file).await.unwrap();
    assert_eq!(damaged.rows_affected(), 1);
    file.close().await.unwrap();
    let lab = Filled::serve_as(data, |options| options.twin_workers = 1).await;
    lab.until("/api/v1/runs/1/twins", TWINS_WITHIN, |count| count["pending"] == 0).await;
    let count = lab.get("/api/v1/runs/2/twins").await;
    assert_eq!((&count["twins"], &count["pending"]), (&json!(0), &json!(TRIALS)));
    lab.close().await;
}
