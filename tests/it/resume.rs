//! `palpate resume` of a paused run: on a real rig it asks whether the rig is clear, as at the start of a run.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::json;

use crate::support::{command, false_service};

/// A service whose rig, with this label, has a paused run; counts the actions that are requested of it.
fn service(label: &'static str) -> (String, Arc<AtomicUsize>) {
    let actions = Arc::<AtomicUsize>::default();
    let counted = actions.clone();
    let url = false_service(move |request| match request {
        probe if probe.starts_with("get /health/live") => json!({ "service": "palpate" }),
        action if action.starts_with("post ") => {
            counted.fetch_add(1, Ordering::SeqCst);
            json!({})
        }
        _ => json!({
            "at": "2026-11-26T21:00:00Z",
            "rig": { "name": "lab", "label": label, "has_stage": true, "state": "armed", "trip": null,
                "clock_rate": 1.0, "forces_n": [], "wires": [], "estop_stops": [],
                "stream": { "frames": 0, "missed": 0, "garbled": 0, "reconnects": 0, "age_ms": null } },
            "run": { "uid": "01a20548-5305-733a-b99f-4e84507b8e49", "scan_id": 3, "experiment": "hex",
                "is_manual": false, "state": "paused", "phase": "wait", "trials_planned": 9,
                "trials_stored": 4, "trials_skipped": 0, "retries": 0, "needed_bytes": 0 },
            "service": { "version": "0.1.0", "database": "palpate.db" },
            "queue_length": 0,
            "suspenders": [],
        }),
    });
    (url, actions)
}

#[test]
fn a_paused_run_on_a_real_rig_resumes_only_if_its_motion_is_confirmed() {
    for (label, option, resumes) in
        [("measured", None, false), ("measured", Some("--yes"), true), ("virtual", None, true)]
    {
        let (url, actions) = service(label);
        // Standard input is no terminal.
        let mut asked = command(&["resume", "--url", &url]);
        let output = asked.args(option).output().unwrap();
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.success(), resumes, "{label} {option:?}: {words}");
        assert_eq!(actions.load(Ordering::SeqCst), usize::from(resumes), "{label} {option:?}");
        assert!(resumes || words.contains("rig lab is real: confirm its motion"), "{words}");
    }
}
