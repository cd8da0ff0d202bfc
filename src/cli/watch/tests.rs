//! The screen, drawn on terminals of several sizes that are only in memory.

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::style::Color;
use serde::Deserialize;
use serde_json::{Value, json};

use super::Asked;
use super::answers::Tour;
use super::draw::draw;
use super::facts::Now;
use super::night::{Mark, News, Night};
use super::theme::Theme;
use crate::api::{History, RigRates, RunProgress, StreamRates, WireRates};
use crate::campaign::shown::status::StreamStatus;
use crate::cli::view::StatusView;
use crate::event::Importance;
use crate::ids::RunUid;
use crate::schedule::visits::Visits;

const RUN: &str = "01890a5d-ac96-774b-bcce-b302099a8057";
const COLOUR: Theme = Theme { colour: true };

fn run() -> RunUid {
    RUN.parse().unwrap()
}

fn start() -> Timestamp {
    "2026-03-01T18:01:22Z".parse().unwrap()
}

fn after(seconds: i64) -> Now {
    Now { at: start() + SignedDuration::from_secs(seconds), zone: TimeZone::UTC }
}

/// Status of a running campaign, as the service answers.
fn status() -> Value {
    json!({
        "rig": { "name": "night-lab", "label": "virtual", "has_stage": true, "state": "armed",
            "trip": null,
            "clock_rate": 20.0,
            "pose": { "x_mm": 100.0, "y_mm": 80.0, "z_mm": 12.5, "radius_mm": 34.6 },
            "forces_n": [12.34, 70.0, 81.0, null, -0.1, 0.0], "force_limit_n": 80.0, "tips": 3,
            "stream": StreamStatus::default(), "wires": [], "estop_stops": [] },
        "run": { "uid": RUN, "scan_id": 12, "experiment": "real-hex-4", "is_manual": false,
            "state": "running", "requested_state": "paused", "phase": "press",
            "trials_planned": 33000, "trials_stored": 12481,
            "trials_skipped": 22, "retries": 3, "needed_bytes": 0,
            "eta": { "remaining_s": 7380.0, "low_s": 7000.0, "high_s": 8000.0 },
            "current_step": { "index": 2, "of": 5 } },
        "service": { "version": "0.1.0", "database": "palpate.db" },
        "lock": { "holder": "ada", "note": "hands\u{1b}[31m in the rig",
            "since": "2026-03-01T17:00:00Z" },
        "queue_length": 2,
        "disk": { "free_bytes": 212_000_000_000_u64, "needed_bytes": 14_000_000_000_u64 },
        "last_trial_at": "2026-03-01T18:01:20Z",
        "suspenders": [{ "name": "twins fvu", "title": "", "value": 0.0942, "threshold": 0.5,
            "unit": "", "since": null, "suspends": true }],
    })
}

fn told_status(status: &Value) -> News {
    let view = StatusView::deserialize(status).unwrap();
    News::Status(start(), Box::new(view))
}

/// The screen of a campaign with five configurations of which the third is pressed.
fn night() -> Night {
    let mut night = Night::new("http://127.0.0.1:8080");
    night.take(told_status(&status()), start());
    let at = |i: usize| vec![[90.0 * (i + 1) as f64, 100.0], [90.0 * (i + 1) as f64, 300.0]];
    let contacts_mm: Vec<Vec<[f64; 2]>> = (0..5).map(at).collect();
    let steps = Visits { contacts_mm, ..Visits::default() };
    night.take(News::Tour(run(), Some(Tour { depths_mm: vec![0.0, 0.5], steps })), start());
    let progress = RunProgress {
        stored: vec![2, 2, 0, 0, 0],
        attempts_failed: vec![0, 1, 0, 0, 0],
        skipped: vec![4],
        current: Some(1),
        next: Some(2),
        ..RunProgress::default()
    };
    night.take(News::Progress(run(), progress), start());
    let twins = json!({ "pool": { "rolling": { "level": "ok", "median_fvu": 0.0942 } },
        "runs": [{ "run": RUN, "trials": 12481, "pending": 11 }] });
    night.take(News::Twins(twins), start());
    let event = |seq: i64, kind: &str, data: Value| {
        json!({ "kind": kind, "seq": seq, "run": RUN,
        "at": "2026-03-01T17:59:01Z", "data": data })
    };
    let events = json!([
        event(1, "skipped", json!({ "configuration": 7, "reason": "no settling" })),
        event(2, "touch_off", json!({})),
    ]);
    night.take(News::Events(serde_json::from_value(events).unwrap()), start());
    night
}

/// The screen of a status that differs from that of the campaign.
fn night_with(change: impl FnOnce(&mut Value)) -> Night {
    let mut changed = status();
    change(&mut changed);
    let mut night = Night::new("");
    night.take(told_status(&changed), start());
    night
}

/// The text of such a screen.
fn shown_with(change: impl FnOnce(&mut Value)) -> String {
    text(&drawn(&night_with(change), &after(0), (120, 40), COLOUR))
}

fn drawn(night: &Night, now: &Now, (width, height): (u16, u16), theme: Theme) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, night, now, theme)).unwrap();
    terminal.backend().buffer().clone()
}

fn text(buffer: &Buffer) -> String {
    let width = usize::from(buffer.area.width);
    let symbols: Vec<&str> = buffer.content().iter().map(|cell| cell.symbol()).collect();
    symbols.chunks(width).map(|line| line.concat() + "\n").collect()
}

#[test]
fn all_facts_of_the_night_are_on_usual_terminals() {
    for size in [(80, 24), (120, 40), (200, 60)] {
        let shown = text(&drawn(&night(), &after(0), size, COLOUR));
        for words in [
            "night-lab [virtual]",
            "RUNNING → paused  run 12, real-hex-4",
            "12,481 of 33,000 trials, 22 skipped",
            "done 20:04 (19:58 .. 20:14), in 2 h 3 min",
            "needs you:  nothing",
            "12.3 N",
            "limit 80 N",
            "step 3 of 5, pressing",
            "last trial 2.0 s ago",
            "212.00 GB free, 14.00 GB needed",
            "11 pending, rolling FVU 0.094",
            "twins fvu  0.094 of 0.500",
            "17:59:01  skipped configuration 7: no settling",
            "1 done",
            "1 failed",
            "1 skipped",
            "E emergency stop",
        ] {
            assert!(shown.contains(words), "{words} at {size:?}:\n{shown}");
        }
        assert!(shown.contains("ada: hands\\u{1b}[31m"), "{shown}");
        assert!(shown.contains('●') && shown.contains('○') && shown.contains('×'), "{shown}");
    }
}

#[test]
fn what_is_watched_has_its_unit_and_the_free_disk_is_shown_once() {
    let watched = |name: &str, value: f64, threshold: f64, unit: &str| {
        json!({ "name": name, "title": "", "value": value, "threshold": threshold, "unit": unit,
            "since": null, "suspends": true })
    };
    let shown = shown_with(|status| {
        status["suspenders"] = json!([
            watched("disk", 3.26e10, 3.07e8, "bytes"),
            watched("frame_age", 8.604, 2000.0, "ms"),
            watched("electrode_pairs", 0.662, 1.0, "1"),
        ]);
    });
    for words in ["frame age  9 of 2000 ms", "electrode  pairs 0.662 of 1.000"] {
        assert!(shown.contains(words), "{words}:\n{shown}");
    }
    assert!(!shown.contains("0.31 GB"), "{shown}");
    let full = shown_with(|status| {
        let mut disk = watched("disk", 2e8, 3.07e8, "bytes");
        disk["since"] = "2026-03-01T18:00:00Z".into();
        status["suspenders"] = json!([disk]);
    });
    assert!(full.contains("0.20 GB of 0.31 GB, since "), "{full}");
}

#[test]
fn pace_prediction_rates_and_stuck_channels_are_shown() {
    let mut night = night();
    let course = History {
        from: "2026-03-01T08:00:00Z".parse().ok(),
        bin_s: Some(360.0),
        predicted_s: Some(43_200.0),
        trials: vec![10; 100],
        ..History::default()
    };
    night.take(News::Course(run(), course), start());
    let wire = WireRates {
        name: "cells".into(),
        requests_per_min: Some(1200.0),
        retries: 2,
        timeouts: 1,
        ..WireRates::default()
    };
    let stream = StreamRates {
        frames_per_s: Some(30.0),
        missed: 4,
        stuck: vec![17],
        ..StreamRates::default()
    };
    let rates = RigRates { over_s: 60.0, stream, wires: vec![wire] };
    night.take(News::Rates(rates), start());
    let shown = text(&drawn(&night, &after(0), (120, 40), COLOUR));
    for words in [
        "100 trials/h, 100 lately",
        "20:00 at the start, now 4 min 22 s later",
        "30.0 frames/s, 4 missed, 0 garbled",
        "cells: 1200/min, 2 repeated, 1 failed",
        "1 stuck (17)",
    ] {
        assert!(shown.contains(words), "{words}:\n{shown}");
    }
}

#[test]
fn twins_without_a_fit_show_their_backlog() {
    let mut night = night();
    let twins = json!({ "pool": { "rolling": null }, "runs": [{ "run": RUN, "pending": 7 }] });
    night.take(News::Twins(twins), start());
    let shown = text(&drawn(&night, &after(0), (120, 40), COLOUR));
    assert!(shown.contains("7 pending") && !shown.contains("rolling FVU"), "{shown}");
}

#[test]
fn no_size_of_a_terminal_is_too_small() {
    for night in [night(), Night::new("http://127.0.0.1:8080")] {
        for width in [1, 2, 7, 20, 40, 300] {
            for height in [1, 2, 3, 5, 9, 24, 100] {
                drawn(&night, &after(9), (width, height), COLOUR);
            }
        }
    }
}

#[test]
fn a_lost_connection_shows_within_three_seconds_and_old_values_are_grey() {
    let mut night = night();
    night.take(News::NoStatus("connection refused".into()), start());
    let fresh = drawn(&night, &after(1), (80, 24), COLOUR);
    assert!(!text(&fresh).contains("NO ANSWER"));
    assert!(fresh.content().iter().any(|cell| cell.fg == Color::Green));
    let old = drawn(&night, &after(3), (80, 24), COLOUR);
    assert!(
        text(&old).starts_with(" NO ANSWER for 3.0 s: what is below is old (connection refused)")
    );
    let below = &old.content()[80..23 * 80];
    assert!(below.iter().all(|cell| cell.fg == Color::DarkGray), "all that is old is grey");
    // The connection heals without a key.
    night.take(told_status(&status()), start());
    assert!(night.trouble.is_none());
}

#[test]
fn without_colours_no_cell_has_one_and_states_differ_by_their_symbols() {
    let plain = Theme { colour: false };
    for seconds in [0, 9] {
        let buffer = drawn(&night(), &after(seconds), (80, 24), plain);
        assert!(buffer.content().iter().all(|cell| cell.fg == Color::Reset));
        assert!(buffer.content().iter().all(|cell| cell.bg == Color::Reset));
    }
}

#[test]
fn configurations_have_the_marks_of_their_progress() {
    use Mark::{Done, Failed, Next, Now, Skipped};
    assert_eq!(night().marks(), [Done, Failed, Now, Next, Skipped]);
    let mut waiting = night_with(|_| {});
    assert_eq!(waiting.marks(), []);
    waiting.take(News::Tour(RunUid::new(), Some(Tour::default())), start());
    assert!(waiting.tour.is_none(), "of another run");
}

#[test]
fn what_a_person_must_do_first_is_named() {
    let first = |change: &dyn Fn(&mut Value)| night_with(change).first();
    assert_eq!(first(&|_| {}), (Importance::Routine, "nothing".into()));
    let need = |importance: &str, command: Value| {
        json!({ "kind": "reset", "importance": importance, "words": "Tripped\u{1b}[31m.\nReset.",
            "command": command, "page": "rig", "since": null })
    };
    let found = first(&|s| s["needs"] = json!([need("act", "palpate rig reset".into())]));
    let words = "Tripped\\u{1b}[31m. Reset. Next: palpate rig reset".to_owned();
    assert_eq!(found, (Importance::Act, words));
    let found = first(&|s| s["needs"] = json!([need("look", Value::Null)]));
    assert_eq!(found, (Importance::Look, "Tripped\\u{1b}[31m. Reset.".into()));
}

#[test]
fn a_doubt_of_the_night_is_named_before_all_numbers() {
    let glance = json!([
        { "question": "safe", "rating": "good", "words": "No fault." },
        { "question": "on_time", "rating": "warn", "words": "It waits: the rig tripped." },
        { "question": "data", "rating": "bad", "words": "FVU 0.900 over 9 trials." },
        { "question": "later", "rating": "of a newer service", "words": "Further words." }]);
    let shown = shown_with(|status| status["glance"] = glance);
    assert!(shown.contains("on time    It waits: the rig tripped."), "{shown}");
    assert!(shown.contains("data       FVU 0.900 over 9 trials."), "{shown}");
    assert!(shown.contains("later      Further words."), "{shown}");
    assert!(!shown.contains("No fault."), "{shown}");
}

#[test]
fn what_the_queue_waits_for_is_named() {
    let words = "run 13 (short) starts at 2026-03-01T22:00:00Z or later";
    let shown = shown_with(|status| status["waiting_for"] = words.into());
    assert!(shown.contains("queue      2 runs; run 13 (short) starts at"), "{shown}");
}

#[test]
fn what_may_be_asked_of_the_run_is_named() {
    let actions = json!([{ "action": "start", "refused": null },
        { "action": "pause", "refused": null }, { "action": "resume", "refused": "it runs" },
        { "action": "stop", "refused": null }]);
    let shown = shown_with(|status| status["run_actions"] = actions);
    assert!(shown.contains("may        pause, stop"), "{shown}");
}

#[test]
fn only_its_own_keys_ask_for_something() {
    let key = |code, modifiers| Asked::of(KeyEvent::new(code, modifiers));
    let plain = KeyModifiers::NONE;
    assert_eq!(key(KeyCode::Char('E'), KeyModifiers::SHIFT), Asked::Estop);
    assert_eq!(key(KeyCode::Char('e'), plain), Asked::Nothing);
    assert_eq!(key(KeyCode::Char('p'), plain), Asked::Pause);
    assert_eq!(key(KeyCode::Char('r'), plain), Asked::Resume);
    assert_eq!(key(KeyCode::Char('r'), KeyModifiers::CONTROL), Asked::Nothing);
    assert_eq!(key(KeyCode::Char('c'), KeyModifiers::CONTROL), Asked::Quit);
    assert_eq!(key(KeyCode::Esc, plain), Asked::Nothing);
}
