//! A command whose service answers late names what it waits for.

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::sync::mpsc;
use std::time::Duration;

use serde_json::json;

use crate::support::{command, false_service};

/// Longest wait of the service for the command's words.
const WORDS_WITHIN: Duration = Duration::from_secs(60);

#[test]
fn a_command_whose_service_answers_late_names_what_it_waits_for() {
    let (release, released) = mpsc::channel::<()>();
    // Without runs. It answers all but the probe only once it is released.
    let url = false_service(move |request| {
        if request.starts_with("get /health/live") {
            return json!({ "service": "palpate" });
        }
        released.recv_timeout(WORDS_WITHIN).ok();
        json!({ "items": [] })
    });
    let mut process = command(&["runs", "--url", &url])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut shown = BufReader::new(process.stderr.take().unwrap()).lines().map(Result::unwrap);
    let named = shown.any(|line| line.contains("waiting for the service"));
    drop(release);
    assert!(named && process.wait().unwrap().success());
}
