//! What is done at the desk: experiments and recipes that the program carries, the schema of one, a queued run that
//! is edited, start times, and simulations of contacts.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use jiff::{SignedDuration, Timestamp};
use palpate::journal::Journal;
use palpate::state::{StateChange, StoredState};
use reqwest::Method;
use serde_json::{Value, json};

use crate::datasets::filled::{Filled, folder, store};
use crate::support::{PALPATE, answered, is_refused};

const QUEUE: &str = "/api/v1/queue";
const SIMULATIONS: &str = "/api/v1/simulations";
const QUICKSTART: &str = include_str!("../../experiments/quickstart.toml");

/// A submission without the sensor: the program carries it.
fn submission(configurations: u32) -> Value {
    let definition =
        QUICKSTART.replace("configurations = 12", &format!("configurations = {configurations}"));
    json!({ "file": "q.toml", "definition": definition, "who": "ada" })
}

fn in_seconds(seconds: i64) -> String {
    (Timestamp::now() + SignedDuration::from_secs(seconds)).to_string()
}

impl Filled {
    async fn put(&self, run: &Value, tag: Option<&str>, body: &Value) -> (u16, Value) {
        let run = run.as_str().unwrap();
        let request = self.http.request(Method::PUT, self.url(&format!("{QUEUE}/{run}")));
        let request = match tag {
            Some(tag) => request.header("if-match", tag),
            None => request,
        };
        answered(request.json(body)).await
    }

    /// A POST is refused for this key of its body; returns the refusal.
    async fn refuses_key(&self, path: &str, body: Value, key: &str) -> Value {
        let refused = self.posted(path, body, 422).await;
        assert_eq!(refused["errors"][0]["key"], key, "{refused}");
        refused
    }

    async fn queue(&self, body: Value) -> Value {
        self.posted(QUEUE, body, 201).await
    }

    /// Arms a run and starts it; returns the code and the response.
    async fn started(&self, run: &Value) -> (Value, (u16, Value)) {
        let run = run.as_str().unwrap();
        let armed = self.posted(&format!("/api/v1/runs/{run}/arm"), json!({}), 200).await;
        let code = armed["code"].clone();
        (code.clone(), self.start(run, &code).await)
    }

    async fn start(&self, run: &str, code: &Value) -> (u16, Value) {
        let start = json!({ "action": "start", "code": code });
        self.post(&format!("/api/v1/runs/{run}/actions"), start).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_carried_experiment_can_be_queued_as_it_is() {
    let lab = Filled::serve(folder("desk-carried")).await;
    let items = lab.items("/api/v1/experiments").await;
    assert!(items.len() >= 11);
    let named = |name: &str| items.iter().find(|item| item["name"] == name).unwrap();
    let quickstart = named("quickstart");
    assert_eq!((&quickstart["text"], &quickstart["trials"]), (&json!(QUICKSTART), &json!(264)));
    assert!(quickstart["about"].as_str().unwrap().starts_with("The first command"));
    assert_eq!(quickstart["weights_n"], json!([]));
    assert_eq!(named("real-random")["weights_n"], json!([4.905, 7.358, 9.81]));
    for name in ["quickstart", "real-hex-1", "real-random"] {
        let item = named(name);
        let body = json!({ "file": item["file"], "definition": item["text"] });
        let (status, preflight) = lab.post("/api/v1/preflight", body.clone()).await;
        assert_eq!((status, &preflight["trials"]), (200, &item["trials"]), "{preflight}");
        let (status, tour) = lab.post("/api/v1/tour", body.clone()).await;
        assert_eq!((status, &tour["kind"]), (200, &item["kind"]), "{tour}");
        let run = lab.queue(body).await;
        assert_eq!(run["sensor"], crate::support::SENSOR);
        let queued = lab.get(&format!("/api/v1/runs/{}/tour", run["scan_id"])).await;
        for key in ["kind", "depths_mm", "force_limit_n", "force_sum_limit_n", "steps"] {
            assert_eq!(tour[key], queued[key], "{name}: {key}");
        }
        assert_eq!(tour["sensor"], lab.get("/api/v1/sensor").await, "{name}");
    }
    let other = QUICKSTART.replace("sensors/ert-28", "sensors/mine");
    let other = json!({ "file": "q", "definition": other });
    lab.refuses_key("/api/v1/tour", other.clone(), "sensor").await;
    let refused = lab.refuses_key(QUEUE, other, "sensor").await;
    assert!(refused["detail"].as_str().unwrap().contains("sensors/ert-28.toml"), "{refused}");
    let schema = lab.get("/api/v1/experiments/schema").await;
    let described = lab.get("/openapi.json").await;
    let component = &described["components"]["schemas"]["Experiment"];
    let keys =
        |of: &Value| of["properties"].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(keys(&schema), keys(component));
    assert_eq!(schema["properties"]["real_hex"]["properties"]["depths"]["maximum"], 1000);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn recipes_and_limits_of_the_rig_are_those_of_their_files() {
    let lab = Filled::serve(folder("desk-recipes")).await;
    let recipes = lab.items("/api/v1/recipes").await;
    let named = |name: &str| recipes.iter().find(|item| item["name"] == name).unwrap();
    let text = include_str!("../../experiments/recipes/recon-net.toml");
    assert_eq!(named("recon-net")["text"], text);
    let maps = named("recon-net")["maps"].as_array().unwrap();
    assert_eq!(maps[0], json!({ "map": "4x20", "side": 160, "channels": null }));
    assert_eq!(maps[11], json!({ "map": "20x60", "side": 32, "channels": [128, 64, 32] }));
    assert_eq!(named("transfer-net")["maps"], json!([]));
    let limits = lab.get("/api/v1/rig/limits").await;
    let rig: toml::Table = toml::from_str(crate::support::VIRTUAL_RIG).unwrap();
    let (bench, stated) = (&limits["bench"], rig["limits"].as_table().unwrap());
    assert_eq!(limits["frame_age_ms"].as_i64(), stated["frame_age_ms"].as_integer());
    assert_eq!(bench["force_n"].as_f64(), stated["force_n"].as_float());
    assert_eq!(bench["x_mm"][1].as_f64(), rig["axes"]["x"]["travel_mm"][1].as_float());
    let published = lab.get("/api/v1/published").await;
    assert_eq!(published["table_iv"].as_array().unwrap().len(), maps.len());
    let location_mm = &published["table_iv"][0]["score"]["location_mm"];
    assert_eq!(*location_mm, json!({ "mean": 11.0, "sd": 22.0 }));
    assert_eq!(published["table_iii"][5]["test"][5]["fvu_percent"], 4.2);
    assert_eq!(lab.get("/api/v1/vocabulary").await["trips"][0]["name"], "estop");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_without_a_rig_predicts_no_start_of_a_queued_run() {
    let lab = Filled::serve_as(folder("desk-no-rig"), |options| options.desk = true).await;
    lab.queue(submission(2)).await;
    let times = lab.get("/api/v1/queue/times").await["items"].clone();
    assert_eq!((&times[0]["begin"], &times[0]["end"]), (&Value::Null, &Value::Null), "{times}");
    let problem = times[0]["problem"].as_str().unwrap();
    assert!(problem.contains("without the rig: use `palpate serve`"), "{problem}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edited_run_has_a_new_plan_and_keeps_its_place() {
    let lab = Filled::serve(folder("desk-edit")).await;
    let first = lab.queue(submission(2)).await;
    let edited = lab.queue(submission(3)).await;
    lab.queue(submission(4)).await;
    let times = lab.get("/api/v1/queue/times").await["items"].clone();
    assert_eq!((&times[0]["run"], &times[2]["problem"]), (&first["uid"], &Value::Null), "{times}");
    assert!(times[0]["duration_s"].as_f64().unwrap() > 0.0, "{times}");
    assert!(times[1]["begin"].is_string() && times[1]["begin"] == times[0]["end"], "{times}");
    let seen = lab.tag(QUEUE).await;
    let plan = format!("/api/v1/runs/{}/plan", edited["uid"].as_str().unwrap());
    let before = lab.get(&plan).await;
    let mut other = submission(5);
    other["not_before"] = in_seconds(7200).into();
    let (status, row) = lab.put(&edited["uid"], Some(&seen), &other).await;
    assert_eq!(status, 200, "{row}");
    for key in ["uid", "scan_id", "queue_position", "created_at", "submitted_by", "state"] {
        assert_eq!(row[key], edited[key], "{key}");
    }
    assert_eq!((&edited["trials_planned"], &row["trials_planned"]), (&json!(66), &json!(110)));
    assert_eq!(row["definition"], other["definition"]);
    assert_ne!(row["plan_sha256"], edited["plan_sha256"]);
    assert_ne!(lab.get(&plan).await, before);
    assert!(row["not_before"].is_string());
    let queue = lab.get(QUEUE).await;
    assert_eq!((&queue["items"][1], queue["items"].as_array().unwrap().len()), (&row, 3));
    let logged = lab.get("/api/v1/actions?limit=1").await["items"][0].clone();
    assert_eq!((&logged["action"], &logged["run"]), (&json!("edit"), &edited["uid"]), "{logged}");
    // The other person saw the queue before; nothing has changed.
    let (status, refused) = lab.put(&edited["uid"], Some(&seen), &submission(6)).await;
    assert_eq!(status, 412, "{refused}");
    let sound = lab.tag(QUEUE).await;
    let mut wrong = submission(6);
    wrong["definition"] =
        QUICKSTART.replace("depths", "depth").replace("block = 6", "blok = 6").into();
    assert_eq!(lab.put(&edited["uid"], Some(&sound), &wrong).await.0, 422);
    let mut late = submission(6);
    late["not_before"] = in_seconds(400 * 86_400).into();
    let (status, refused) = lab.put(&edited["uid"], None, &late).await;
    assert_eq!((status, &refused["errors"][0]["key"]), (422, &json!("not_before")), "{refused}");
    assert_eq!(lab.tag(QUEUE).await, sound);
    // An edit without a start time removes it; the plan of nobody is gone, that of another run stays.
    let (status, row) = lab.put(&edited["uid"], None, &submission(2)).await;
    assert_eq!((status, &row["not_before"]), (200, &Value::Null), "{row}");
    assert_eq!(row["plan_sha256"], first["plan_sha256"]);
    assert_eq!(lab.put(&edited["uid"], None, &submission(3)).await.0, 200);
    lab.get(&format!("/api/v1/runs/{}/plan", first["uid"].as_str().unwrap())).await;
    assert_eq!(lab.put(&json!("999"), None, &submission(2)).await.0, 404);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_has_begun_is_neither_edited_nor_moved() {
    let lab = Filled::serve(folder("desk-begun")).await;
    let run = lab.queue(submission(2)).await;
    let data = lab.end().await;
    let store = store(&data).await;
    let uid = run["uid"].as_str().unwrap().parse().unwrap();
    store.run_state(uid, StateChange::to(StoredState::Running), Timestamp::now()).await.unwrap();
    store.close().await;
    let lab = Filled::serve(data).await;
    let refused = lab.put(&run["uid"], None, &submission(3)).await;
    is_refused(refused, 409, "only a queued run can be edited");
    let path = format!("{QUEUE}/{}/move", run["uid"].as_str().unwrap());
    let refused = lab.posted(&path, json!({ "position": 1 }), 409).await;
    let words = refused["detail"].as_str().unwrap();
    assert!(words.starts_with(&format!("run {} is ", run["scan_id"])), "{words}");
    assert!(words.ends_with("only a queued run can be moved"), "{words}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_started_before_its_time_waits_and_an_edit_ends_that() {
    let lab = Filled::serve(folder("desk-early")).await;
    let mut early = submission(2);
    early["not_before"] = in_seconds(7200).into();
    let run = lab.queue(early.clone()).await;
    assert_eq!(lab.get("/api/v1/status").await["waiting_for"], Value::Null);
    let (code, (status, answer)) = lab.started(&run["uid"]).await;
    assert_eq!((status, &answer["started"]), (202, &json!("waiting")), "{answer}");
    let words = lab.get("/api/v1/status").await["waiting_for"].clone();
    let from = run["not_before"].as_str().unwrap().split('.').next().unwrap();
    let expected = format!("run 1 (quickstart) starts at {from}Z or later");
    assert_eq!(words, expected);
    // The same files: what was armed is the earlier run nevertheless.
    let (status, row) = lab.put(&run["uid"], None, &submission(2)).await;
    assert_eq!((status, &row["waiting_since"]), (200, &Value::Null), "{row}");
    assert_eq!(lab.get("/api/v1/status").await["waiting_for"], Value::Null);
    let events = lab.get("/api/v1/events?since=0").await["items"].clone();
    let dropped = events.as_array().unwrap().iter().any(|event| event["kind"] == "not_begun");
    assert!(dropped, "{events:#}");
    let uid = run["uid"].as_str().unwrap();
    let (status, refused) = lab.start(uid, &code).await;
    assert_eq!(status, 409, "{refused}");
    // Its time has come: it is refused for the rig, which is not homed.
    let (_, (status, refused)) = lab.started(&run["uid"]).await;
    assert_eq!(status, 409, "{refused}");
    assert_eq!(lab.get("/api/v1/status").await["waiting_for"], Value::Null);
    lab.close().await;
}

fn by_command(data: &Path, contacts: &Value) -> Vec<f64> {
    let mut process = Command::new(PALPATE)
        .args(["simulate", "--contacts", "-"])
        .env("PALPATE_DATA", data)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    writeln!(process.stdin.take().unwrap(), "{}", json!({ "contacts": contacts })).unwrap();
    let output = process.wait_with_output().unwrap();
    numbers(&serde_json::from_slice::<Value>(&output.stdout).unwrap()["voltages_v"])
}

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn simulations_are_those_of_the_command() {
    let lab = Filled::serve(folder("desk-simulate")).await;
    let by_force = json!([
        { "x_mm": 265.5, "y_mm": 280.0, "force_n": 20.0 }, { "x_mm": 100.0, "y_mm": 90.0, "force_n": 7.5 },
    ]);
    let answer = lab.posted(SIMULATIONS, json!({ "contacts": by_force }), 200).await;
    assert_eq!(numbers(&answer["voltages_v"]), by_command(&lab.data, &by_force));
    assert_eq!(numbers(&answer["untouched_v"]), by_command(&lab.data, &json!([])));
    assert_eq!(answer["model"], "sensor file");
    assert_eq!(answer["contacts"][1]["force_n"], 7.5);
    assert!(answer["took_ms"].as_f64().unwrap() > 0.0);
    let dent = &answer["dent_mm"];
    let [columns, rows] = ["columns", "rows"].map(|key| dent[key].as_u64().unwrap() as usize);
    let values = numbers(&dent["values"]);
    assert_eq!(values.len(), columns * rows);
    let deepest = values.iter().copied().fold(0.0, f64::max);
    assert!(deepest > 0.5 && values.iter().all(|mm| *mm >= 0.0), "{deepest} mm");
    // By the depth that it states, each contact has the same force again.
    let depths = answer["contacts"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| json!({ "x_mm": c["x_mm"], "y_mm": c["y_mm"], "depth_mm": c["depth_mm"] }));
    let by_depth = json!({ "contacts": depths.collect::<Vec<_>>(), "run": null });
    let again = lab.posted(SIMULATIONS, by_depth, 200).await;
    for (one, other) in [(0, 20.0), (1, 7.5)] {
        let force_n = again["contacts"][one]["force_n"].as_f64().unwrap();
        assert!((force_n - other).abs() < 1e-4, "{force_n} N for {other} N");
    }
    let (_, untouched) = lab.post(SIMULATIONS, json!({ "contacts": [] })).await;
    assert_eq!(untouched["voltages_v"], answer["untouched_v"]);
    // The run's sensor is the same one.
    let run = lab.queue(submission(2)).await;
    let of_run = json!({ "contacts": by_force, "run": run["scan_id"].to_string() });
    let (status, of_run) = lab.post(SIMULATIONS, of_run).await;
    assert_eq!((status, &of_run["voltages_v"]), (200, &answer["voltages_v"]));
    assert!(answer["fvu"].is_null());
    let logged = lab.get("/api/v1/actions?limit=1").await["items"][0].clone();
    assert_eq!(logged["action"], "queue", "simulations are not logged");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_frame_is_compared_with_that_of_a_stored_trial() {
    let lab = Filled::open("desk-compared").await;
    let trial = lab.get("/api/v1/trials?limit=1&voltages=true").await["items"][0].clone();
    let contacts = json!([{ "x_mm": 200, "y_mm": 300, "force_n": 20 }]);
    let compared = json!({ "contacts": contacts, "trial": trial["trial_id"] });
    let compared = lab.posted(SIMULATIONS, compared, 200).await;
    let measured_v: Vec<f32> = numbers(&trial["voltages_v"]).iter().map(|v| *v as f32).collect();
    let fvu = sim_core::stats::fvu(&measured_v, numbers(&compared["voltages_v"])).unwrap();
    assert!((compared["fvu"].as_f64().unwrap() - fvu).abs() < 1e-9, "{} {fvu}", compared["fvu"]);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_contact_beyond_its_limits_is_refused_with_field_and_limit() {
    let lab = Filled::serve(folder("desk-limits")).await;
    let refused =
        async |contacts: Value| lab.posted(SIMULATIONS, json!({ "contacts": contacts }), 422).await;
    let good = json!({ "x_mm": 270.0, "y_mm": 280.0, "force_n": 20.0 });
    let changed = |key: &str, value: Value| {
        let mut contact = good.clone();
        contact[key] = value;
        contact
    };
    let deep = |depth: f64| json!({ "x_mm": 270.0, "y_mm": 280.0, "depth_mm": depth });
    let on_skin = "a tip must be wholly on the skin";
    let one = "must have exactly one of depth_mm and force_n";
    for (contact, field, limit) in [
        (changed("x_mm", json!(9.5)), ".x_mm", format!("must be from 10 to 530 mm: {on_skin}")),
        (changed("y_mm", json!(-1)), ".y_mm", format!("must be from 10 to 550 mm: {on_skin}")),
        (changed("force_n", json!(1000.5)), ".force_n", "must be from 0 to 1000 N".into()),
        (changed("force_n", json!(-0.1)), ".force_n", "must be from 0 to 1000 N".into()),
        (deep(4.1), ".depth_mm", "must be from 0 to 4 mm, the thickness of the foam".into()),
        (deep(-0.1), ".depth_mm", "must be from 0 to 4 mm, the thickness of the foam".into()),
        (changed("depth_mm", json!(1.0)), "", one.into()),
        (changed("force_n", Value::Null), "", one.into()),
    ] {
        let error = refused(json!([good, contact])).await["errors"][0].clone();
        let found = (error["key"].as_str().unwrap(), error["limit"].as_str().unwrap());
        assert_eq!(found, (format!("contacts[1]{field}").as_str(), limit.as_str()), "{contact}");
    }
    let two = refused(json!([changed("x_mm", json!(0)), changed("force_n", json!(-1))])).await;
    assert_eq!(two["errors"].as_array().unwrap().len(), 2, "{two}");
    let many = refused(json!(vec![good.clone(); 7])).await["errors"][0].clone();
    assert_eq!(many["limit"], "must be at most 6 contacts");
    refused(json!([changed("depth", json!(1.0))])).await;
    for body in [r#"{"contacts":[{"x_mm":NaN}]}"#, r#"{"contacts":[{"x_mm":1e999}]}"#, "{"] {
        let request =
            lab.http.post(lab.url(SIMULATIONS)).header("content-type", "application/json");
        assert_eq!(request.body(body).send().await.unwrap().status(), 400, "{body}");
    }
    lab.posted(SIMULATIONS, json!({ "contacts": [], "run": "999999" }), 404).await;
    lab.posted(SIMULATIONS, json!({ "contacts": [], "trial": 999_999 }), 404).await;
    lab.close().await;
}
