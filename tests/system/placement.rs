//! Manual trials on a skin alone: weights on wrong points are refused, placed anyway, repeated, and the run
//! resumes where it stopped.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use serde_json::{Value, json};
use sim_core::calibration::{Calibration, Fitted, PiezoCalibration};
use sim_core::sensor::Sensor;
use virtual_rig::run::RigArgs;

use super::bench::{Lab, SENSOR, WAITS, answered, file, http, is_refused, rig_args};

/// Process seconds in a wall second.
const SPEED: f64 = 10.0;
const WHO: &str = "ada";

/// Four placements of two weights.
const FOUR: &str = "name = 'weights'\nseed = 2\nsensor = 's'\n[real_random]\ncontacts = [2]\n\
    trials_each = 4\nweights_n = [4.905, 9.81]\n[measure]\nframes_per_trial = 5\n";

/// A skin that is as its nominal model predicts, except for noise: what a calibrated one is to its model. Tests run at
/// the same time: one of them writes the file.
static GAP_FREE: LazyLock<PathBuf> = LazyLock::new(|| {
    let text = std::fs::read_to_string(file("gaps/gap-a.toml")).unwrap();
    let line = |line: &str| {
        let key = line.split(" = ").next().unwrap().to_owned();
        match key.as_str() {
            "noise_sd_mv" => line.to_owned(),
            "limit_mm" => "limit_mm = 1000.0".into(),
            "contact_ohm" => "contact_ohm = 1e-3".into(),
            "lead_ohm" | "soft_compliance" | "softening" => format!("{key} = 0.0"),
            key if key.contains("_sd") => format!("{key} = 0.0"),
            _ => line.to_owned(),
        }
    };
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("gap-free.toml");
    std::fs::write(&path, text.lines().map(line).collect::<Vec<_>>().join("\n")).unwrap();
    path
});

pub fn skin_alone() -> RigArgs {
    RigArgs { gap: GAP_FREE.clone(), ..rig_args("skin-only", SPEED) }
}

/// The calibration that states the nominal values.
fn nominal() -> String {
    let piezo = Sensor::from_toml(SENSOR).unwrap().file.piezo;
    let exactly = |value| Fitted { value, low_95: value, high_95: value };
    let piezo = PiezoCalibration {
        data_sha256: "0".repeat(64),
        rows: 10,
        compression_mm: [0.1, 3.0],
        residual_sd_ln: 0.01,
        a_ohm: exactly(piezo.a_ohm),
        b_per_mm: exactly(piezo.b_per_mm),
        c_ohm: Some(exactly(piezo.c_ohm)),
    };
    let sensor = Sensor::from_toml(SENSOR).unwrap().file.name;
    let (foam, voltage, skin) = (None, None, None);
    Calibration { sensor, piezo: Some(piezo), foam, voltage, skin }.to_toml().unwrap()
}

/// Lets `exact` serve with the nominal skin, after a request that names its calibration was answered.
pub async fn serve_exact(lab: &Lab) {
    let url = format!("{}/api/v1/calibrations", lab.service.url());
    let (status, id) = answered(http().post(url).body(nominal())).await;
    assert_eq!(status, 201, "{id}");
    let frame = vec![0.0; 784];
    let named = json!({ "method": "exact", "model": id, "frames": [frame] });
    let answers = lab.posted("/api/v1/infer", named).await;
    assert_eq!(answers[0]["model"], id, "{answers}");
    let unnamed = json!({ "method": "exact", "frames": [frame] });
    let (status, refused) = lab.post("/api/v1/infer", unnamed).await;
    assert_eq!(status, 409, "it was not promoted: {refused}");
    let serves = lab.posted("/api/v1/serving", json!({ "what": id })).await;
    assert_eq!(serves["slot"], "skin", "{serves}");
    let limitation = serves["limitation"].as_str().unwrap_or_default();
    assert!(limitation.contains("errors of the skin's model are unknown"), "no run: {serves}");
}

async fn connect(lab: &Lab) {
    lab.operate(json!({ "action": "connect", "who": WHO })).await;
}

/// Waits until the run asks for a placement; returns it.
async fn asked(lab: &Lab, trial: u64) -> Value {
    let asks = |s: &Value| {
        s["run"]["paused_why"] == "manual_trial" && s["run"]["wanted"]["trial"] == trial
    };
    lab.until("a placement", asks).await;
    let page = lab.get("/api/v1/placement").await;
    assert_eq!((&page["trial"], &page["stage"]), (&json!(trial), &json!("place")), "{page:#}");
    page
}

/// Confirms a placement that is right. In the noise of one window a weight may be felt as two; a person looks again.
async fn confirm_right(lab: &Lab, run: &str, trial: u64) {
    for _ in 0..2 {
        if lab.act(run, confirm(trial)).await.0 == 202 {
            return;
        }
    }
    lab.accepts(run, confirm(trial)).await;
}

/// Places the weights of a placement; `wrong`: the first one elsewhere, far from the others.
async fn place(lab: &Lab, page: &Value, wrong: bool) {
    let mut weights: Vec<Value> = page["contacts"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| json!({ "x_mm": c["x_mm"], "y_mm": c["y_mm"], "force_n": c["force_n"] }))
        .collect();
    if wrong {
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let far = |p: &&sim_core::sensor::Point| {
            weights.iter().all(|w| {
                let (x, y) = (w["x_mm"].as_f64().unwrap(), w["y_mm"].as_f64().unwrap());
                (x - p.x_mm).hypot(y - p.y_mm) > 100.0
            })
        };
        let p = sensor.points().iter().find(far).unwrap();
        (weights[0]["x_mm"], weights[0]["y_mm"]) = (p.x_mm.into(), p.y_mm.into());
    }
    lab.tell_rig(json!({ "cmd": "place", "weights": weights })).await;
}

fn confirm(trial: u64) -> Value {
    json!({ "action": "confirm", "trial": trial, "who": WHO })
}

/// Trials of a run by their index in the plan.
async fn trials(lab: &Lab, run: &str) -> BTreeMap<u64, Value> {
    let trials = lab.items(&format!("/api/v1/runs/{run}/trials?limit=100")).await;
    let count = trials.len();
    let by_index: BTreeMap<u64, Value> =
        trials.into_iter().map(|t| (t["configuration"].as_u64().unwrap(), t)).collect();
    assert_eq!(by_index.len(), count, "a trial is stored twice");
    by_index
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_placement_is_refused_placed_anyway_repeated_and_the_run_resumes() {
    let lab = Lab::open_alone("placement", skin_alone(), WAITS).await;
    serve_exact(&lab).await;
    connect(&lab).await;
    let status = lab.get("/api/v1/status").await;
    assert_eq!(status["rig"]["has_stage"], false);
    assert!(status["rig"]["force_limit_n"].is_null() && status["rig"]["pose"].is_null());
    let home = json!({ "action": "home", "who": WHO });
    assert_eq!(lab.post("/api/v1/rig/actions", home).await.0, 409, "there is nothing to home");
    let run = lab.begin(FOUR).await;

    // The empty skin is tared once.
    let page = asked(&lab, 0).await;
    assert_eq!(page["untouched_at"], Value::Null);
    lab.operate(json!({ "action": "tare", "who": WHO })).await;

    // Refused with the weight and where it is felt; nothing is stored.
    let page = asked(&lab, 0).await;
    let tared_at = page["untouched_at"].clone();
    assert!(tared_at.is_string(), "{page:#}");
    assert_eq!((&page["of"], &page["done"], &page["last"]), (&json!(4), &json!(0), &Value::Null));
    assert!(page["contacts"][0]["point"].as_str().unwrap().starts_with('R'), "{page:#}");
    place(&lab, &page, true).await;
    let (refused, problem) = lab.act(&run, confirm(0)).await;
    let detail = problem["detail"].as_str().unwrap();
    assert_eq!(refused, 409, "{problem:#}");
    let asked_at = format!("asked at {}", page["contacts"][0]["point"].as_str().unwrap());
    assert!(detail.contains("weight 1 (") && detail.contains(&asked_at), "{detail}");
    assert!(detail.contains(" mm ") && detail.contains("near R"), "{detail}");
    let page = asked(&lab, 0).await;
    assert_eq!(page["verdict"]["kind"], "wrong", "{page:#}");
    assert_eq!(page["felt"]["method"], "exact");
    assert!(trials(&lab, &run).await.is_empty());

    // Corrected.
    place(&lab, &page, false).await;
    let right = |page: &Value| page["verdict"]["kind"] == "right" && page["at_rest"] == true;
    let page = lab.eventually("a right placement", "/api/v1/placement", right).await;
    assert!(page["verdict"]["matches"][0]["distance_mm"].as_f64().unwrap() < 10.0, "{page:#}");
    confirm_right(&lab, &run, 0).await;
    let page = asked(&lab, 1).await;
    assert_eq!(page["last"]["trial"], 0, "{page:#}");
    assert_eq!(page["last"]["verdict"], "right", "{page:#}");
    assert_eq!(lab.act(&run, confirm(0)).await.0, 409, "it was confirmed");

    // The skin is seen untouched once the weights are lifted, and not before.
    let known_at = page["untouched_at"].clone();
    tokio::time::sleep(Duration::from_secs_f64(5.0 / SPEED)).await;
    assert_eq!(asked(&lab, 1).await["untouched_at"], known_at);
    lab.tell_rig(json!({ "cmd": "clear" })).await;
    let seen = |page: &Value| page["untouched_at"].as_str() > known_at.as_str();
    let page = lab.eventually("the untouched skin", "/api/v1/placement", seen).await;
    assert!(known_at.as_str() >= tared_at.as_str(), "{known_at} {tared_at}");

    // Anyway.
    place(&lab, &page, true).await;
    let mut anyway = confirm(1);
    anyway["anyway"] = true.into();
    lab.accepts(&run, anyway).await;
    asked(&lab, 2).await;
    let stored = trials(&lab, &run).await;
    assert_eq!((&stored[&0]["flags"], &stored[&1]["flags"]), (&json!([]), &json!(["doubted"])));
    assert_eq!(stored[&1]["placed_by"], format!("{WHO} (local)"));

    // Repeated, once, although it is asked for twice; then an earlier one by its number.
    let repeat = json!({ "action": "repeat", "who": WHO, "why": "wrong point" });
    lab.accepts(&run, repeat.clone()).await;
    let page = asked(&lab, 1).await;
    assert_eq!(lab.act(&run, repeat).await.0, 409);
    place(&lab, &page, false).await;
    confirm_right(&lab, &run, 1).await;
    asked(&lab, 2).await;
    let unknown = json!({ "action": "repeat", "trial": 3, "who": WHO });
    assert_eq!(lab.act(&run, unknown).await.0, 409, "it is not stored");
    let named = json!({ "action": "repeat", "trial": 0, "who": WHO });
    lab.accepts(&run, named).await;
    let page = asked(&lab, 0).await;
    place(&lab, &page, false).await;
    confirm_right(&lab, &run, 0).await;
    let page = asked(&lab, 2).await;
    assert_eq!(page["repeated"], 2, "{page:#}");
    let stored = trials(&lab, &run).await;
    assert_eq!(stored.keys().copied().collect::<Vec<_>>(), [0, 1]);
    for trial in stored.values() {
        assert_eq!((&trial["flags"], &trial["attempt"]), (&json!([]), &json!(2)), "{trial:#}");
    }

    // The service ends and starts; the run resumes with the third placement, and an operator who always
    // errs at first finishes it.
    let lab = lab.restart_alone().await;
    lab.posted("/api/v1/infer", json!({ "method": "exact", "frames": [vec![0.0; 784]] })).await;
    connect(&lab).await;
    assert_eq!(lab.get(&format!("/api/v1/runs/{run}")).await["state"], "interrupted");
    lab.start(&run).await;
    asked(&lab, 2).await;
    let which = json!({ "action": "repeat", "who": WHO });
    assert_eq!(lab.act(&run, which).await.0, 409, "after a restart the trial must be named");
    lab.call_operator_who_errs(SPEED, 1.0);
    let summary = lab.ended(&run).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}");
    assert_eq!(summary["retries"], 2, "two trials were withdrawn");
    let stored = trials(&lab, &run).await;
    assert_eq!(stored.keys().copied().collect::<Vec<_>>(), [0, 1, 2, 3]);
    for trial in stored.values() {
        assert_eq!(trial["flags"], json!([]), "{trial:#}");
    }
    let actions = lab.items(&format!("/api/v1/actions?run={run}&limit=1000")).await;
    let is_its = |a: &&Value| a["who"] == "virtual operator (local)" && a["accepted"] == false;
    // A correction that is confirmed before the skin has settled is refused as well.
    let refused: BTreeSet<_> =
        actions.iter().filter(is_its).map(|a| a["why"].as_str().unwrap().to_owned()).collect();
    let wrong = [2, 3].map(|trial| format!("placed 2 weights for trial {trial}"));
    assert_eq!(refused, BTreeSet::from(wrong), "{actions:?}");
    let events = lab.events().await;
    let placed: Vec<_> = events
        .as_array()
        .unwrap()
        .iter()
        .filter(|e| e["kind"] == "placed")
        .map(|e| (e["data"]["trial"].as_u64().unwrap(), e["data"]["verdict"].clone()))
        .collect();
    let trials: Vec<u64> = placed.iter().map(|(trial, _)| *trial).collect();
    assert_eq!(trials, [0, 1, 1, 0, 2, 3]);
    assert_eq!((&placed[0].1, &placed[1].1), (&json!("right"), &json!("wrong")), "{placed:?}");
    // Those that were not waited for may be within their standard deviations.
    let fits = |(_, kind): &(u64, Value)| *kind == "right" || *kind == "unsure";
    assert!(placed[2..].iter().all(fits), "{placed:?}");
    assert_eq!(lab.post("/api/v1/placement", json!({})).await.0, 405);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_board_that_fails_or_a_stop_gives_up_no_placement() {
    let lab = Lab::open_alone("placement-faults", skin_alone(), WAITS).await;
    connect(&lab).await;
    let run = lab.begin(FOUR).await;
    let page = asked(&lab, 0).await;
    assert_eq!(page["verdict"]["kind"], "unknown", "no model serves: {page:#}");
    assert!(page["felt"].is_null());
    place(&lab, &page, false).await;
    // Without frames the trial is not measured, and the person is asked again.
    lab.fault("stall_stream", "ert", json!({})).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    lab.accepts(&run, confirm(0)).await;
    let again = |s: &Value| {
        let words = s["run"]["waiting_for"].as_str().unwrap_or_default();
        words.starts_with("trial 0 was not measured")
    };
    lab.until("the failure", again).await;
    lab.tell_rig(json!({ "cmd": "mend" })).await;
    let fresh = |s: &Value| s["rig"]["stream"]["age_ms"].as_u64().is_some_and(|age| age < 200);
    lab.until("frames", fresh).await;
    lab.accepts(&run, confirm(0)).await;
    asked(&lab, 1).await;
    // A stop latches, and after the reset the run asks for the same placement.
    lab.posted("/estop", json!({ "why": "test" })).await;
    lab.until("a trip", |s| s["rig"]["state"] == "tripped").await;
    lab.operate(json!({ "action": "reset", "who": WHO })).await;
    lab.until("the reset", |s| s["rig"]["state"] == "disarmed").await;
    for trial in 1..4 {
        asked(&lab, trial).await;
        lab.accepts(&run, confirm(trial)).await;
    }
    let summary = lab.ended(&run).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}");
    assert_eq!((&summary["retries"], &summary["skips"]), (&json!(1), &json!([])));
    assert_eq!(trials(&lab, &run).await.len(), 4);
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_skin_alone_presses_nothing_and_is_checked() {
    let lab = Lab::open_alone("placement-check", skin_alone(), WAITS).await;
    let report = lab.posted("/api/v1/rig/check", json!({ "who": WHO })).await;
    assert_eq!(report["problems"], json!([]), "{report:#}");
    assert!(report["axes"] == json!([]) && report["cells"].is_null(), "{report:#}");
    let definition = "name = 'hex'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [1]\n\
        configurations = 1\n";
    let body =
        json!({ "file": "hex.toml", "definition": definition, "sensor": SENSOR, "who": WHO });
    is_refused(lab.post("/api/v1/queue", body).await, 422, "needs a stage");
    lab.close().await;
}

/// Two placements of one weight, at rest after two seconds of the wall.
const TWO: &str = "name = 'weights'\nseed = 2\nsensor = 's'\n[real_random]\ncontacts = [1]\n\
    trials_each = 2\nweights_n = [4.905]\n[measure]\nframes_per_trial = 5\nsettle_ms = 20000.0\n\
    settle_max_ms = 30000.0\n";

#[tokio::test(flavor = "multi_thread")]
async fn under_a_stage_nothing_moves_during_a_manual_run_nor_after_it_before_tips_are_confirmed() {
    let lab = Lab::open_alone("placement-stage", rig_args("virtual", SPEED), WAITS).await;
    lab.home().await;
    lab.tell_rig(json!({ "cmd": "mount", "tips": 1 })).await;
    let tips = json!({ "action": "tips", "tips": 1, "who": WHO });
    lab.eventually("the cell", "/api/v1/status", |s| s["rig"]["live_cells"] == 1).await;
    lab.operate(tips).await;
    let run = lab.begin(TWO).await;
    let page = asked(&lab, 0).await;
    for action in [
        json!({ "action": "home" }),
        json!({ "action": "jog", "axis": "x", "to_mm": 9 }),
        // They would let the next run press at once.
        json!({ "action": "tips", "tips": 1 }),
    ] {
        is_refused(lab.post("/api/v1/rig/actions", action).await, 409, "hands");
    }

    // A stop during the measurement: the placement is asked for again.
    place(&lab, &page, false).await;
    lab.accepts(&run, confirm(0)).await;
    lab.until("the wait for rest", |s| s["run"]["phase"] == "settle").await;
    lab.posted("/api/v1/estop", json!({ "why": "test" })).await;
    lab.until("the stop", |s| s["rig"]["state"] == "tripped" && s["run"]["state"] == "paused")
        .await;
    lab.operate(json!({ "action": "reset", "who": WHO })).await;
    lab.act(&run, json!({ "action": "resume", "who": WHO })).await;
    let page = asked(&lab, 0).await;
    assert!(trials(&lab, &run).await.is_empty());

    // The next run waits for a person before it moves, although its tips were confirmed before.
    let next = "name = 'next'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [1]\nconfigurations = 1\n\
        depths = 2\nblock = 1\nreference_every = 0\n";
    let next = lab.queue(next).await;
    place(&lab, &page, false).await;
    lab.accepts(&run, confirm(0)).await;
    let page = asked(&lab, 1).await;
    place(&lab, &page, false).await;
    lab.accepts(&run, confirm(1)).await;
    lab.ended(&run).await;
    lab.operate(json!({ "action": "home", "who": WHO })).await;
    lab.until("homed", |s| s["rig"]["state"] == "homed").await;
    lab.start(&next).await;
    let asks =
        |s: &Value| s["run"]["paused_why"] == "tip_change" && s["run"]["wanted"]["tips"] == 1;
    lab.until("the question for tips", asks).await;
    lab.close().await;
}
