//! The service's process killed, frozen and told to end. `kill -9` at random instants of a running
//! campaign: after resuming, every planned trial is stored once (`PALPATE_KILLS` states how often,
//! default 4). SIGSTOP in a press: the missing samples trip. SIGTERM in a jog: the axis stops. A database
//! that is locked for a minute, a full disk: trips and e-stops do not wait for them. Processes, sockets
//! and files as a lab has them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use reqwest::Response;
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use serde_json::{Value, json};
use sqlx::Connection;

use super::bench::{
    COMPUTES, LIMIT, Process, SENSOR, WHOLE, answered, database, fault, http, signal, skin_cache,
    tell_at, turn, until, with_responses,
};

const SPEED: &str = "20";
/// Two settings of `configurations` configurations and four depths, which resume after any number of crashes.
fn experiment(configurations: u32) -> String {
    settling(configurations, 2000.0)
}

/// The same, with a load held for `settle_ms` before it is measured.
fn settling(configurations: u32, settle_ms: f64) -> String {
    format!(
        "name = 'crash'\nseed = 8\nsensor = 's'\n[real_hex]\ntips = [1, 3]\n\
         configurations = {configurations}\ndepths = 4\nblock = 4\nreference_every = 0\n\
         [measure]\nsettle_ms = {settle_ms:.1}\nsettle_max_ms = 60000.0\n[policy]\nmax_auto_resumes = 10000\n"
    )
}

fn palpate(args: &[&str]) -> Process {
    let child = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    Process(child)
}

struct Site {
    folder: PathBuf,
    url: String,
    port: u16,
    http: reqwest::Client,
}

impl Site {
    /// A folder, and a virtual rig with the address of its control socket.
    async fn with_rig(name: &str) -> (Self, Process, String) {
        Self::with_rig_at(name, SPEED).await
    }

    /// As [`Self::with_rig`], with the process seconds in a wall second.
    async fn with_rig_at(name: &str, speed: &str) -> (Self, Process, String) {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::remove_dir_all(&folder).ok();
        std::fs::create_dir_all(&folder).unwrap();
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let url = format!("http://127.0.0.1:{port}");
        let site = Self { folder, url, port, http: http() };
        let cache = skin_cache();
        let cache = cache.to_str().unwrap();
        let rig = ["virtual-rig", "--ephemeral", "--speed", speed, "--cache", cache];
        let (served, ready) = (site.path("served.toml"), site.path("ready.json"));
        let rig = palpate(&[&rig[..], &["--out-rig", &served, "--ready-file", &ready]].concat());
        let read = async || {
            let text = std::fs::read_to_string(&ready).unwrap_or_default();
            serde_json::from_str::<Value>(&text).unwrap_or_default()
        };
        let ready = until("a rig", LIMIT, read, Value::is_object).await;
        with_responses(&site.folder.join("data"));
        (site, rig, ready["control"].as_str().unwrap().to_owned())
    }

    fn operator(&self, control: &str) -> Process {
        let hands = ["virtual-operator", "--url", &self.url, "--control", control];
        palpate(&[&hands[..], &["--speed", SPEED]].concat())
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).to_str().unwrap().to_owned()
    }

    async fn serve(&self) -> Process {
        let bind = format!("127.0.0.1:{}", self.port);
        let (data, rig) = (self.path("data"), self.path("served.toml"));
        let service = palpate(&["serve", "--bind", &bind, "--data", &data, "--rig", &rig]);
        self.answer("/health/live").await;
        service
    }

    /// Waits for a GET to succeed.
    async fn answer(&self, path: &str) -> Value {
        let ask = async || self.http.get(format!("{}{path}", self.url)).send().await;
        let succeeds = |answer: &reqwest::Result<Response>| {
            answer.as_ref().is_ok_and(|answer| answer.status().is_success())
        };
        let answer = until(path, LIMIT, ask, succeeds).await;
        answer.unwrap().json().await.unwrap()
    }

    async fn post(&self, path: &str, body: Value) -> Value {
        let request = self.http.post(format!("{}{path}", self.url)).json(&body);
        let (status, answer) = answered(request).await;
        assert!((200..300).contains(&status), "{path}: {status} {answer}");
        answer
    }

    async fn until(&self, path: &str, done: impl Fn(&Value) -> bool) -> Value {
        until(path, LIMIT, async || self.answer(path).await, done).await
    }

    /// Queues and starts; returns the run.
    async fn begin(&self, experiment: String) -> String {
        let body = json!({ "file": "crash.toml", "definition": experiment, "sensor": SENSOR,
            "auto_resume": true });
        let run = self.post("/api/v1/queue", body).await["uid"].as_str().unwrap().to_owned();
        self.start(&run).await;
        run
    }

    /// Homes, arms, starts, as far as that is to be done.
    async fn start(&self, run: &str) {
        for (from, action) in [("disconnected", "connect"), ("disarmed", "home")] {
            if self.answer("/api/v1/status").await["rig"]["state"] == from {
                self.post("/api/v1/rig/actions", json!({ "action": action })).await;
                self.until("/api/v1/status", |s| s["rig"]["state"] != from).await;
            }
        }
        let armed = self.post(&format!("/api/v1/runs/{run}/arm"), json!({})).await;
        let start = json!({ "action": "start", "code": armed["code"] });
        self.post(&format!("/api/v1/runs/{run}/actions"), start).await;
    }

    /// A run that waited for a person when the service was killed does not resume automatically: that
    /// person starts it. Returns the run's state.
    async fn look_after(&self, run: &str) -> String {
        let path = format!("/api/v1/runs/{run}");
        let row = self.answer(&path).await;
        if row["state"] == "interrupted" {
            self.start(run).await;
            // The start is answered before its state is stored, and a second one is refused.
            self.until(&path, |row| row["state"] != "interrupted").await;
        }
        row["state"].as_str().unwrap().to_owned()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_at_random_instants_every_planned_trial_is_stored_once() {
    let _turn = turn(COMPUTES).await;
    let kills: u32 = std::env::var("PALPATE_KILLS").map_or(4, |n| n.parse().unwrap());
    let (site, _rig, control) = Site::with_rig("crash").await;
    let mut service = site.serve().await;
    let _operator = site.operator(&control);
    // Enough trials that the last kill still finds some to do.
    let configurations = (2 * kills).max(4);
    let run = site.begin(experiment(configurations)).await;
    let mut chance = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let mut at = Vec::new();
    for _ in 0..kills {
        // From the first motion after a start to well inside the trials.
        let alive = Duration::from_millis(chance.random_range(200..14_000));
        tokio::time::sleep(alive).await;
        if site.look_after(&run).await == "ended" {
            break;
        }
        let status = site.answer("/api/v1/status").await;
        at.push(status["run"]["phase"].as_str().unwrap_or("starting").to_owned());
        drop(service);
        service = site.serve().await;
    }
    println!("killed in {at:?}");
    let state = async || site.look_after(&run).await;
    until("the end of the run", LIMIT * 4, state, |state: &String| state == "ended").await;
    let page = site.answer(&format!("/api/v1/runs/{run}/trials?limit=1000")).await;
    let trials = page["items"].as_array().unwrap();
    let keys: BTreeSet<String> =
        trials.iter().map(|t| format!("{} {}", t["configuration"], t["depth_index"])).collect();
    let planned = 2 * 4 * configurations as usize;
    assert_eq!((trials.len(), keys.len()), (planned, planned));
    let summary = site.answer(&format!("/api/v1/runs/{run}/summary")).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}");
    assert!(!at.is_empty(), "it was never killed");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_was_frozen_in_a_press_trips_and_stores_nothing_of_it() {
    let _turn = turn(COMPUTES).await;
    let (site, _rig, control) = Site::with_rig("frozen").await;
    let service = site.serve().await;
    let _operator = site.operator(&control);
    let run = site.begin(experiment(4)).await;
    site.until("/api/v1/status", |s| s["run"]["phase"] == "settle").await;
    let before = site.answer("/api/v1/status").await["run"]["trials_stored"].as_u64().unwrap();
    signal(&service.0, Signal::STOP);
    // Longer than limits.sample_age_ms of the virtual rig's file, 1500.
    tokio::time::sleep(Duration::from_millis(2500)).await;
    signal(&service.0, Signal::CONT);
    let status = site.until("/api/v1/status", |s| !s["rig"]["trip"].is_null()).await;
    assert_eq!(status["rig"]["trip"]["kind"], "stale", "{status:#}");
    // Of a gap between two samples, or of one that has not arrived if z moved on meanwhile.
    let detail = status["rig"]["trip"]["detail"].as_str().unwrap();
    assert!(detail.contains("limits.sample_age_ms"), "{detail}");
    assert!(status["run"]["trials_stored"].as_u64().unwrap() <= before + 1, "{status:#}");
    let raised = |s: &Value| s["rig"]["safe_end"]["tips"] == "raised";
    site.until("/api/v1/status", raised).await;
    assert_eq!(site.answer(&format!("/api/v1/runs/{run}")).await["exit_status"], Value::Null);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_told_to_end_in_a_jog_stops_the_axis_before_it_is_gone() {
    let _turn = turn(WHOLE).await;
    // Slow enough that the end of the service comes long before that of the jog.
    let (site, _rig, control) = Site::with_rig_at("told", "4").await;
    let mut service = site.serve().await;
    let rig = |action: Value| site.post("/api/v1/rig/actions", action);
    rig(json!({ "action": "connect" })).await;
    rig(json!({ "action": "home" })).await;
    site.until("/api/v1/status", |s| s["rig"]["state"] == "homed").await;
    rig(json!({ "action": "jog", "axis": "x", "to_mm": 550.0 })).await;
    signal(&service.0, Signal::TERM);
    let ended = tokio::task::spawn_blocking(move || service.0.wait().unwrap()).await.unwrap();
    assert!(ended.success(), "{ended}");
    let truth = tell_at(&control, json!({ "cmd": "status" })).await;
    let x = &truth["axes"][0];
    assert_eq!(x["moving"], false, "{x}");
    assert!(x["position"].as_f64().unwrap() < 549.0, "stopped on its way: {x}");
    assert!(truth["stops"].as_u64().unwrap() >= 4, "{truth:#}");
}

/// A run that holds a load, its first trials stored.
async fn pressing(site: &Site) {
    // The load is held for two seconds of the wall.
    site.begin(settling(4, 40_000.0)).await;
    site.until("/api/v1/status", |s| {
        s["run"]["trials_stored"].as_u64() > Some(0) && s["run"]["phase"] == "settle"
    })
    .await;
}

/// A force over its limit and then an e-stop, while nothing can be stored: both act at once.
async fn trips_and_stops(site: &Site, control: &str) {
    let drift = json!({ "arm": 1, "n_per_s": 50.0 });
    tell_at(control, fault("drifting_cell", "cells", drift)).await;
    let ended = |s: &Value| !s["rig"]["trip"].is_null() && !s["rig"]["safe_end"].is_null();
    let status = site.until("/api/v1/status", ended).await;
    let end = &status["rig"]["safe_end"];
    assert_eq!(status["rig"]["trip"]["kind"], "force", "{status:#}");
    assert_eq!(end["tips"], "raised", "{end:#}");
    let stop_ms = end["sample_to_stop_ms"].as_f64().unwrap();
    assert!(stop_ms < 100.0, "{stop_ms} ms from the sample to z's stop");
    let asked = Instant::now();
    site.post("/api/v1/estop", json!({ "why": "test" })).await;
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    let stopped = |s: &Value| !s["rig"]["estop_acknowledged_ms"].is_null();
    site.until("/api/v1/status", stopped).await;
    let truth = tell_at(control, json!({ "cmd": "status" })).await;
    assert_eq!(truth["pressing"], false, "{truth:#}");
}

/// Once the store takes records again, it holds both, in order.
async fn told_afterwards(site: &Site) {
    let all = |page: &Value| {
        let events = page["items"].as_array().unwrap();
        let trip = |kind: &str| events.iter().position(|e| e["data"]["kind"] == kind);
        let end = events.iter().rposition(|e| e["kind"] == "safe_end");
        trip("force").is_some() && trip("force") < end && end < trip("estop")
    };
    site.until("/api/v1/events?since=0&limit=1000", all).await;
    let stop =
        |rows: &Value| rows["items"].as_array().unwrap().iter().any(|a| a["action"] == "estop");
    site.until("/api/v1/actions", stop).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trip_and_an_e_stop_do_not_wait_for_a_database_that_is_locked_for_a_minute() {
    let turn = turn(WHOLE).await;
    let (site, _rig, control) = Site::with_rig("locked").await;
    let _service = site.serve().await;
    let _operator = site.operator(&control);
    pressing(&site).await;
    let mut other = database(&site.folder.join("data")).await;
    sqlx::raw_sql("BEGIN IMMEDIATE").execute(&mut other).await.unwrap();
    let locked = Instant::now();
    trips_and_stops(&site, &control).await;
    // The rest is waiting.
    drop(turn);
    tokio::time::sleep(Duration::from_secs(60).saturating_sub(locked.elapsed())).await;
    other.close().await.unwrap();
    told_afterwards(&site).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trip_and_an_e_stop_do_not_wait_for_a_full_disk() {
    let _turn = turn(WHOLE).await;
    let (site, _rig, control) = Site::with_rig("full").await;
    let service = site.serve().await;
    let _operator = site.operator(&control);
    pressing(&site).await;
    let limit_files = |bytes| {
        let limit = Rlimit { current: bytes, maximum: None };
        prlimit(Some(Pid::from_child(&service.0)), Resource::Fsize, limit).unwrap();
    };
    limit_files(Some(0));
    trips_and_stops(&site, &control).await;
    limit_files(None);
    told_afterwards(&site).await;
}
