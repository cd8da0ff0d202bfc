//! A data folder of an earlier version, opened with today's: every record has the value that was recorded
//! with SQLite when the folder was made, and the run that was killed can resume.
//! `tests/it/fixtures/README.md` states how the folder was made. Never: a value that today's code stored.

use std::path::Path;
use std::time::Duration;

use jiff::Timestamp;
use palpate::campaign::run::resume;
use palpate::digest::sha256_hex;
use palpate::infer::plan::Plan as Net;
use palpate::journal::Journal;
use palpate::rig::config::RigConfig;
use palpate::schedule::experiment::Experiment;
use palpate::schedule::plan::{Plan, Step};
use palpate::store::{RunRow, Soundness, Store, TaskKind, TrialQuery, TrialRow};
use serde_json::{Value, json};
use sim_core::sensor::Sensor;

use crate::datasets::filled::{Filled, store};
use crate::support::Folder;

/// Runs of the folder, by their order: the last was queued when the service was killed.
pub const WHOLE: usize = 0;
pub const HALF: usize = 1;
pub const NEXT: usize = 2;

const CHANNELS: usize = 784;

/// Longest wait for the state of a run after the start of the service.
const LIMIT: Duration = Duration::from_secs(30);

/// What was recorded when the folder was made.
pub fn recorded() -> Value {
    serde_json::from_str(include_str!("fixtures/expected.json")).unwrap()
}

pub fn copy(name: &str) -> Folder {
    let copy = Folder::new(&format!("old-data-{name}"));
    unpack(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/fixtures/data")), &copy);
    copy
}

/// A service on a copy of the folder, after it has marked the killed run.
pub async fn served(name: &str) -> (Folder, Filled) {
    let folder = copy(name);
    let lab = Filled::serve(folder.to_path_buf()).await;
    lab.until("/api/v1/runs/2", LIMIT, |killed| killed["state"] == "interrupted").await;
    (folder, lab)
}

/// Decompresses the files of a folder.
fn unpack(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            unpack(&path, &to.join(path.file_name().unwrap()));
        } else {
            let file = std::fs::File::open(&path).unwrap();
            let to = to.join(path.file_stem().unwrap());
            std::fs::write(to, zstd::decode_all(file).unwrap()).unwrap();
        }
    }
}

/// Each value of `wanted` is in `found`: null or absent alike, times as instants, numbers as far as JSON
/// carries them (the checksums cover every bit).
fn assert_holds(found: &Value, wanted: &Value, at: &str) {
    match (found, wanted) {
        (Value::Object(found), Value::Object(wanted)) => {
            for (key, wanted) in wanted {
                let found = found.get(key).unwrap_or(&Value::Null);
                assert_holds(found, wanted, &format!("{at}.{key}"));
            }
        }
        (Value::Array(found), Value::Array(wanted)) => {
            assert_eq!(found.len(), wanted.len(), "{at}");
            for (n, (found, wanted)) in found.iter().zip(wanted).enumerate() {
                assert_holds(found, wanted, &format!("{at}[{n}]"));
            }
        }
        (Value::Number(found), Value::Number(wanted)) => {
            let (found, wanted) = (found.as_f64().unwrap(), wanted.as_f64().unwrap());
            let is_near = (found - wanted).abs() <= f64::EPSILON * wanted.abs();
            assert!(is_near, "{at}: {found} {wanted}");
        }
        (Value::String(found), Value::String(wanted)) if at.ends_with("at") => {
            let time = |text: &str| text.parse::<Timestamp>().map_err(|_| text.to_owned());
            assert_eq!(time(found), time(wanted), "{at}");
        }
        _ => assert_eq!(found, wanted, "{at}"),
    }
}

fn volts_sha256(volts: &[f32]) -> String {
    sha256_hex(volts.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>())
}

/// A trial under the names of the recorded values.
async fn trial(store: &Store, row: &TrialRow) -> Value {
    let mut found = json!(row);
    let frames = store.frames(row.trial_id).await.unwrap();
    let frames = frames.iter().map(|frame| {
        let counts: Vec<u8> = frame.counts.iter().flat_map(|c| c.to_le_bytes()).collect();
        json!({ "sequence": frame.sequence, "device_time_us": frame.device_time_us,
            "volts_per_count": frame.volts_per_count, "counts_sha256": sha256_hex(&counts) })
    });
    found["frames"] = frames.collect();
    found["voltages_sha256"] = json!(row.voltages_v.as_deref().map(volts_sha256));
    found["sim_voltages_sha256"] = json!(row.sim_voltages_v.as_deref().map(volts_sha256));
    found
}

async fn runs(store: &Store) -> Vec<RunRow> {
    let mut runs = store.runs(&[], 100, None).await.unwrap().runs;
    runs.reverse();
    runs
}

/// All trials with their frames and their twins' frames, each compared with its checksum.
async fn trials(store: &Store) -> Vec<TrialRow> {
    let ids = store.trial_ids(&TrialQuery { limit: 100, ..TrialQuery::default() }).await.unwrap();
    store.trials_with_voltages(&ids).await.unwrap()
}

#[tokio::test]
async fn every_record_of_an_earlier_version_has_the_value_that_was_recorded() {
    let (folder, recorded) = (copy("records"), recorded());
    let store = store(&folder).await;
    assert_eq!(store.examine(1000).await.unwrap(), Soundness::Sound);
    assert_holds(&json!(runs(&store).await), &recorded["runs"], "runs");
    let mut found = Vec::new();
    for row in trials(&store).await {
        found.push(trial(&store, &row).await);
    }
    assert_holds(&json!(found), &recorded["trials"], "trials");
    let events = store.events_since(0, 1000, None, &[]).await.unwrap();
    assert_holds(&json!(events), &recorded["events"], "events");
    let (queue, next) = (store.queue().await.unwrap(), &recorded["runs"][NEXT]);
    assert_holds(&json!(queue), &json!([next]), "queue");
    for (n, run) in runs(&store).await.iter().map(|run| run.uid).enumerate() {
        let counts = json!({
            "tares": store.tares(run).await.unwrap().len(),
            "reference_presses": store.references(run).await.unwrap().len(),
            "touch_offs": store.touch_offs(run).await.unwrap().len(),
            "skips": store.skips(run).await.unwrap().len(),
            "attempts": store.attempts(run, u32::MAX).await.unwrap().len(),
            "actions": store.actions(Some(run), 100, None).await.unwrap().len(),
        });
        for (table, wanted) in recorded["counts"].as_object().unwrap() {
            assert_eq!(counts[table], wanted[n], "{table} of run {}", n + 1);
        }
    }
    assert_eq!(store.last_mounted().await.unwrap().unwrap().tips, 2);
    store.close().await;
}

#[tokio::test]
async fn datasets_models_and_jobs_of_an_earlier_version_have_the_values_that_were_recorded() {
    let (folder, recorded) = (copy("made"), recorded());
    let store = store(&folder).await;
    let datasets = store.datasets().await.unwrap();
    let datasets = datasets.iter().map(|d| {
        json!({ "id": d.id, "name": d.name, "rows": d.rows, "bytes": d.bytes, "sha256": d.sha256,
            "created_at": d.created_at })
    });
    assert_holds(&datasets.collect(), &recorded["datasets"], "datasets");
    let models = store.models().await.unwrap();
    let models = models.iter().map(|m| {
        json!({ "id": m.id, "name": m.name, "task": m.task, "manifest": m.manifest,
            "created_at": m.created_at })
    });
    assert_holds(&models.collect(), &recorded["models"], "models");
    let jobs = store.tasks(TaskKind::JOBS, 100, None).await.unwrap();
    let jobs = jobs.iter().map(|j| {
        json!({ "id": j.id, "kind": j.kind, "state": j.state, "dataset": j.dataset,
            "result": j.result, "asked_by": j.asked_by, "created_at": j.created_at,
            "started_at": j.started_at, "finished_at": j.finished_at })
    });
    assert_holds(&jobs.collect(), &recorded["jobs"], "jobs");
    let promotions = store.promotions().await.unwrap();
    let promotions = promotions
        .iter()
        .map(|p| json!({ "slot": p.slot, "what": p.what, "who": p.who, "why": p.why, "at": p.at }));
    assert_holds(&promotions.collect(), &recorded["promotions"], "promotions");
    store.close().await;
}

#[tokio::test]
async fn todays_plan_of_a_killed_run_is_the_one_that_its_trials_followed() {
    let folder = copy("plan");
    let store = store(&folder).await;
    let open = store.open_runs().await.unwrap();
    let [half] = &open[..] else { panic!("{open:?}") };
    assert_eq!(*half, runs(&store).await[HALF]);
    let experiment = Experiment::from_toml("half.toml", &half.definition).unwrap();
    let sensor = Sensor::from_toml(&half.sensor).unwrap();
    RigConfig::from_toml("served.toml", half.rig.as_ref().unwrap()).unwrap();
    let plan = Plan::of("half.toml", &experiment, &sensor).unwrap();
    assert_eq!(plan.trials(), half.trials_planned);
    for trial in trials(&store).await.iter().filter(|trial| trial.run == half.uid) {
        let mut planned = plan.configurations();
        let planned = planned.find(|c| c.index == trial.configuration).unwrap();
        assert_eq!(trial.depth_mm, Some(plan.depths_mm[trial.depth_index as usize]));
        assert_eq!(trial.target.unwrap().radius_mm, planned.stand.radius_mm);
        assert_eq!(trial.arms.len(), planned.stand.tips_mm.len());
        for (arm, [x_mm, y_mm]) in trial.arms.iter().zip(&planned.stand.tips_mm) {
            let off_mm = (arm.x_mm - x_mm).hypot(arm.y_mm - y_mm);
            assert!(off_mm < 0.5, "{arm:?}, planned at {x_mm}, {y_mm}");
        }
    }
    // Four trials of three depths each: the second configuration lacks two.
    let progress = store.progress(half.uid).await.unwrap();
    assert_eq!(progress.stored.len(), 4);
    let depths = plan.depths_mm.len();
    let entry = resume::entry(&plan.steps, depths, &progress).unwrap();
    let Step::Configuration(next) = &plan.steps[entry.next] else { panic!("{entry:?}") };
    assert_eq!((next.index, resume::pending_depths(next, depths, &progress)), (1, vec![1, 2]));
    store.close().await;
}

#[tokio::test]
async fn a_service_offers_the_killed_run_and_serves_what_was_made() {
    let recorded = recorded();
    let (_folder, lab) = served("service").await;
    let path =
        |run: usize| format!("/api/v1/runs/{}", recorded["runs"][run]["uid"].as_str().unwrap());
    let half = lab.get(&path(HALF)).await;
    assert_eq!((&half["state"], &half["paused_why"]), (&json!("interrupted"), &json!("restart")));
    // Arming is the first step of a resume; it needs no rig.
    for (run, wanted) in [(WHOLE, 409), (HALF, 200), (NEXT, 200)] {
        let (status, armed) =
            lab.post(&format!("{}/arm", path(run)), json!({ "who": "Ada" })).await;
        assert_eq!(status, wanted, "{armed}");
        assert_eq!(armed["code"].is_string(), wanted == 200, "{armed}");
    }
    let summary = lab.get(&format!("{}/summary", path(WHOLE))).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}");

    let dataset = &recorded["datasets"][0];
    let id = dataset["id"].as_str().unwrap();
    let found = lab.get(&format!("/api/v1/datasets/{id}")).await;
    assert_holds(&found, dataset, "dataset");
    let file = lab.answer(&format!("/api/v1/data/{id}.parquet")).await.bytes().await.unwrap();
    assert_eq!(dataset["sha256"], sha256_hex(&file).as_str());
    let columns = "trial_id,voltages_v,sim_voltages_v";
    let rows = lab.items(&format!("/api/v1/datasets/{id}/rows?limit=100&columns={columns}")).await;
    assert_eq!(dataset["rows"], rows.len());
    for row in rows {
        let trials = recorded["trials"].as_array().unwrap();
        let trial = trials.iter().find(|t| t["trial_id"] == row["trial_id"]).unwrap();
        for (column, sum) in
            [("voltages_v", "voltages_sha256"), ("sim_voltages_v", "sim_voltages_sha256")]
        {
            let volts = row[column].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32);
            assert_eq!(volts_sha256(&volts.collect::<Vec<_>>()), trial[sum], "{column} {row}");
        }
    }

    let model = &recorded["models"][0];
    let id = model["id"].as_str().unwrap();
    let found = lab.get("/api/v1/models/old-transfer").await;
    assert_eq!((&found["id"], &found["task"]), (&model["id"], &model["task"]));
    let onnx = lab.answer(&format!("/api/v1/models/{id}/onnx")).await.bytes().await.unwrap();
    let net = Net::load(&onnx, CHANNELS, &[CHANNELS]).unwrap();
    let mut answer = Vec::new();
    net.answer(&[0.01; CHANNELS], &mut answer).unwrap();
    assert!(answer.len() == CHANNELS && answer.iter().all(|v| v.is_finite()));
    let serving = lab.get("/api/v1/serving").await;
    let serves = serving["serves"].as_array().unwrap();
    assert!(serves.contains(&json!({ "slot": "transfer", "what": id })), "{serving:#}");
    let job = &recorded["jobs"][0];
    let found = lab.get(&format!("/api/v1/jobs/{}", job["id"].as_str().unwrap())).await;
    assert_eq!((&found["state"], &found["result"]), (&job["state"], &job["result"]));
    lab.end().await;
}
