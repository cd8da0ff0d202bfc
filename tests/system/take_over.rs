//! What moves by itself after a start of the service, or at the start time of a run, and what ends or holds it.

use std::process::Command;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use super::bench::{Lab, WAITS, execute, rig_args, tell};
use super::campaign::{SMALL, SPEED, complete, held_by_a_lock, release, started, started_early};

/// True position of x, mm.
async fn x_mm(lab: &Lab) -> f64 {
    let truth = tell(&lab.rig, json!({ "cmd": "status" })).await;
    truth["axes"][0]["position"].as_f64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_manual_run_is_taken_up_after_a_restart_without_a_motion() {
    let lab = Lab::open_alone("hands", rig_args("virtual", SPEED), WAITS).await;
    lab.home().await;
    lab.operate(json!({ "action": "jog", "axis": "x", "to_mm": 100.0 })).await;
    lab.until("x at 100 mm", |s| s["rig"]["pose"]["x_mm"].as_f64().is_some_and(|x| x > 99.9)).await;
    let definition = "name = 'weights'\nseed = 2\nsensor = 's'\n[real_random]\ncontacts = [2]\n\
        trials_each = 3\nweights_n = [4.905]\n[measure]\nsettle_ms = 60000.0\n\
        settle_max_ms = 120000.0\n";
    let run = lab.begin(definition).await;
    let waits = |s: &Value| s["run"]["paused_why"] == "manual_trial";
    lab.until("a placement", waits).await;
    let confirm = json!({ "action": "confirm", "trial": 0, "anyway": true });
    lab.accepts(&run, confirm).await;
    // The placement is measured for three seconds, with hands and weights at the skin.
    lab.until("the measurement", |s| s["run"]["phase"] == "settle").await;
    let lab = lab.restart_alone().await;
    let status = lab.until("the same placement", waits).await;
    assert_eq!(status["rig"]["state"], "disarmed", "{status:#}");
    assert!((x_mm(&lab).await - 100.0).abs() < 0.1, "x has moved");
    let is_told = |page: &Value| page["items"].as_array().is_some_and(|items| !items.is_empty());
    lab.eventually("the event", "/api/v1/events?kind=resumed", is_told).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_is_not_driven_again_by_itself_after_a_person_has_operated_the_rig() {
    let (lab, run) = held_by_a_lock("operated").await;
    release(&lab).await;
    lab.operate(json!({ "action": "connect" })).await;
    // At once: the next process does not drive it either.
    assert_eq!(lab.get(&format!("/api/v1/runs/{run}")).await["state"], "interrupted");
    lab.told("not_resumed", "a person has operated the rig").await;
    assert_eq!(lab.get("/api/v1/status").await["rig"]["state"], "disarmed");
    lab.operate(json!({ "action": "home" })).await;
    lab.until("homed", |s| s["rig"]["state"] == "homed").await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    lab.rests("homed").await;
    lab.start(&run).await;
    complete(&lab, &run).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_with_closed_wires_is_stored_at_once_for_the_next_process() {
    let (lab, run) = held_by_a_lock("closed").await;
    lab.posted("/api/v1/estop", json!({ "why": "test" })).await;
    // Before the next attempt, which is the last one.
    lab.interrupted(&run).await;
    release(&lab).await;
    lab.told("not_resumed", "a person has operated the rig").await;
    lab.rests("disconnected").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_ends_the_homing_for_a_run_that_is_about_to_be_driven_again() {
    let (lab, run) = started("homes", 5).await;
    lab.stick_x().await;
    let lab = lab.restart().await;
    lab.until("a homing", |s| s["rig"]["state"] == "disarmed").await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    lab.accepts(&run, json!({ "action": "abort" })).await;
    lab.ends_safely().await;
    // The next attempt is the last one.
    lab.told("not_resumed", "meanwhile: it is not driven").await;
    let row = lab.get(&format!("/api/v1/runs/{run}")).await;
    assert_eq!((&row["state"], &row["exit_status"]), (&json!("ended"), &json!("abort")));
    lab.rests("disarmed").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_homing_is_named_by_the_status_until_an_abort_ends_it() {
    let lab = Lab::open("homing", rig_args("virtual", SPEED), WAITS).await;
    lab.stick_x().await;
    lab.operate(json!({ "action": "connect" })).await;
    assert_eq!(lab.get("/api/v1/status").await["rig"]["motion"], Value::Null);
    lab.operate(json!({ "action": "home" })).await;
    lab.until("a homing", |s| s["rig"]["motion"] == "homing").await;
    let abort = json!({ "who": "test" });
    lab.posted("/api/v1/rig/abort", abort.clone()).await;
    lab.until("its end", |s| s["rig"]["motion"].is_null()).await;
    lab.ends_safely().await;
    let (code, words) = lab.post("/api/v1/rig/abort", abort).await;
    assert_eq!(code, 409, "{words:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pause_of_a_run_that_is_about_to_be_driven_again_holds_it() {
    let (lab, run) = started("held", 5).await;
    lab.stick_x().await;
    let lab = lab.restart().await;
    lab.until("a homing", |s| s["rig"]["state"] == "disarmed").await;
    // The command names no run, and none is active.
    let mut pause = Command::new(env!("CARGO_BIN_EXE_palpate"));
    pause.args(["pause", "--url", &lab.service.url()]);
    let paused = tokio::task::block_in_place(|| pause.output()).unwrap();
    let words = String::from_utf8_lossy(&paused.stderr);
    assert!(words.contains("start it again, or abort it"), "{words}");
    lab.interrupted(&run).await;
    lab.told("not_resumed", "a person has operated the rig").await;
    lab.rests("disarmed").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_at_the_start_time_of_a_run_does_not_drop_it() {
    // Slow enough that a jog lasts longer than a second.
    let lab = Lab::homed("jogged", 2.0, WAITS).await;
    let run = started_early(&lab, 6).await;
    let row = lab.get(&format!("/api/v1/runs/{run}")).await;
    let due: Timestamp = row["not_before"].as_str().unwrap().parse().unwrap();
    let before = due - SignedDuration::from_millis(400);
    let left = Duration::try_from(before.duration_since(Timestamp::now())).unwrap();
    tokio::time::sleep(left).await;
    lab.operate(json!({ "action": "jog", "axis": "x", "to_mm": 550.0 })).await;
    let begun = |s: &Value| s["run"]["uid"] == run;
    lab.until("the run", begun).await;
    let late = Timestamp::now().duration_since(due);
    assert!(late > SignedDuration::from_secs(3), "the rig was not busy: {late}");
    let page = lab.get("/api/v1/events?kind=not_begun").await;
    assert_eq!(page["items"], json!([]), "{page:#}");
    lab.accepts(&run, json!({ "action": "abort" })).await;
    lab.ended(&run).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_run_begins_by_itself_after_an_abort_of_a_moving_run_and_the_queue_says_why() {
    let (lab, run) = started("aborted", 0).await;
    let next = lab.begin(SMALL).await;
    lab.stored(1).await;
    lab.accepts(&run, json!({ "action": "abort" })).await;
    lab.ended(&run).await;
    lab.told("not_begun", "the run before it was aborted").await;
    let status = lab.get("/api/v1/status").await;
    assert_eq!((&status["run"], &status["rig"]["state"]), (&Value::Null, &json!("homed")));
    let words = status["waiting_for"].as_str().unwrap_or_default();
    assert!(words.contains("does not begin by itself: the run before it was aborted"), "{words}");
    assert_eq!(status["not_begun"], status["waiting_for"]);
    // The newest of its kind, whatever was reported after it.
    let newest = lab.get("/api/v1/events?kind=not_begun&since=-1").await;
    assert_eq!(newest["items"].as_array().map(Vec::len), Some(1), "{newest:#}");
    let first = lab.get("/api/v1/events?since=0&limit=1").await["items"][0].clone();
    let kind = first["kind"].as_str().unwrap();
    let of_kind = lab.get(&format!("/api/v1/events?kind={kind}&since=-1000")).await;
    assert_eq!(of_kind["items"][0], first, "{of_kind:#}");
    let times = lab.get("/api/v1/queue/times").await;
    let why = times["items"][0]["not_begun"].as_str().unwrap_or_default();
    assert!(why.ends_with("start it again"), "{times:#}");
    lab.start(&next).await;
    complete(&lab, &next).await;
    let status = lab.get("/api/v1/status").await;
    assert_eq!((&status["waiting_for"], &status["not_begun"]), (&Value::Null, &Value::Null));
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_started_again_after_a_person_has_operated_the_rig_begins_in_time() {
    let lab = Lab::homed("handed-over", SPEED, WAITS).await;
    let run = started_early(&lab, 20).await;
    let lab = lab.restart().await;
    lab.operate(json!({ "action": "connect" })).await;
    lab.operate(json!({ "action": "disconnect" })).await;
    lab.start(&run).await;
    assert_eq!(lab.get("/api/v1/status").await["rig"]["state"], "disconnected");
    complete(&lab, &run).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pause_that_the_database_does_not_take_is_stated_until_it_is_stored() {
    let (lab, run) = started("unstored", 2).await;
    let refuse = "CREATE TRIGGER no_state BEFORE UPDATE OF state ON runs BEGIN
         SELECT RAISE(ABORT, 'no room'); END";
    execute(&lab.data, refuse).await;
    lab.accepts(&run, json!({ "action": "pause", "when": "now" })).await;
    let is_stated = |s: &Value| s["needs"].to_string().contains("The database does not take this");
    lab.until("a pause that is not stored", is_stated).await;
    execute(&lab.data, "DROP TRIGGER no_state").await;
    let is_paused = |s: &Value| s["run"]["state"] == "paused" && !is_stated(s);
    lab.until("a pause that is stored", is_paused).await;
    // The last of its states is stored after the first one.
    let is_stored = |run: &Value| run["state"] == "paused";
    lab.eventually("the pause as stored", &format!("/api/v1/runs/{run}"), is_stored).await;
    lab.accepts(&run, json!({ "action": "resume" })).await;
    complete(&lab, &run).await;
    lab.close().await;
}
