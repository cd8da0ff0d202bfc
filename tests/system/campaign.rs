//! Campaigns from the queue to their end, with people and faults in between.

use std::collections::BTreeSet;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use palpate::digest::sha256_hex;
use serde_json::{Value, json};
use sqlx::Connection;

use super::bench::{Lab, SENSOR, WAITS, WHOLE, database, http, rig_args};

/// Two settings of three configurations and four depths: 24 trials.
pub(super) const SMALL: &str = "name = 'small'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [1, 4]\n\
     configurations = 3\ndepths = 4\ndepth_step_mm = 1.25\nblock = 3\nreference_every = 2\n\
     [measure]\nsettle_ms = 400.0\n[policy]\nauto_resume_after_s = 0.2\n";
const TRIALS: usize = 24;
/// Process seconds in a wall second.
pub(super) const SPEED: f64 = 20.0;

/// A run that is active and has stored at least `trials`.
pub(super) async fn started(name: &str, trials: u64) -> (Lab, String) {
    started_at(name, SPEED, trials).await
}

/// As [`started`], with the process seconds in a wall second.
async fn started_at(name: &str, speed: f64, trials: u64) -> (Lab, String) {
    let lab = Lab::homed(name, speed, WAITS).await;
    let run = lab.begin(SMALL).await;
    lab.stored(trials).await;
    (lab, run)
}

/// Ended with success, and every planned trial is there once.
pub(super) async fn complete(lab: &Lab, run: &str) -> Value {
    let summary = lab.ended(run).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}\n{:#}", lab.events().await);
    let keys = lab.keys(run).await;
    assert_eq!(keys.len(), TRIALS);
    assert_eq!(keys.iter().collect::<BTreeSet<_>>().len(), TRIALS);
    summary
}

async fn home_again(lab: &Lab) {
    lab.operate(json!({ "action": "reset", "who": "test" })).await;
    lab.operate(json!({ "action": "home", "who": "test" })).await;
    lab.until("homed", |s| s["rig"]["state"] == "homed").await;
}

fn kinds(events: &Value) -> Vec<&str> {
    events.as_array().unwrap().iter().map(|e| e["kind"].as_str().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_small_campaign_stores_every_planned_trial_once() {
    let (lab, run) = started("small", 0).await;
    let summary = complete(&lab, &run).await;
    assert_eq!(summary["settings"], json!([{"tips": 1, "stored": 12}, {"tips": 4, "stored": 12}]));
    assert_eq!(summary["retries"], 0);
    for trial in lab.items(&format!("/api/v1/runs/{run}/trials?limit=100")).await {
        assert_eq!(trial["flags"], json!([]), "{trial:#}");
    }
    let deep = lab.get(&format!("/api/v1/runs/{run}/trials?depth_mm__eq=3.75&tips__eq=4")).await;
    for trial in deep["items"].as_array().unwrap() {
        assert!(trial["max_force_n"].as_f64().unwrap() > 10.0, "{trial:#}");
        let forces = trial["forces_n"].as_array().unwrap();
        assert_eq!(forces.iter().filter(|f| f.is_number()).count(), 4, "{trial:#}");
    }
    let records = |kind: &str| format!("/api/v1/runs/{run}/records/{kind}");
    assert_eq!(lab.get(&records("touch-offs")).await["items"].as_array().unwrap().len(), 2);
    // Before the first, after the second, at the end of each setting; each has its own tare.
    let references = lab.get(&records("references")).await["items"].as_array().unwrap().len();
    let tares = lab.get(&records("tares")).await["items"].as_array().unwrap().len();
    assert_eq!(tares, 6 + references);
    every_trial_has_its_twin(&lab, &run).await;
    lab.close().await;
}

/// The simulated twins of a run that has ended: all there, and near the paper's fit.
async fn every_trial_has_its_twin(lab: &Lab, run: &str) {
    let all_there = |t: &Value| t["trials"] == TRIALS && t["pending"] == 0;
    let path = format!("/api/v1/runs/{run}/twins");
    assert_eq!(lab.eventually("all twins", &path, all_there).await["failures"], 0);
    let deep = format!("/api/v1/runs/{run}/trials?max_force_n__gt=15&voltages=true");
    for trial in lab.items(&deep).await {
        assert_eq!(trial["sim_voltages_v"].as_array().unwrap().len(), 784);
        assert!(trial["fvu"].as_f64().unwrap() < 0.5, "{} {}", trial["trial_id"], trial["fvu"]);
    }
    let report = lab.get(&format!("/api/v1/runs/{run}/evaluation/simulation")).await;
    assert_eq!(report["trials"], TRIALS);
    let median = report["median_fvu"].as_f64().unwrap();
    assert!((0.02..0.4).contains(&median), "{median}");
    assert_eq!(report["by_pair"].as_array().unwrap().len(), 28, "{report}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_pauses_and_goes_on_and_what_its_state_forbids_is_refused() {
    let (lab, run) = started("pause", 3).await;
    let act = |action: Value| lab.act(&run, action);
    assert_eq!(act(json!({ "action": "pause", "who": "eve", "why": "lunch" })).await.0, 202);
    let raised = |s: &Value| s["rig"]["pose"]["z_mm"].as_f64().is_some_and(|z| z < 60.0);
    let paused = |s: &Value| s["run"]["state"] == "paused" && raised(s);
    let paused = lab.until("a pause with the tips up", paused).await;
    assert_eq!(paused["run"]["paused_why"], "operator");
    let (status, problem) = act(json!({ "action": "pause" })).await;
    assert_eq!((status, &problem["status"]), (409, &json!(409)), "{problem}");
    let second = lab.queue(SMALL).await;
    let (status, _) =
        lab.act(&second, json!({ "action": "start", "code": "", "who": "test" })).await;
    assert_eq!(status, 409, "a start needs its arming");
    assert_eq!(act(json!({ "action": "resume" })).await.0, 202);
    lab.stored(10).await;
    assert_eq!(act(json!({ "action": "pause", "when": "now" })).await.0, 202);
    lab.until("a pause", |s| s["run"]["state"] == "paused").await;
    assert_eq!(act(json!({ "action": "resume" })).await.0, 202);
    complete(&lab, &run).await;
    let actions = lab.get(&format!("/api/v1/actions?run={run}")).await;
    let logged = actions["items"].as_array().unwrap().iter().find(|a| a["why"] == "lunch").unwrap();
    assert_eq!((&logged["who"], &logged["accepted"]), (&json!("eve (local)"), &json!(true)));
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn stop_and_abort_end_a_run_short_of_its_plan_and_it_resumes_with_what_is_missing() {
    let (lab, run) = started("stop", 2).await;
    lab.accepts(&run, json!({ "action": "stop" })).await;
    let summary = lab.ended(&run).await;
    assert_eq!(summary["run"]["exit_status"], "stopped");
    let stored = summary["trials_stored"].as_u64().unwrap();
    assert!((2..TRIALS as u64).contains(&stored), "{stored}");
    assert_eq!(summary["run"]["reason"], format!("stopped at {stored} of {TRIALS} trials"));
    let status = lab.until("rest", |s| s["run"].is_null()).await;
    assert_eq!(status["rig"]["state"], "homed");

    lab.start(&run).await;
    lab.stored(stored + 1).await;
    lab.accepts(&run, json!({ "action": "abort" })).await;
    let row = lab.ended(&run).await["run"].clone();
    assert_eq!(row["exit_status"], "abort");
    assert!(row["reason"].as_str().unwrap().starts_with("aborted at "), "{row:#}");
    let status = lab.until("rest", |s| s["run"].is_null()).await;
    assert_eq!(status["rig"]["state"], "homed");

    lab.start(&run).await;
    // What was stored before is counted once the run is open again.
    lab.stored(1).await;
    complete(&lab, &run).await;
    let (status, refused) = lab.post(&format!("/api/v1/runs/{run}/arm"), json!({})).await;
    assert_eq!(status, 409, "nothing of it remains: {refused:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_run_begins_by_itself_after_one_that_was_ended_while_it_was_halted() {
    let (lab, run) = started("halted", 0).await;
    let next = lab.begin(SMALL).await;
    lab.stored(2).await;
    lab.accepts(&run, json!({ "action": "pause", "when": "now" })).await;
    lab.until("a pause", |s| s["run"]["state"] == "paused").await;
    lab.accepts(&run, json!({ "action": "abort" })).await;
    lab.ended(&run).await;
    lab.told("not_begun", "ended while it was halted").await;
    lab.rests("homed").await;
    lab.start(&next).await;
    complete(&lab, &next).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_emergency_stop_latches_until_a_person_resets_and_loses_nothing() {
    let (lab, run) = started("estop", 5).await;
    lab.posted("/estop", json!({ "why": "smoke" })).await;
    let tripped = lab.until("a trip", |s| s["run"]["paused_why"] == "trip").await;
    assert_eq!(tripped["rig"]["state"], "tripped", "{tripped:#}");
    assert_eq!(tripped["rig"]["trip"]["kind"], "estop");
    let (status, _) = lab.act(&run, json!({ "action": "resume" })).await;
    assert_eq!(status, 409, "a latched rig resumes nothing");
    home_again(&lab).await;
    lab.posted(&format!("/api/v1/runs/{run}/actions"), json!({ "action": "resume" })).await;
    complete(&lab, &run).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_was_ended_in_the_middle_goes_on_by_itself() {
    let (lab, run) = started("restart", 5).await;
    let lab = lab.restart().await;
    let summary = complete(&lab, &run).await;
    assert_eq!(summary["retries"], 0, "what was under way is not a failure");
    assert!(kinds(&lab.events().await).contains(&"resumed"));
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_this_version_would_plan_differently_does_not_resume() {
    let (lab, run) = started("plan", 3).await;
    let kept = lab.get(&format!("/api/v1/runs/{run}/plan")).await;
    assert_eq!(kept["steps"][0]["step"], "tip-change", "{kept:#}");
    plan_of_another_version(&lab, &run).await;
    let lab = lab.restart().await;
    let row = lab.interrupted(&run).await;
    let stored = lab.keys(&run).await;
    let (status, refused) = lab.post(&format!("/api/v1/runs/{run}/arm"), json!({})).await;
    let detail = refused["detail"].as_str().unwrap();
    assert_eq!(status, 409, "{refused:#}");
    let scan_id = &row["scan_id"];
    assert!(detail.starts_with(&format!("run {scan_id} was queued by version")), "{detail}");
    assert!(detail.contains("policy.max_skipped: stored 11, now 10."), "{detail}");
    assert!(kinds(&lab.events().await).contains(&"not_resumed"));
    assert_eq!(lab.keys(&run).await, stored);
    // Nothing was switched on for it, and it can be ended.
    assert_eq!(lab.get("/api/v1/status").await["rig"]["state"], "disconnected");
    lab.accepts(&run, json!({ "action": "abort" })).await;
    let ended = lab.get(&format!("/api/v1/runs/{run}")).await;
    assert_eq!((&ended["state"], &ended["exit_status"]), (&json!("ended"), &json!("abort")));
    let (status, _) = lab.act(&run, json!({ "action": "abort" })).await;
    assert_eq!(status, 409, "it has ended");
    lab.close().await;
}

/// A service that was restarted during a run, which a lock holds that was taken after its last trial.
pub(super) async fn held_by_a_lock(name: &str) -> (Lab, String) {
    let (lab, run) = started(name, 5).await;
    let taken = http().put(lock(&lab)).json(&json!({ "note": "hands" })).send().await.unwrap();
    assert!(taken.status().is_success());
    let mut database = database(&lab.data).await;
    // Whatever is still stored before the service ends is earlier.
    sqlx::query("UPDATE operator_lock SET since = ?1")
        .bind((Timestamp::now() + SignedDuration::from_hours(1)).to_string())
        .execute(&mut database)
        .await
        .unwrap();
    database.close().await.unwrap();
    let lab = lab.restart().await;
    lab.told("not_resumed", "has taken the operator lock: hands").await;
    assert_eq!(lab.get("/api/v1/status").await["rig"]["state"], "disconnected");
    (lab, run)
}

fn lock(lab: &Lab) -> String {
    format!("{}/api/v1/lock", lab.service.url())
}

pub(super) async fn release(lab: &Lab) {
    let freed = http().delete(lock(lab)).send().await.unwrap();
    assert!(freed.status().is_success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lock_that_was_taken_after_the_last_trial_holds_the_run_through_a_restart() {
    let (lab, run) = held_by_a_lock("locked").await;
    release(&lab).await;
    complete(&lab, &run).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_about_to_be_driven_again_can_be_aborted() {
    let (lab, run) = held_by_a_lock("undriven").await;
    let (status, refused) = lab.act(&run, json!({ "action": "pause" })).await;
    assert_eq!(status, 409, "{refused:#}");
    let words = refused["detail"].as_str().unwrap();
    assert!(words.ends_with("start it again, or abort it"), "{refused:#}");
    // At once: the next process does not drive it either.
    assert_eq!(lab.get(&format!("/api/v1/runs/{run}")).await["state"], "interrupted");
    lab.accepts(&run, json!({ "action": "abort" })).await;
    release(&lab).await;
    // The next attempt is the last one.
    lab.told("not_resumed", "a person has operated the rig").await;
    let row = lab.get(&format!("/api/v1/runs/{run}")).await;
    assert_eq!((&row["state"], &row["exit_status"]), (&json!("ended"), &json!("abort")));
    lab.rests("disconnected").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_run_whose_rig_homes_when_the_service_ends_does_not_go_on_by_itself() {
    let (lab, run) = started("homing", 2).await;
    lab.posted("/estop", json!({ "why": "smoke" })).await;
    lab.until("acknowledged", |s| s["rig"]["estop_acknowledged_ms"].is_number()).await;
    lab.until("a trip", |s| s["run"]["paused_why"] == "trip").await;
    lab.operate(json!({ "action": "reset", "who": "test" })).await;
    lab.operate(json!({ "action": "home", "who": "test" })).await;
    let lab = lab.restart().await;
    lab.interrupted(&run).await;
    lab.rests("disconnected").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_e_stop_while_the_service_ends_is_known_to_the_next_process() {
    // Slow enough that the raise of the tips outlasts the delay of the request.
    let (lab, run) = started_at("ending", 3.0, 2).await;
    let address = format!("{}/api/v1/estop", lab.service.url());
    let client = http();
    let stop = tokio::spawn(async move {
        // The tips are being raised by then; the door is open until they are up.
        tokio::time::sleep(Duration::from_millis(10)).await;
        client.post(address).json(&json!({ "why": "smoke" })).send().await.unwrap().status()
    });
    let lab = lab.restart().await;
    assert!(stop.await.unwrap().is_success());
    lab.interrupted(&run).await;
    lab.rests("disconnected").await;
    lab.close().await;
}

/// Replaces the plan of a run, as if an earlier version had planned one skip more.
async fn plan_of_another_version(lab: &Lab, run: &str) {
    let mut database = database(&lab.data).await;
    let plan: String = sqlx::query_scalar(
        "SELECT p.plan FROM plans p JOIN runs r ON r.plan_sha256 = p.sha256 WHERE r.uid = ?1",
    )
    .bind(run)
    .fetch_one(&mut database)
    .await
    .unwrap();
    let other = plan.replace("\"max_skipped\":10", "\"max_skipped\":11");
    assert_ne!(plan, other);
    let sha256 = sha256_hex(&other);
    sqlx::query("INSERT INTO plans VALUES (?1, ?2)")
        .bind(&sha256)
        .bind(other)
        .execute(&mut database)
        .await
        .unwrap();
    sqlx::query("UPDATE runs SET plan_sha256 = ?2 WHERE uid = ?1")
        .bind(run)
        .bind(sha256)
        .execute(&mut database)
        .await
        .unwrap();
    database.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_waits_for_its_turn_keeps_it_through_a_restart() {
    let (lab, first) = started("turns", 0).await;
    let second = lab.begin(SMALL).await;
    let row = lab.get(&format!("/api/v1/runs/{second}")).await;
    assert!(row["waiting_since"].is_string() && row["state"] == "queued", "{row:#}");
    lab.stored(5).await;
    let lab = lab.restart().await;
    complete(&lab, &first).await;
    complete(&lab, &second).await;
    lab.close().await;
}

/// Queues a run with a start in some seconds, and starts it.
pub(super) async fn started_early(lab: &Lab, seconds: i64) -> String {
    let not_before = (Timestamp::now() + SignedDuration::from_secs(seconds)).to_string();
    let body = json!({ "file": "test.toml", "definition": SMALL, "sensor": SENSOR,
        "not_before": not_before });
    let run = lab.posted("/api/v1/queue", body).await["uid"].as_str().unwrap().to_owned();
    lab.start(&run).await;
    let words = lab.get("/api/v1/status").await["waiting_for"].clone();
    assert!(words.as_str().is_some_and(|words| words.ends_with("or later")), "{words}");
    run
}

async fn began_in_time(lab: &Lab, run: &str) {
    let row = complete(lab, run).await["run"].clone();
    let time = |key: &str| row[key].as_str().unwrap().parse::<Timestamp>().unwrap();
    assert!(time("started_at") >= time("not_before"), "{row:#}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_begins_when_its_time_has_come_and_holds_up_no_other() {
    let lab = Lab::homed("early", SPEED, WAITS).await;
    let early = started_early(&lab, 8).await;
    let next = lab.begin(SMALL).await;
    complete(&lab, &next).await;
    began_in_time(&lab, &early).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_restart_the_rig_is_brought_up_when_a_run_is_due() {
    let lab = Lab::homed("early-restart", SPEED, WAITS).await;
    let early = started_early(&lab, 12).await;
    let lab = lab.restart().await;
    let status = lab.get("/api/v1/status").await;
    assert_eq!(status["rig"]["state"], "disconnected", "{status:#}");
    began_in_time(&lab, &early).await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_wires_are_retried_then_trip_and_the_run_goes_on_by_itself() {
    let (lab, run) = started("faults", 2).await;
    lab.fault("no_reply", "z", json!({ "count": 1, "executed": true })).await;
    lab.fault("flip_bytes", "ert", json!({ "count": 3 })).await;
    lab.stored(5).await;
    lab.fault("disconnect", "stage", json!({ "for_s": 120.0 })).await;
    lab.until("a trip", |s| s["run"]["paused_why"] == "trip").await;
    complete(&lab, &run).await;
    let events = lab.events().await;
    assert!(kinds(&events).contains(&"recovering"), "{events:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_are_placed_confirmed_measured_and_repeated() {
    let lab = Lab::homed("random", SPEED, WAITS).await;
    let definition = "name = 'weights'\nseed = 2\nsensor = 's'\n[real_random]\ncontacts = [2, 3]\n\
        trials_each = 3\nweights_n = [4.905, 9.81]\n[measure]\nframes_per_trial = 5\n";
    let run = lab.begin(definition).await;
    let summary = lab.ended(&run).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}\n{:#}", lab.events().await);
    assert_eq!(summary["contact_counts"], json!([0, 0, 3, 3, 0, 0, 0]));
    for trial in lab.items(&format!("/api/v1/runs/{run}/trials?limit=100")).await {
        assert_eq!(trial["placed_by"], "virtual operator (local)");
        assert_eq!(trial["frame_count"], 5);
        assert_eq!(trial["forces_n"], json!([null, null, null, null, null, null]));
    }
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_campaign_on_other_axes_and_wires_has_the_same_keys_and_targets() {
    let mut seen = Vec::new();
    for (rig, speed, share) in [("iai-modbus-tcp", SPEED, WAITS), ("oriental-az-rtu", 8.0, WHOLE)] {
        let lab = Lab::open(&format!("wires-{rig}"), rig_args(rig, speed), share).await;
        lab.home().await;
        let run = lab.begin(SMALL).await;
        complete(&lab, &run).await;
        let page = lab.get(&format!("/api/v1/runs/{run}/trials?limit=100")).await;
        let place = |t: &Value| {
            let target = &t["target"];
            json!([
                t["configuration"],
                t["depth_index"],
                target["x_mm"],
                target["y_mm"],
                target["radius_mm"],
                t["depth_mm"]
            ])
        };
        seen.push(page["items"].as_array().unwrap().iter().map(place).collect::<Vec<_>>());
        lab.close().await;
    }
    assert_eq!(seen[0], seen[1]);
}
