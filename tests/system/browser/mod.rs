//! The dashboard in headless Chromium, as a lab uses it: each test opens a service and a virtual rig
//! and runs one scenario of `scenarios.py` on them.
//! Needs Chromium, and Python with playwright and axe-playwright-python.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::bench::{Lab, rig_args};

const MODULES: &str = "playwright, axe_playwright_python";

/// A Python that has the modules, and the path of Chromium (`PALPATE_CHROMIUM`, otherwise `chromium`).
/// Without them the test prints `LEFT OUT`.
///
/// # Panics
/// If one is missing and `PALPATE_REQUIRE_TOOLS` is set.
fn tools() -> Option<(String, String)> {
    let or = |name: &str, other: &str| std::env::var(name).unwrap_or_else(|_| other.into());
    let (python, chromium) = (or("PALPATE_PYTHON", "python3"), or("PALPATE_CHROMIUM", "chromium"));
    let runs = |program: &str, args: &[&str]| {
        Command::new(program).args(args).output().is_ok_and(|output| output.status.success())
    };
    let found =
        runs(&python, &["-c", &format!("import {MODULES}")]) && runs(&chromium, &["--version"]);
    if !found {
        let missing = format!("no Chromium, or no Python that has {MODULES}");
        assert!(std::env::var_os("PALPATE_REQUIRE_TOOLS").is_none(), "{missing}");
        println!("LEFT OUT: {missing} (set PALPATE_CHROMIUM, PALPATE_PYTHON)");
        return None;
    }
    Some((python, chromium))
}

/// Runs a scenario in the browser to its end.
async fn plays(lab: &Lab, (python, chromium): (String, String), scenario: &str) {
    let mut command = Command::new(python);
    command
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/browser/scenarios.py"))
        .args([scenario, &lab.service.url(), &lab.rig.ready.control])
        .env("PALPATE_CHROMIUM", chromium)
        .env("PALPATE_SCREENS", Path::new(env!("CARGO_TARGET_TMPDIR")).join("screens"));
    let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap();
    let said = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    println!("{}", said.join("\n"));
    assert!(output.status.success(), "{scenario}: {}", said.join("\n"));
}

#[tokio::test(flavor = "multi_thread")]
async fn from_the_empty_folder_by_one_button_to_data_that_is_downloaded() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-first", rig_args("virtual", 40.0)).await;
    plays(&lab, tools, "first_evening").await;
    let runs = lab.get("/api/v1/runs").await;
    assert_eq!(runs["items"][0]["exit_status"], "success", "{runs:#}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_is_checked_started_paused_stopped_at_once_and_finished() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-operate", rig_args("virtual", 10.0)).await;
    plays(&lab, tools, "operate").await;
    let actions = lab.get("/api/v1/actions?limit=100").await;
    let by_her = |row: &Value| {
        let said = |key: &str| row[key].as_str().is_some_and(|text| text.contains("Ada"));
        said("who") || said("why")
    };
    for action in ["queue", "arm", "pause", "resume", "estop"] {
        let is_logged = |row: &Value| row["action"] == action && by_her(row);
        assert!(
            actions["items"].as_array().unwrap().iter().any(is_logged),
            "{action}: {actions:#}"
        );
    }
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_person_places_weights_as_the_page_says() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open_alone("browser-place", rig_args("virtual", 10.0)).await;
    plays(&lab, tools, "place").await;
    let trials = lab.get("/api/v1/trials").await;
    let by = |trial: &Value| trial["placed_by"].as_str().unwrap_or_default().to_owned();
    let placed: Vec<String> = trials["items"].as_array().unwrap().iter().map(by).collect();
    assert!(placed.len() == 3 && placed.iter().all(|who| who.contains("Ada")), "{placed:?}");
    lab.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_is_promoted_and_followed_live() {
    let Some(tools) = tools() else { return };
    let lab = Lab::open("browser-touch", rig_args("virtual", 1.0)).await;
    lab.home().await;
    super::live::small_net(&lab).await;
    plays(&lab, tools, "touch").await;
    lab.close().await;
}
