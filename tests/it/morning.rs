//! The commands of the morning after, on the data folder of an earlier version: a run that ended, one that
//! was killed, one that is queued. The values follow from what was recorded when the folder was made.

use std::io::{BufRead, BufReader};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use serde_json::{Value, json};
use tokio::time::timeout;

use crate::datasets::filled::{Filled, store};
use crate::old_data::{HALF, WHOLE, recorded, served};
use crate::support::{self, Process, not_done};

/// Longest wait for anything.
const LIMIT: Duration = Duration::from_secs(30);

fn command(url: &str, arguments: &[&str]) -> Command {
    let mut command = support::command(arguments);
    command.args(["--url", url]).env("TZ", "UTC");
    command
}

/// What a command prints; it must succeed.
fn said(url: &str, arguments: &[&str]) -> String {
    let Output { status, stdout, stderr } = command(url, arguments).output().unwrap();
    let error = String::from_utf8_lossy(&stderr);
    assert!(status.success(), "{arguments:?}: {error}");
    let text = String::from_utf8(stdout).unwrap();
    assert!(!text.contains('\u{1b}'), "no colours without a terminal: {text}");
    text
}

fn told(url: &str, arguments: &[&str]) -> Value {
    serde_json::from_str(&said(url, &[arguments, &["--json"]].concat())).unwrap()
}

/// A command that must be refused with this exit code, in these words; returns its whole message.
fn refused(url: &str, arguments: &[&str], code: i32, words: &str) -> String {
    let output = command(url, arguments).output().unwrap();
    not_done(&output, code, words);
    String::from_utf8(output.stderr).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_morning_reads_what_was_recorded() {
    let (_folder, lab) = served("morning").await;
    runs_are_listed_newest_first_and_found_by_number_start_of_the_id_and_last(&lab).await;
    trials_are_listed_by_the_conditions_of_the_api(&lab).await;
    a_run_and_a_trial_are_drawn_as_plain_text_without_a_terminal(&lab).await;
    two_runs_are_compared_at_the_same_place_and_depth(&lab).await;
    lab.end().await;
}

async fn runs_are_listed_newest_first_and_found_by_number_start_of_the_id_and_last(lab: &Filled) {
    let url = lab.url("");
    let list = said(&url, &["runs"]);
    let lines: Vec<&str> = list.lines().collect();
    assert_eq!(lines.len(), 4, "{list}");
    assert!(lines[0].trim_start().starts_with("run  experiment"), "{list}");
    let column = |name: &str| lines[0].find(name).unwrap();
    assert!(column("label") < 80, "data without its label at a terminal of 80 columns: {list}");
    let first: Vec<&str> = lines.iter().filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(first, ["run", "3", "2", "1"]);
    assert!(lines[3].contains("success") && lines[3].contains("12 of 12"), "{list}");
    assert!(lines[2].contains("interrupted (restart)") && lines[2].contains("4 of 12"), "{list}");
    assert!(said(&url, &["runs", "--limit", "1"]).contains("the newest 1; --limit N shows more"));
    let some = told(&url, &["runs", "--state", "success,queued"]);
    let numbers: Vec<i64> =
        some["items"].as_array().unwrap().iter().map(|r| r["scan_id"].as_i64().unwrap()).collect();
    assert_eq!(numbers, [3, 1]);
    assert!(said(&url, &["runs", "--experiment", "nothing"]).contains("no run fits"));
    refused(&url, &["runs", "3"], 2, "palpate show 3 shows one run");
    refused(&url, &["runs", "--state", "succes"], 2, "; did you mean `success`?");
    let by_condition = told(&url, &["runs", "exit_status=success|state=queued"]);
    assert_eq!(by_condition["items"], some["items"]);

    let uid = recorded()["runs"][HALF]["uid"].as_str().unwrap().to_owned();
    for name in ["2", &uid, &uid[..uid.len() - 1]] {
        assert_eq!(told(&url, &["show", name])["summary"]["run"]["uid"], uid, "{name}");
    }
    assert_eq!(told(&url, &["show", "last"])["summary"]["run"]["scan_id"], 3);
    let why = refused(&url, &["show", &uid[..4]], 2, "3 runs begin like this");
    assert!(why.contains("their numbers: 3, 2, 1"), "{why}");
    refused(&url, &["show", "99"], 1, "no run 99: palpate runs lists all");
    refused(&url, &["show", "ffff"], 1, "no run ffff: palpate runs lists all");
    refused(&url, &["show", "the last"], 2, "number, start of the id");
    refused(&url, &["model", "show", "cal-00"], 2, "MODEL = cal-00: is a calibration");
}

async fn trials_are_listed_by_the_conditions_of_the_api(lab: &Filled) {
    let url = lab.url("");
    let list = said(&url, &["trials", "1", "--limit", "3"]);
    assert!(list.lines().next().unwrap().contains("largest, N"), "{list}");
    assert_eq!(list.lines().count(), 5, "{list}");
    assert!(list.lines().all(|line| line.chars().count() <= 110), "{list}");
    assert!(list.contains("the newest 3"), "{list}");
    let Output { stderr, .. } = command(&url, &["trials", "1"]).output().unwrap();
    let next = String::from_utf8(stderr).unwrap();
    assert!(next.contains("palpate dataset export run-1 --format csv"), "{next}");
    let trials = recorded()["trials"].as_array().unwrap().clone();
    let deep = trials.iter().filter(|t| t["depth_mm"].as_f64().unwrap() > 1.0).count();
    let found = told(&url, &["trials", "depth_mm__gt=1"]);
    assert_eq!((found["items"].as_array().unwrap().len(), &found["all"]), (deep, &json!(true)));
    assert_eq!(told(&url, &["trials", "last"])["items"], json!([]), "the queued run has none");
    assert!(said(&url, &["trials", "last"]).contains("no trial fits"));
    refused(&url, &["trials", "1", "colour=red"], 2, "colour");
}

async fn a_run_and_a_trial_are_drawn_as_plain_text_without_a_terminal(lab: &Filled) {
    let url = lab.url("");
    let run = said(&url, &["show", "1"]);
    for part in
        ["run 1, whole (real-hex, virtual): success", "12 of 12 stored", "skin", "depth, mm", "█"]
    {
        assert!(run.contains(part), "{part}: {run}");
    }
    assert!(run.lines().all(|line| line.chars().count() <= 110), "{run}");
    let Output { stderr, .. } = command(&url, &["show", "1"]).output().unwrap();
    let next = String::from_utf8(stderr).unwrap();
    let touched = told(&url, &["trials", "1", "contact_count__gt=0"])["items"].clone();
    let fvu = |trial: &&Value| trial["fvu"].as_f64().unwrap();
    let worst = touched.as_array().unwrap().iter().max_by(|a, b| fvu(a).total_cmp(&fvu(b)));
    assert!(next.contains(&format!("palpate show t{} ", worst.unwrap()["trial_id"])), "{next}");
    let trial = told(&url, &["trials", "1", "--limit", "1"])["items"][0].clone();
    let id = format!("t{}", trial["trial_id"]);
    let key = format!("1/{}/{}", trial["configuration"], trial["depth_index"]);
    let drawn = said(&url, &["show", &id]);
    assert_eq!(drawn, said(&url, &["show", &key]));
    for part in ["placement", "arm 1", "measured minus twin", "twin, same scale", " mV"] {
        assert!(drawn.contains(part), "{part}: {drawn}");
    }
    let frame = drawn.lines().skip_while(|line| !line.starts_with("measured  ")).count();
    assert_eq!(frame, 1 + 28 + 1, "a title, 28 rows and the scale: {drawn}");
    assert_eq!(told(&url, &["show", &id])["voltages_v"].as_array().unwrap().len(), 784);
    refused(&url, &["show", "t99999"], 1, "no trial t99999: palpate trials lists the newest");
    refused(&url, &["show", "812"], 1, "no run 812");
    refused(&url, &["show", "t8x"], 2, "RUN|TRIAL = t8x: must be a run (number, ");

    let lines = |what: &str, part: &str| -> Vec<Value> {
        let text = said(&url, &["show", what, "--raw", part]);
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    for part in ["attempts", "tares", "touch-offs", "references"] {
        let stored = lab.get(&format!("/api/v1/runs/1/records/{part}?limit=1000")).await;
        let at = |records: &[Value]| -> Vec<Value> {
            records.iter().map(|record| record["at"].clone()).collect()
        };
        assert_eq!(at(&lines("1", part)), at(stored["items"].as_array().unwrap()), "{part}");
    }
    assert!(!lines("1", "tares").is_empty());
    let none = command(&url, &["show", "3", "--raw", "attempts"]).output().unwrap();
    assert!(none.status.success() && none.stdout.is_empty(), "{none:?}");
    assert!(String::from_utf8_lossy(&none.stderr).contains("run 3 has no failed attempts"));
    let frames = lab.get(&format!("/api/v1/trials/{}/frames", trial["trial_id"])).await;
    let printed = lines(&key, "frames");
    assert_eq!(Some(printed.len()), frames["items"].as_array().map(Vec::len));
    assert_eq!(printed[0]["counts"], frames["items"][0]["counts"]);
    for (what, part) in [("1", "frames"), (id.as_str(), "plan")] {
        refused(&url, &["show", what, "--raw", part], 2, "must be a ");
    }
    let queued = said(&url, &["show", "3"]);
    assert!(queued.contains("queued") && queued.contains("0 of"), "{queued}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_are_selected_by_kind_and_followed_as_they_happen() {
    let (folder, lab) = served("morning-events").await;
    let url = lab.url("");
    let all = told(&url, &["events", "1", "--limit", "1000"])["items"].as_array().unwrap().clone();
    let kinds: Vec<&str> = all.iter().filter_map(|event| event["event"].as_str()).collect();
    assert!(kinds.contains(&"state") && kinds.contains(&"ended"), "{kinds:?}");
    let some = told(&url, &["events", "1", "--kind", "ended,tips"])["items"].clone();
    let wanted = kinds.iter().filter(|kind| ["ended", "tips"].contains(kind)).count();
    assert_eq!(some.as_array().unwrap().len(), wanted);
    let list = said(&url, &["events", "1", "--kind", "ended"]);
    assert!(list.starts_with("time ") && list.contains("success: "), "{list}");
    let several = said(&url, &["events", "--kind", "ended"]);
    let heads: Vec<&str> = several.lines().next().unwrap().split_whitespace().collect();
    assert_eq!(heads, ["time", "kind", "run", "event"]);
    assert!(several.lines().any(|line| line.contains("  ended    1  run ended")), "{several}");
    assert_eq!(said(&url, &["events", "--since", "0s", "--kind", "trip"]), "no event fits\n");
    let words = "--kind = tripp: must be one of trip, ";
    let why = refused(&url, &["events", "--kind", "ended,tripp"], 2, words);
    assert!(why.contains("; did you mean `trip`?"), "{why}");
    let page = lab.get("/api/v1/events?kind=ended&run=1&limit=1").await;
    assert_eq!(page["items"][0]["kind"], "ended");
    assert_eq!(lab.get("/api/v1/events?kind=no_such_kind").await["items"], json!([]));

    let mut earlier = command(&url, &["events", "-f", "--kind", "ended", "--limit", "1"]);
    let mut earlier = Process(earlier.stdout(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(earlier.0.stdout.take().unwrap()).lines();
    let line = tokio::task::spawn_blocking(move || lines.next());
    let line = timeout(LIMIT, line).await.expect("no event").unwrap().unwrap().unwrap();
    let words: Vec<&str> = line.split_whitespace().skip(2).take(5).collect();
    assert_eq!(words, ["ended", "run", "1", "run", "ended,"], "{line}");

    let mut follow = command(&url, &["events", "-f", "--kind", "trip", "--json"]);
    let mut follow = Process(follow.stdout(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(follow.0.stdout.take().unwrap()).lines();
    let read = tokio::task::spawn_blocking(move || lines.next());
    // The stream begins with events after it was opened.
    tokio::time::sleep(Duration::from_millis(1000)).await;
    let store = store(&folder).await;
    store.append_event(None, "rig", json!({ "state": "tripped" })).await.unwrap();
    let trip = store.append_event(None, "trip", json!({ "kind": "force" })).await.unwrap();
    store.close().await;
    let line = timeout(LIMIT, read).await.expect("no event").unwrap().unwrap().unwrap();
    let event: Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&event["event"], &event["seq"]), (&json!("trip"), &json!(trip.seq)));
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_report_is_one_file_that_loads_nothing_and_a_missing_browser_is_a_sentence() {
    let (folder, lab) = served("morning-report").await;
    let url = lab.url("");
    let out = folder.path("reports");
    let told = told(&url, &["report", "1", "--out", &out, "--no-pdf"]);
    assert_eq!(told["pdf"], Value::Null);
    let page = std::fs::read_to_string(folder.join("reports/run-1.html")).unwrap();
    for part in ["<!doctype html>", "Run 1, whole (virtual)", "<h2>Findings", "12 of 12", "<svg"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script") && !page.contains("src=") && !page.contains("<link"));
    let mut alone = command(&url, &["report", "2", "--out", &out]);
    let Output { status, stdout, stderr } = alone.env("PATH", &out).output().unwrap();
    let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success() && stderr.contains("no PDF was written"), "{stderr}");
    assert!(stdout.contains("has not ended: it is interrupted"), "{stdout}");
    assert!(folder.join("reports/run-2.html").is_file());
    lab.end().await;
}

async fn two_runs_are_compared_at_the_same_place_and_depth(lab: &Filled) {
    let url = lab.url("");
    let same = told(&url, &["diff", "1", "1"]);
    let pairs = same["forces"]["pairs"].as_u64().unwrap();
    assert_eq!(pairs, 12);
    assert_eq!(same["forces"]["all_n"]["median"], 0.0);
    assert_eq!(same["files"]["experiment"], json!([]));
    let fvu = &same["frames"]["fvu"];
    assert!(fvu.is_null() || fvu["median"] == 0.0, "{fvu}");
    let text = said(&url, &["diff", "1", "2"]);
    let (whole, half) = (&recorded()["runs"][WHOLE], &recorded()["runs"][HALF]);
    let head = text.lines().next().unwrap();
    assert!(head.contains("run 1") && head.contains("run 2"), "{text}");
    let name = text.lines().find(|line| line.starts_with("experiment")).unwrap();
    for run in [whole, half] {
        assert!(name.contains(run["experiment"].as_str().unwrap()), "{text}");
    }
    assert!(name.split_whitespace().nth(1) == Some("differs"), "{text}");
}
