//! The dashboard in headless Chromium, as a lab uses it: each test opens a service and a virtual rig
//! and runs one scenario of `scenarios.py` on them.
//! Needs Chromium, and Python with playwright and axe-playwright-python.

use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use serde_json::{Value, json};

use super::bench::{COMPUTES, Lab, left_out, rig_args};
use super::placement::{serve_exact, skin_alone};

const MODULES: &str = "playwright, axe_playwright_python";

/// A campaign of 24 trials.
const SHORT: &str = "name = 'short'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [1]\n\
    configurations = 4\ndepths = 6\nblock = 4\nreference_every = 4\n";
/// Process seconds in a wall second. No faster: the rig and its twins take from the browser's share of the machine, for
/// minutes.
const SPEED: f64 = 10.0;
/// A campaign of 6,000 trials, longer than any scenario.
const LONG: &str = "name = 'long'\nseed = 6\nsensor = 's'\n[real_hex]\ntips = [1]\n\
    configurations = 1000\ndepths = 6\n";
/// Two placements of two weights.
const WEIGHTS: &str = "name = 'weights'\nseed = 2\nsensor = 's'\n[real_random]\ncontacts = [2]\n\
    trials_each = 2\nweights_n = [4.905, 9.81]\n[measure]\nframes_per_trial = 5\n";

/// A Python that has the modules, and the path of Chromium (`PALPATE_CHROMIUM`, otherwise `chromium`).
/// Without them the test is left out.
fn tools() -> Option<&'static (String, String)> {
    static FOUND: OnceLock<Option<(String, String)>> = OnceLock::new();
    let found = FOUND.get_or_init(|| {
        let or = |name: &str, other: &str| std::env::var(name).unwrap_or_else(|_| other.into());
        let (python, chromium) =
            (or("PALPATE_PYTHON", "python3"), or("PALPATE_CHROMIUM", "chromium"));
        let runs = |program: &str, args: &[&str]| {
            Command::new(program).args(args).output().is_ok_and(|output| output.status.success())
        };
        let has_all =
            runs(&python, &["-c", &format!("import {MODULES}")]) && runs(&chromium, &["--version"]);
        has_all.then_some((python, chromium))
    });
    let missing = format!("no Chromium (PALPATE_CHROMIUM), or no Python that has {MODULES}");
    found.as_ref().or_else(|| left_out(&format!("{missing} (PALPATE_PYTHON)")))
}

/// Runs a scenario in the browser to its end.
async fn plays(lab: &Lab, (python, chromium): &(String, String), scenario: &str) {
    let mut command = Command::new(python);
    command
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/browser/scenarios.py"))
        .args([scenario, &lab.service.url(), &lab.rig.ready.control])
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("PALPATE_CHROMIUM", chromium)
        .env("PALPATE_SCREENS", Path::new(env!("CARGO_TARGET_TMPDIR")).join("screens"));
    let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap();
    let said = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    println!("{}", said.join("\n"));
    assert!(output.status.success(), "{scenario}: {}", said.join("\n"));
}

/// Opens a lab, and runs a scenario in the browser to its end.
async fn scenario(lab: impl Future<Output = Lab>, name: &str) {
    let Some(tools) = tools() else { return };
    let lab = lab.await;
    plays(&lab, tools, name).await;
    lab.close().await;
}

/// A lab with a long run under way, and the run's uid.
async fn running(name: &str) -> (Lab, String) {
    let lab = Lab::homed(name, SPEED, COMPUTES).await;
    let run = lab.begin(LONG).await;
    lab.stored(1).await;
    (lab, run)
}

/// A lab in which each page has something to show: a run that ended, its dataset, a net, a run that is
/// under way and one that waits.
async fn furnished(name: &str) -> Lab {
    let lab = Lab::homed(name, SPEED, COMPUTES).await;
    let run = lab.begin(SHORT).await;
    lab.ended(&run).await;
    lab.posted("/api/v1/datasets", json!({ "name": "run-1" })).await;
    super::live::small_net(&lab).await;
    lab.begin(LONG).await;
    lab.stored(1).await;
    lab.queue(SHORT).await;
    lab
}

/// The longest test: tests begin in the order of their names, and this one is the first of the module.
#[tokio::test(flavor = "multi_thread")]
async fn a_furnished_lab_has_no_serious_fault_for_axe_and_no_button_that_refuses_a_viewer() {
    let Some(tools) = tools() else { return };
    let lab = furnished("browser-furnished").await;
    plays(&lab, tools, "axe").await;
    // Last: it presses every button that a viewer sees, and ends the run.
    plays(&lab, tools, "viewer").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_empty_folder_by_one_button_to_data_that_is_downloaded() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-first", rig_args("virtual", 40.0), COMPUTES).await;
    plays(&lab, tools, "first_evening").await;
    let runs = lab.get("/api/v1/runs").await;
    assert_eq!(runs["items"][0]["exit_status"], "success", "{runs:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_is_checked_started_paused_stopped_at_once_and_finished() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-operate", rig_args("virtual", 10.0), COMPUTES).await;
    plays(&lab, tools, "operate").await;
    let actions = lab.items("/api/v1/actions?limit=100").await;
    let by_her = |row: &Value| {
        let said = |key: &str| row[key].as_str().is_some_and(|text| text.contains("Ada"));
        said("who") || said("why")
    };
    for action in ["queue", "arm", "pause", "resume", "estop"] {
        let is_logged = |row: &Value| row["action"] == action && by_her(row);
        assert!(actions.iter().any(is_logged), "{action}: {actions:?}");
    }
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn abort_asks_first_and_keeps_what_is_stored() {
    let Some(tools) = tools() else { return };
    let (lab, run) = running("browser-abort").await;
    plays(&lab, tools, "abort").await;
    let actions = lab.get(&format!("/api/v1/actions?run={run}&limit=100")).await;
    let aborts = actions["items"].as_array().unwrap().iter().filter(|a| a["action"] == "abort");
    assert_eq!(aborts.count(), 1, "a cancelled abort is not sent: {actions:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_homing_ends_by_the_button_that_is_there_while_it_moves() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-motion", rig_args("virtual", 1.0), COMPUTES).await;
    plays(&lab, tools, "motion").await;
    let actions = lab.items("/api/v1/actions?limit=100").await;
    let is_hers = |row: &Value| {
        row["action"] == "rig_abort" && row["who"].as_str().is_some_and(|who| who.contains("Ada"))
    };
    assert!(actions.iter().any(is_hers), "{actions:?}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_stop_needs_no_mouse() {
    scenario(async { running("browser-keyboard").await.0 }, "keyboard").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_places_weights_as_the_page_says() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open_alone("browser-place", rig_args("virtual", 10.0), COMPUTES).await;
    plays(&lab, tools, "place").await;
    let trials = lab.get("/api/v1/trials").await;
    let by = |trial: &Value| trial["placed_by"].as_str().unwrap_or_default().to_owned();
    let placed: Vec<String> = trials["items"].as_array().unwrap().iter().map(by).collect();
    assert!(placed.len() == 3 && placed.iter().all(|who| who.contains("Ada")), "{placed:?}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_weight_on_a_wrong_point_is_named_before_it_is_stored_and_a_trial_is_repeated() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open_alone("browser-wrong", skin_alone(), COMPUTES).await;
    serve_exact(&lab).await;
    lab.operate(json!({ "action": "connect", "who": "test" })).await;
    let run = lab.begin(WEIGHTS).await;
    plays(&lab, tools, "wrong_weight").await;
    let summary = lab.get(&format!("/api/v1/runs/{run}/summary")).await;
    assert_eq!(summary["retries"], 1, "one trial was withdrawn: {summary:#}");
    let trials = lab.get(&format!("/api/v1/runs/{run}/trials")).await;
    assert!(trials["items"][0]["placed_by"].as_str().unwrap().contains("Ada"), "{trials:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_is_promoted_and_followed_live() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-touch", rig_args("virtual", 1.0), COMPUTES).await;
    lab.operate(json!({ "action": "connect", "who": "test" })).await;
    super::live::small_net(&lab).await;
    super::live::quantity_nets(&lab).await;
    plays(&lab, tools, "touch").await;
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_connection_is_shown_and_heals() {
    let Some(tools) = tools() else { return };
    let (lab, _) = running("browser-lost").await;
    plays(&lab, tools, "lost").await;
    let status = lab.get("/api/v1/status").await;
    assert!(status["rig"]["trip"].is_null(), "no stop arrived later: {status:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn axe_finds_no_serious_fault_on_any_page_of_an_empty_service() {
    let lab = Lab::open("browser-axe-empty", rig_args("virtual", 1.0), COMPUTES);
    scenario(lab, "axe_empty").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_of_bulk_work_are_cancelled_gathered_and_submitted() {
    scenario(Lab::open("browser-bulk", rig_args("virtual", 1.0), COMPUTES), "bulk").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_has_no_element_for_each_trial_or_event() {
    scenario(Lab::homed("browser-size", 40.0, COMPUTES), "size").await;
}
