//! What a name refers to, when it refers to something else, and what an id keeps.

use std::collections::BTreeMap;
use std::time::Duration;

use palpate::dataset::format::Rows;
use palpate::dataset::read::DatasetRows;
use palpate::dataset::select::Wanted;
use palpate::ids::ModelId;
use palpate::store::ModelRow;
use rand::SeedableRng;
use serde_json::{Value, json};

use super::filled::{self, Filled};
use crate::support::{until, with_extension};

/// Trials of the Real-Hex run by what becomes of them in `real`: forces pass 5 N from depth 3 on.
const TRIALS: u64 = 330;
const UNTOUCHED: u64 = 30 * 3;
const FLAGGED: u64 = 5;

#[tokio::test]
async fn real_is_labelled_split_and_says_what_it_leaves_out() {
    let lab = Filled::open("real").await;
    let real = lab.make("real").await;
    assert_eq!(real["rows"], TRIALS - UNTOUCHED - FLAGGED);
    let report = &real["report"];
    let left_out = json!({ "flagged: unsettled, depth_missed": FLAGGED, "no contact": UNTOUCHED });
    assert_eq!(report["left_out"], left_out);
    // Depth 3 presses with 5.0 and 5.3 N; the deadband itself counts.
    assert_eq!(report["contact_counts"], json!({ "2": TRIALS - UNTOUCHED - FLAGGED }));
    let untouched = lab.make("real-untouched").await;
    let counts = &untouched["report"]["contact_counts"];
    assert_eq!([&untouched["rows"], &counts["0"]], [90, 90]);
    let unseen = lab.make("real-unseen").await;
    assert_eq!(unseen["rows"], 12);
    // Nominal contacts stay though they are under the deadband.
    assert_eq!(unseen["report"]["contact_counts"], json!({ "2": 4, "3": 4, "4": 4 }));
    let transfer = lab.make("r2s-transfer").await;
    assert_eq!(transfer["rows"], TRIALS - UNTOUCHED - FLAGGED - 3);
    assert_eq!(transfer["report"]["left_out"]["no simulated twin yet"], 3);
    lab.close().await;
}

/// Rows as maps, by trial.
async fn rows(lab: &Filled, dataset: &str, columns: &str) -> BTreeMap<i64, Value> {
    let path = format!("/api/v1/datasets/{dataset}/rows?limit=10000&columns=trial_id,{columns}");
    lab.make(dataset).await;
    let rows = lab.items(&path).await.into_iter();
    rows.map(|row| (row["trial_id"].as_i64().unwrap(), row)).collect()
}

#[tokio::test]
async fn equal_places_never_straddle_a_split_and_datasets_divide_alike() {
    let lab = Filled::open("split").await;
    let real = rows(&lab, "real", "split,configuration").await;
    let mut parts: BTreeMap<u64, BTreeMap<String, u64>> = BTreeMap::new();
    for row in real.values() {
        // Of three configurations the second and the third are one and the same draw.
        let draw = row["configuration"].as_u64().unwrap();
        let draw = draw - draw % 3 / 2;
        let part = row["split"].as_str().unwrap().to_owned();
        *parts.entry(draw).or_default().entry(part).or_default() += 1;
    }
    assert!(parts.values().all(|parts| parts.len() == 1), "{parts:?}");
    let of = |part: &str| real.values().filter(|row| row["split"] == part).count() as f64;
    let all = real.len() as f64;
    for (part, share) in [("train", 0.6), ("validation", 0.2), ("test", 0.2)] {
        assert!((of(part) / all - share).abs() < 0.1, "{part}: {} of {all}", of(part));
    }
    let transfer = rows(&lab, "r2s-transfer", "split").await;
    assert!(transfer.len() > 200);
    for (trial, row) in &transfer {
        assert_eq!(row["split"], real[trial]["split"], "trial {trial}");
    }
    // By trial, as in the paper's tables, and in every number of contacts alike.
    let by_trial = json!({ "name": "by-trial", "task": "real", "deadband_n": 10.0,
        "split": { "by": "trial", "stratify": true } });
    let made = lab.defined(by_trial).await;
    let by_trial = rows(&lab, made["id"].as_str().unwrap(), "split,contact_count").await;
    for contacts in 1..=2 {
        let of = |part: &str| {
            let rows = by_trial.values();
            rows.filter(|r| r["contact_count"] == contacts && r["split"] == part).count() as i64
        };
        let [train, validation, test] = ["train", "validation", "test"].map(of);
        let all = train + validation + test;
        // Flagged trials take part in the draw and are excluded after it.
        assert!((5 * train - 3 * all).abs() <= 30, "{contacts}: {train} {validation} {test}");
        assert!((5 * test - all).abs() <= 30, "{contacts}: {train} {validation} {test}");
    }
    lab.close().await;
}

#[tokio::test]
async fn an_id_is_its_contents_and_a_name_follows_them() {
    let lab = Filled::open("ids").await;
    let first = lab.make("r2s-transfer").await;
    let id = first["id"].as_str().unwrap().to_owned();
    assert!(id.starts_with("ds-") && id.len() == 19, "{id}");
    let again = lab.make("r2s-transfer").await;
    assert_eq!(lab.get("/api/v1/datasets?limit=1").await["making"], json!([]), "it is made");
    assert_eq!((&again["id"], &again["created_at"]), (&first["id"], &first["created_at"]));
    // Made again from nothing, it is the same file.
    let file = lab.data.join("datasets").join(format!("{id}.parquet"));
    let bytes = std::fs::read(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert_eq!(lab.refused(&format!("/api/v1/datasets/{id}")).await.0, 404);
    assert_eq!(lab.make("r2s-transfer").await["id"], first["id"]);
    assert_eq!(std::fs::read(&file).unwrap(), bytes);
    // Another deadband produces other labels: another dataset.
    let softer = json!({ "name": "softer", "task": "r2s-transfer", "deadband_n": 6.0 });
    assert_ne!(lab.defined(softer).await["id"], first["id"]);
    // Twins of a newer model: the name refers to another dataset, the id still the old one.
    let data = lab.end().await;
    let store = filled::store(&data).await;
    let run = store.run_by_scan_id(1).await.unwrap().unwrap().uid;
    let mut chance = rand_chacha::ChaCha8Rng::seed_from_u64(9);
    filled::twins(&store, run, "sim-0000000000000002", &mut chance).await;
    store.close().await;
    let lab = Filled::serve(data).await;
    // Reading makes nothing: the name stands for the newest one that was made, and says so.
    let old = lab.get("/api/v1/datasets/r2s-transfer").await;
    assert_eq!((&old["id"], &old["is_current"]), (&first["id"], &json!(false)));
    let rows = "/api/v1/datasets/r2s-transfer/rows?columns=trial_id&limit=100";
    let page = lab.get(rows).await;
    let newer = lab.make("r2s-transfer").await;
    assert_ne!(newer["id"], first["id"]);
    let found = lab.get("/api/v1/datasets/r2s-transfer").await;
    assert_eq!((&found["id"], &found["is_current"]), (&newer["id"], &json!(true)));
    assert_eq!(found["label"], "virtual", "as its runs");
    // Pages stay with the dataset that they began in.
    let second = format!("{rows}&cursor={}", page["next"].as_str().unwrap());
    assert_eq!(lab.get(&second).await["dataset"], first["id"]);
    assert_eq!(lab.get(rows).await["dataset"], newer["id"]);
    let file = lab.answer("/api/v1/data/r2s-transfer.parquet").await;
    let address = format!("/api/v1/data/{}.parquet", newer["id"].as_str().unwrap());
    assert_eq!(file.headers()["content-location"], address.as_str());
    assert_eq!(lab.get(&format!("/api/v1/datasets/{id}")).await["sha256"], first["sha256"]);
    let origin = lab.get(&format!("/api/v1/datasets/{id}/lineage")).await;
    assert_eq!(origin["files"][0]["sha256"], first["sha256"]);
    assert_eq!(origin["files"][0]["url"], format!("/api/v1/data/{id}.parquet").as_str());
    let lineage = &origin["lineage"];
    assert_eq!(lineage["models"][0]["model"], "sim-0000000000000001");
    assert_eq!(lineage["models"][0]["calibration"], "cal-1");
    assert_eq!(lineage["runs"][0]["scan_id"], 1);
    assert!(lineage["runs"][0]["sensor_sha256"].as_str().unwrap().len() == 64);
    let card = lab.answer(&format!("/api/v1/datasets/{id}/card")).await.text().await.unwrap();
    for words in [id.as_str(), "**Virtual**", "made-up-hex", "no contact | 90", "injection-major"] {
        assert!(card.contains(words), "{words}: {card}");
    }
    // As if the service had been killed before it wrote the card.
    std::fs::remove_file(lab.data.join(format!("datasets/{id}.md"))).unwrap();
    let again = lab.answer(&format!("/api/v1/datasets/{id}/card")).await.text().await.unwrap();
    assert_eq!(again, card);
    lab.close().await;
}

#[tokio::test]
async fn older_datasets_go_on_request_unless_a_model_was_trained_on_them() {
    let lab = Filled::open("prune").await;
    let mut made = Vec::new();
    for force_n in 1..=3 {
        let toml = format!(
            "name = \"mine\"\ntask = \"real\"\nwhere = [\"max_force_n__gt={force_n}\"]\n\
             [split]\nratio = [3, 1, 1]\nseed = 1\n"
        );
        made.push(lab.posted("/api/v1/datasets", json!({ "toml": toml }), 200).await);
    }
    let id = |at: usize| made[at]["id"].as_str().unwrap().to_owned();
    // A statement would read the table of this name.
    let hidden = json!({ "toml": "name = \"events\"\ntask = \"real\"\n" });
    lab.refuses("/api/v1/datasets", hidden, 400, "name of a table").await;
    let store = filled::store(&lab.data).await;
    let model = ModelRow {
        id: ModelId::unchecked("mdl-1"),
        name: "net".into(),
        task: "transfer".into(),
        manifest: format!("datasets = [\"{}\"]\n", id(0)),
        created_at: jiff::Timestamp::UNIX_EPOCH,
    };
    store.insert_model(model).await.unwrap();
    store.close().await;
    let file = |at: usize, ending: &str| lab.data.join(format!("datasets/{}.{ending}", id(at)));

    let path = "/api/v1/datasets/prune";
    lab.posted(path, json!({ "keep": 0 }), 422).await;
    for dry_run in [true, false] {
        let pruned = lab.posted(path, json!({ "keep": 1, "dry_run": dry_run }), 200).await;
        let rows = pruned["datasets"].as_array().unwrap();
        let stays = |at: usize| &rows.iter().find(|row| row["id"] == id(at)).unwrap()["stays"];
        assert_eq!(stays(0), "model mdl-1 refers to it");
        assert_eq!(stays(1), &Value::Null);
        assert_eq!(stays(2), "one of the 1 newest of its name");
        assert_eq!(rows.iter().filter(|row| row["stays"].is_null()).count(), 1, "{pruned}");
        assert_eq!(pruned["freed_bytes"], made[1]["bytes"]);
        assert_eq!(pruned["dry_run"], dry_run);
        assert_eq!([file(1, "parquet"), file(1, "md")].map(|file| file.exists()), [dry_run; 2]);
    }
    let gone = lab.refused(&format!("/api/v1/datasets/{}", id(1))).await;
    assert_eq!(gone.0, 404, "{}", gone.1);
    for at in [0, 2] {
        let stays = lab.get(&format!("/api/v1/datasets/{}", id(at))).await;
        assert_eq!(stays["rows"], made[at]["rows"]);
    }
    lab.close().await;
}

#[tokio::test]
async fn a_run_that_ended_gets_its_file_by_itself() {
    let lab = Filled::open("kept").await;
    let folder = lab.data.join("datasets");
    // The folder may not be there yet.
    let count = async || folder.is_dir().then(|| with_extension(&folder, "parquet").len());
    until("a file of each run", Duration::from_secs(30), count, |count| *count >= Some(2)).await;
    let run = lab.make("run-1").await;
    assert_eq!(run["rows"], TRIALS);
    let path = folder.join(format!("{}.parquet", run["id"].as_str().unwrap()));
    assert!(path.with_extension("md").is_file());
    let rows = DatasetRows::open(&path, &Wanted::default()).unwrap();
    assert_eq!(rows.count(), TRIALS);
    assert!(rows.schema().index_of("sim_voltages_v").is_ok());
    lab.close().await;
}

#[tokio::test]
async fn what_cannot_be_made_is_explained() {
    let lab = Filled::open("refusals").await;
    lab.refuses_get("/api/v1/datasets/real", 404, "palpate dataset make real").await;
    let (status, words) = lab.refused("/api/v1/datasets/reel").await;
    assert_eq!(status, 404);
    assert!(words.contains("r2s-transfer") && words.contains("run-N"), "{words}");
    let new = |more: Value| {
        let mut definition = json!({ "name": "mine", "task": "s2s-recon" });
        definition.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        json!({ "definition": definition })
    };
    for (more, status, words) in [
        (json!({ "runs": ["nobody"] }), 404, "runs = nobody: no run has this"),
        (json!({ "sim_random": ["seed-9"] }), 404, "seed-9"),
        (json!({ "sim_random": ["../../etc"] }), 400, "without . or .."),
        (json!({ "where": ["contacts__gt=3"] }), 400, "cannot be compared"),
        (json!({ "deadband_n": -1.0 }), 400, "deadband_n = -1"),
        (json!({ "contact_counts": [6] , "runs": ["2"] }), 200, ""),
    ] {
        let (found, body) = lab.post("/api/v1/datasets", new(more)).await;
        assert_eq!(found, status, "{body}");
        let detail = body["detail"].as_str().unwrap_or_default();
        assert!(detail.contains(words), "{detail}");
    }
    let toml =
        json!({ "file": "d.toml", "toml": "name = \"x\"\ntask = \"real\"\nflagged = \"maybe\"\n" });
    let body = lab.posted("/api/v1/datasets", toml, 400).await;
    let detail = body["detail"].as_str().unwrap();
    assert!(detail.contains("d.toml: flagged") && detail.contains("leave-out"), "{detail}");
    lab.close().await;
}
