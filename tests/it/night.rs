//! What a dashboard of the night reads, on the data folder of an earlier version: the sensor, the tour of
//! a run, its progress and its history, the wear, and the live status. The expected values follow from the
//! rows that were recorded when the folder was made.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use futures::StreamExt;
use serde_json::{Value, json};
use sim_core::stats::median;
use tokio::time::timeout;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

use crate::datasets::filled::Filled;
use crate::old_data::{HALF, NEXT, WHOLE, recorded, served};
use crate::support::sensor;

/// Longest wait for a message.
const LIMIT: Duration = Duration::from_secs(30);

fn path(recorded: &Value, run: usize, rest: &str) -> String {
    format!("/api/v1/runs/{}{rest}", recorded["runs"][run]["uid"].as_str().unwrap())
}

fn trials(recorded: &Value, run: usize) -> Vec<&Value> {
    let uid = &recorded["runs"][run]["uid"];
    recorded["trials"].as_array().unwrap().iter().filter(|t| t["run"] == *uid).collect()
}

fn list(value: &Value) -> Vec<Option<f64>> {
    value.as_array().unwrap().iter().map(Value::as_f64).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn is_near(found: Option<f64>, wanted: Option<f64>, within: f64) -> bool {
    match (found, wanted) {
        (Some(found), Some(wanted)) => (found - wanted).abs() <= within,
        (found, wanted) => found == wanted,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_night_reads_what_was_recorded() {
    let (recorded, (_folder, lab)) = (recorded(), served("night").await);
    the_sensor_is_that_of_its_file(&lab).await;
    the_tour_leads_over_the_stored_trials_and_the_progress_counts_them(&lab, &recorded).await;
    a_preflight_states_what_the_run_before_it_pressed_on_the_same_skin(&lab, &recorded).await;
    a_tour_is_sent_once(&lab, &recorded).await;
    the_history_has_every_trial_and_the_states_from_start_to_end(&lab, &recorded).await;
    the_wear_follows_from_the_stored_poses_and_tips(&lab, &recorded).await;
    the_live_status_beats_at_least_once_per_second(&lab).await;
    lab.end().await;
}

async fn the_sensor_is_that_of_its_file(lab: &Filled) {
    let (skin, found) = (sensor(), lab.get("/api/v1/sensor").await);
    let size = |key: &str| number(&found[key]);
    assert_eq!((size("width_mm"), size("height_mm")), (skin.file.width_mm, skin.file.height_mm));
    assert_eq!((&found["channels"], &found["injections"]), (&json!(784), &json!(28)));
    assert_eq!((&found["outline_mm"], size("force_map_mm")), (&Value::Null, 640.0));
    let points: Vec<[f64; 2]> = serde_json::from_value(found["points_mm"].clone()).unwrap();
    assert_eq!(points.len(), 804);
    for (point, wanted) in points.iter().zip(skin.points()) {
        assert!((point[0] - wanted.x_mm).abs() < 1e-9 && (point[1] - wanted.y_mm).abs() < 1e-9);
    }
    for (n, [x_mm, y_mm]) in skin.electrodes_mm().iter().enumerate() {
        let electrode = &found["electrodes"][n];
        assert_eq!(electrode["index"], n);
        assert!((number(&electrode["x_mm"]) - x_mm).abs() < 1e-9, "{electrode}");
        assert!((number(&electrode["y_mm"]) - y_mm).abs() < 1e-9, "{electrode}");
    }
    assert_eq!(lab.get("/api/v1/sensor?run=1").await, found);
    assert_eq!(lab.refused("/api/v1/sensor?run=99").await.0, 404);
}

async fn the_tour_leads_over_the_stored_trials_and_the_progress_counts_them(
    lab: &Filled,
    recorded: &Value,
) {
    for run in [WHOLE, HALF, NEXT] {
        let tour = lab.get(&path(recorded, run, "/tour")).await;
        let progress = lab.get(&path(recorded, run, "/progress")).await;
        let depths = tour["depths_mm"].as_array().unwrap().len();
        let order: Vec<u64> =
            serde_json::from_value(tour["steps"]["configuration"].clone()).unwrap();
        let planned = recorded["runs"][run]["trials_planned"].as_u64().unwrap();
        assert_eq!(planned, (order.len() * depths) as u64, "{tour:#}");
        assert_eq!(tour["kind"], "real-hex");
        assert_eq!(progress["trials_planned"], planned);
        let stored = trials(recorded, run);
        assert_eq!(progress["trials_stored"], stored.len());
        for (index, configuration) in order.iter().enumerate() {
            let of_it: Vec<&&Value> =
                stored.iter().filter(|t| t["configuration"] == *configuration).collect();
            let contacts = tour["steps"]["contacts_mm"][index].as_array().unwrap();
            assert_eq!(tour["steps"]["tips"][index], contacts.len());
            for trial in &of_it {
                let depth = trial["depth_index"].as_u64().unwrap() as usize;
                assert_eq!(tour["depths_mm"][depth], trial["depth_mm"]);
                for (arm, at) in trial["arms"].as_array().unwrap().iter().zip(contacts) {
                    assert!((number(&arm["x_mm"]) - number(&at[0])).abs() <= 0.0051, "{arm} {at}");
                    assert!((number(&arm["y_mm"]) - number(&at[1])).abs() <= 0.0051, "{arm} {at}");
                }
            }
            assert_eq!(progress["stored"][index], of_it.len());
            assert_eq!(progress["attempts_failed"][index], 0);
            let of = |key: &str| of_it.iter().filter_map(|t| t[key].as_f64()).collect::<Vec<_>>();
            let largest = of("max_force_n").into_iter().reduce(f64::max);
            let force = progress["largest_force_n"][index].as_f64();
            assert!(is_near(force, largest, 0.0006), "{force:?} {largest:?}");
            let (fvu, wanted) = (progress["fvu"][index].as_f64(), median(of("fvu")));
            assert!(is_near(fvu, wanted, 0.00006), "{fvu:?} {wanted:?}");
        }
        assert_eq!(progress["skipped"], json!([]));
        assert_eq!(progress["current"], Value::Null);
        // The killed run lacks two depths of its second configuration.
        let next = [Value::Null, json!(1), json!(0)];
        assert_eq!(progress["next"], next[run], "{progress:#}");
    }
}

async fn a_preflight_states_what_the_run_before_it_pressed_on_the_same_skin(
    lab: &Filled,
    recorded: &Value,
) {
    let earlier =
        async |run: usize| lab.get(&path(recorded, run, "/preflight")).await["earlier"].clone();
    let progress = lab.get(&path(recorded, HALF, "/progress")).await;
    let found = earlier(NEXT).await;
    assert_eq!(found["scan_id"], recorded["runs"][HALF]["scan_id"], "{found}");
    assert_eq!(found["forces_by_tips"], progress["forces_by_tips"]);
    assert_eq!(found["forces_by_tips"][0]["configurations"], 2, "{found}");
    assert_eq!(earlier(HALF).await["scan_id"], recorded["runs"][WHOLE]["scan_id"]);
    assert_eq!(earlier(WHOLE).await, Value::Null, "it was the first");
    // Over depth each trial counts once, and once for its number of tips.
    let forces = lab.items(&path(recorded, HALF, "/forces")).await;
    let count = |tips: Value| {
        let of_tips = forces.iter().filter(|at| at["tips"] == tips);
        of_tips.map(|at| at["trials"].as_u64().unwrap()).sum::<u64>() as usize
    };
    let stored = trials(recorded, HALF).len();
    assert_eq!((count(Value::Null), count(json!(2))), (stored, stored), "{forces:?}");
}

async fn a_tour_is_sent_once(lab: &Filled, recorded: &Value) {
    let address = path(recorded, WHOLE, "/tour");
    let first = lab.answer(&address).await;
    let tag = first.headers()["etag"].clone();
    let again = lab.http.get(lab.url(&address)).header("if-none-match", &tag).send().await.unwrap();
    assert_eq!((again.status().as_u16(), &again.headers()["etag"]), (304, &tag));
    assert!(again.bytes().await.unwrap().is_empty());
    lab.refuses_get("/api/v1/runs/99/tour", 404, "").await;
}

async fn the_history_has_every_trial_and_the_states_from_start_to_end(
    lab: &Filled,
    recorded: &Value,
) {
    for bins in [1, 7, 120] {
        let history = lab.get(&path(recorded, WHOLE, &format!("/history?bins={bins}"))).await;
        let stored = trials(recorded, WHOLE);
        let counts = list(&history["trials"]);
        assert_eq!(counts.len(), bins);
        assert_eq!(counts.iter().flatten().sum::<f64>(), stored.len() as f64);
        for key in ["attempts_failed", "largest_force_n", "fvu"] {
            assert_eq!(history[key].as_array().unwrap().len(), bins, "{key}");
        }
        // Each trial is in the bin of its time.
        let (from, bin_s) = (time(&history["from"]), number(&history["bin_s"]));
        let mut by_bin: BTreeMap<usize, Vec<&Value>> = BTreeMap::new();
        for trial in stored {
            let bin = ((time(&trial["measured_at"]) - from) / bin_s) as usize;
            by_bin.entry(bin.min(bins - 1)).or_default().push(trial);
        }
        for (bin, of_it) in by_bin {
            let of = |key: &str| of_it.iter().filter_map(|t| t[key].as_f64()).collect::<Vec<_>>();
            assert_eq!(counts[bin], Some(of_it.len() as f64), "bin {bin} of {bins}");
            let largest = of("max_force_n").into_iter().reduce(f64::max);
            assert!(is_near(history["largest_force_n"][bin].as_f64(), largest, 1e-9));
            assert!(is_near(history["fvu"][bin].as_f64(), median(of("fvu")), 1e-9));
        }
        let run = &recorded["runs"][WHOLE];
        assert_eq!((&history["from"], &history["to"]), (&run["started_at"], &run["ended_at"]));
        let states = history["states"].as_array().unwrap();
        assert_eq!(states[0]["state"], "running");
        assert_eq!(states[0]["from"], run["started_at"]);
        assert_eq!(states.last().unwrap()["to"], run["ended_at"]);
        assert!(states.windows(2).all(|pair| pair[0]["to"] == pair[1]["from"]), "{states:#?}");
        assert!(states.iter().any(|s| s["state"] == "paused" && s["why"] == "tip_change"));
        // That version stored no estimates.
        assert_eq!((&history["predicted_s"], &history["predictions"]), (&Value::Null, &json!([])));
        let uid = &run["uid"];
        let notable = recorded["events"].as_array().unwrap().iter().filter(|e| {
            let kind = e["kind"].as_str().unwrap();
            e["run"] == *uid && ["wanted", "tips", "ended", "trip"].contains(&kind)
        });
        let notable: Vec<&Value> = notable.map(|e| &e["seq"]).collect();
        let shown = history["events"].as_array().unwrap();
        assert_eq!(shown.iter().map(|e| &e["seq"]).collect::<Vec<_>>(), notable);
        let wanted = shown.iter().find(|e| e["kind"] == "wanted").unwrap();
        assert_eq!(wanted["importance"], "look");
    }
    let half = lab.get(&path(recorded, HALF, "/history")).await;
    let last = half["states"].as_array().unwrap().last().unwrap();
    assert_eq!((&last["state"], &last["to"]), (&json!("interrupted"), &Value::Null), "{half:#}");
    let next = lab.get(&path(recorded, NEXT, "/history")).await;
    assert_eq!((&next["from"], &next["trials"]), (&Value::Null, &json!([])));
    for bins in [0, 1001] {
        lab.refuses_get(&path(recorded, WHOLE, &format!("/history?bins={bins}")), 400, "").await;
    }
}

/// Seconds since 1970.
fn time(value: &Value) -> f64 {
    let at: jiff::Timestamp = value.as_str().unwrap().parse().unwrap();
    at.as_millisecond() as f64 / 1e3
}

async fn the_wear_follows_from_the_stored_poses_and_tips(lab: &Filled, recorded: &Value) {
    let wear = lab.get("/api/v1/wear").await;
    let all = recorded["trials"].as_array().unwrap();
    assert_eq!((&wear["trials"], &wear["runs"]), (&json!(all.len()), &json!(2)));
    assert_eq!(wear["since"], all[0]["measured_at"]);
    let mut pressed = BTreeSet::new();
    let mut presses: BTreeMap<(i64, i64), u64> = BTreeMap::new();
    for trial in all {
        if pressed.insert((trial["scan_id"].as_i64(), trial["configuration"].as_i64())) {
            for arm in trial["arms"].as_array().unwrap() {
                let at = |key: &str| (number(&arm[key]) * 100.0).round() as i64;
                *presses.entry((at("x_mm"), at("y_mm"))).or_default() += 1;
            }
        }
    }
    let points = &wear["points"];
    let wanted: Vec<(i64, i64, u64)> = presses.iter().map(|((x, y), n)| (*x, *y, *n)).collect();
    let hundredths = |v: &Option<f64>| (v.unwrap() * 100.0).round() as i64;
    let found: Vec<(i64, i64, u64)> = (list(&points["x_mm"]).iter())
        .zip(&list(&points["y_mm"]))
        .zip(&list(&points["presses"]))
        .map(|((x, y), n)| (hundredths(x), hundredths(y), n.unwrap() as u64))
        .collect();
    assert_eq!(found, wanted);
    for (n, key) in ["x_mm", "y_mm", "z_mm", "radius_mm"].into_iter().enumerate() {
        let travelled = |run: usize| {
            let at: Vec<f64> =
                trials(recorded, run).iter().map(|t| number(&t["reached"][key])).collect();
            at.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>()
        };
        let wanted_m = (travelled(WHOLE) + travelled(HALF)) / 1e3;
        let found_m = number(&wear["axes"][n]["travel_m"]);
        assert!((found_m - wanted_m).abs() < 1e-9, "{key}: {found_m} {wanted_m}");
    }
    assert_eq!(wear["cells"].as_array().unwrap().len(), 6);
    assert_eq!(wear["cells"][0]["calibrated_on"], Value::Null);
    assert_eq!(wear["checked_at"], Value::Null);
}

async fn the_live_status_beats_at_least_once_per_second(lab: &Filled) {
    let address = lab.url("/api/v1/status/live").replacen("http", "ws", 1);
    let (mut socket, _) = connect_async(address).await.unwrap();
    let mut beats = Vec::new();
    while beats.len() < 4 {
        let message = timeout(LIMIT, socket.next()).await.expect("a message").unwrap().unwrap();
        let Message::Text(text) = message else { continue };
        let message: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(message["status"]["rig"]["state"], "disconnected", "{message:#}");
        assert_eq!(message["status"]["queue_length"], 1);
        let lengths = ["at_ms", "z_mm", "forces_n"].map(|key| list_of(&message["samples"][key]));
        assert_eq!(lengths, [0; 3], "no cell is read");
        beats.push(Instant::now());
    }
    let took = beats[3] - beats[0];
    // Three beats; the machine may have other work.
    assert!(took < Duration::from_secs(9), "{took:?}");
    // The first message does not wait for a change.
    let status = lab.get("/api/v1/status").await;
    assert_eq!((&status["run"], &status["suspenders"]), (&Value::Null, &json!([])));
    assert!(number(&status["disk"]["free_bytes"]) > number(&status["disk"]["needed_bytes"]));
    assert!(number(&status["disk"]["needed_bytes"]) > 0.0, "a run is queued");
    assert_eq!(status["last_trial_at"], Value::Null);
    assert_eq!(status["needs"], json!([]));
    assert_eq!(
        status["glance"][0],
        json!({ "question": "safe", "rating": "unknown",
            "words": "Nothing moves: the wires are closed." })
    );
    let on_time = status["glance"][1]["words"].as_str().unwrap_or_default();
    assert!(on_time.starts_with("No run is active. Next: "), "{on_time}");
    assert_eq!(status["glance"][2]["question"], "data");
    let samples = lab.get("/api/v1/rig/samples?minutes=30").await;
    assert_eq!(samples, json!({ "at_ms": [], "z_mm": [], "forces_n": [] }));
    assert_eq!(lab.refused("/api/v1/rig/samples?minutes=31").await.0, 400);
    // Without a tare since the start: a stored trial whose forces are close to zero.
    let untouched = lab.get("/api/v1/frames/untouched").await;
    assert_eq!(list_of(&untouched["voltages_v"]), 784);
    assert!(number(&untouched["frames"]) >= 1.0);
    assert!(untouched["run"].is_string(), "{}", untouched["run"]);
}

fn list_of(value: &Value) -> usize {
    value.as_array().unwrap().len()
}
