//! Leaving a run that `palpate run` follows: Ctrl-C stops it so that the same command resumes it, takes it out of the
//! queue, or takes its start back; a closed terminal and --detach leave it to the service, and `attach` follows it again.
//! Uses: the program, as at a terminal without a person. Never: the service's API.

use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

use crate::bench::{COMPUTES, LIMIT, ONE_TIP, Turn, signal, turn, with_responses};

/// Interval of polling for something that no line states.
pub const POLL: Duration = Duration::from_millis(20);
/// Longest wait for the end of a service that a test leaves.
const ENDED_WITHIN: Duration = Duration::from_secs(30);

/// A separate data folder, removed at the end with the service that may still use it, and a turn of the machine.
pub struct Desk {
    folder: PathBuf,
    _turn: Turn,
}

impl Desk {
    pub async fn new(name: &str) -> Self {
        Self::with_share(name, COMPUTES).await
    }

    /// As [`Self::new`], with another share of the machine.
    pub async fn with_share(name: &str, share: u32) -> Self {
        let turn = turn(share).await;
        let folder = std::env::temp_dir().join(format!("palpate-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("e.toml"), ONE_TIP).unwrap();
        std::fs::write(folder.join("next.toml"), ONE_TIP.replace("one-tip", "next")).unwrap();
        let desk = Self { folder, _turn: turn };
        with_responses(&desk.data());
        desk
    }

    fn data(&self) -> PathBuf {
        self.folder.join("data")
    }

    /// Writes a file into its folder.
    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.folder.join(name), text).unwrap();
    }

    /// A program in its folder, with its data.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.current_dir(&self.folder).env("PALPATE_DATA", self.data());
        command.env_remove("PALPATE_URL").env("PALPATE_LOG", "warn");
        command
    }

    pub fn palpate(&self, arguments: &[&str]) -> Started {
        let mut command = self.command(env!("CARGO_BIN_EXE_palpate"));
        command.args(arguments).arg("--json");
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().expect("palpate starts");
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Started { child, lines }
    }

    fn run(&self, more: &[&str]) -> Started {
        self.palpate(&[&["run", "e.toml", "--speed", "50"], more].concat())
    }

    /// The runs of the queue.
    fn queued(&self) -> Value {
        self.palpate(&["queue"]).end().0["items"].clone()
    }

    /// Waits until the first run of the queue waits for its turn.
    fn until_one_waits(&self) {
        until("a run that waits", || self.queued()[0]["waiting_since"].is_string());
    }

    /// Id of the service's process; none if it has ended.
    pub fn service(&self) -> Option<i64> {
        let text = std::fs::read_to_string(self.data().join("server.json")).ok()?;
        serde_json::from_str::<Value>(&text).unwrap()["process"].as_i64()
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        if let Some(process) = self.service() {
            kill_process(Pid::from_raw(process as i32).unwrap(), Signal::TERM).unwrap();
            let (process, start) = (format!("/proc/{process}"), Instant::now());
            while Path::new(&process).exists() && start.elapsed() < ENDED_WITHIN {
                std::thread::sleep(POLL);
            }
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

pub struct Started {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Started {
    fn until_stored(&mut self, trials: u64) {
        let at_least = |line: &Value| line["trials_stored"].as_u64() >= Some(trials);
        let found = self.lines.by_ref().map(parsed).any(|line| at_least(&line));
        assert!(found, "it ended before {trials} trials were stored");
    }

    fn signal(&self, sent: Signal) {
        signal(&self.child, sent);
    }

    /// Its last line, after it has left its run to the service.
    fn detached(self) -> Value {
        let (left, code) = self.end();
        assert_eq!((code, &left["event"]), (0, &json!("detached")), "{left:#}");
        left
    }

    /// Its last line and its exit code.
    pub fn end(mut self) -> (Value, i32) {
        let last = self.lines.by_ref().map(parsed).last().unwrap_or_default();
        (last, self.child.wait().unwrap().code().unwrap())
    }
}

/// Waits for something that no line states.
pub fn until(what: &str, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < LIMIT, "{what} does not come");
        std::thread::sleep(POLL);
    }
}

fn parsed(line: std::io::Result<String>) -> Value {
    serde_json::from_str(&line.unwrap()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_stops_a_run_that_the_same_command_resumes() {
    let desk = Desk::new("stopped").await;
    let mut run = desk.run(&[]);
    run.until_stored(5);
    run.signal(Signal::INT);
    let (last, code) = run.end();
    assert_eq!(code, 1, "{last:#}");
    assert_eq!((&last["exit_status"], &last["resumable"]), (&json!("stopped"), &json!(true)));
    let stored = last["trials_stored"].as_u64().unwrap();
    assert!((5..66).contains(&stored), "{last:#}");
    assert_eq!(last["reason"], format!("stopped at {stored} of 66 trials"));
    assert_eq!(desk.service(), None, "its service ends with it");

    let (last, code) = desk.run(&[]).end();
    assert_eq!((code, &last["exit_status"]), (0, &json!("success")), "{last:#}");
    assert_eq!((&last["scan_id"], &last["trials_stored"]), (&json!(1), &json!(66)));
    assert_eq!(last["twins"], 66, "those of the resumed part, too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_outlives_the_command_and_its_terminal() {
    let desk = Desk::new("detached").await;
    let left = desk.run(&["--detach"]).detached();
    assert_eq!(left["process"].as_i64(), desk.service());

    let mut attached = desk.palpate(&["attach"]);
    attached.until_stored(1);
    attached.signal(Signal::HUP);
    attached.detached();

    // The same command finds the run instead of queueing another one.
    let (last, code) = desk.palpate(&["run", "e.toml"]).end();
    assert_eq!((code, &last["scan_id"]), (0, &json!(1)), "{last:#}");
    assert_eq!((&last["exit_status"], &last["trials_stored"]), (&json!("success"), &json!(66)));
    assert!(desk.service().is_some(), "a detached service stays");
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_takes_a_run_that_waits_for_its_turn_out_of_the_queue() {
    let desk = Desk::new("waiting").await;
    desk.palpate(&["run", "e.toml", "--speed", "5", "--detach"]).detached();
    let waiting = desk.palpate(&["run", "next.toml"]);
    desk.until_one_waits();
    assert_eq!(desk.queued()[0]["experiment"], "next");
    waiting.signal(Signal::INT);
    let (last, code) = waiting.end();
    assert_eq!(code, 1, "{last:#}");
    assert_ne!(last["resumable"], true, "{last:#}");
    assert_eq!(desk.queued(), json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_whose_start_another_person_takes_back_is_followed_no_longer() {
    let desk = Desk::new("not-begun").await;
    desk.palpate(&["run", "e.toml", "--speed", "5", "--detach"]).detached();
    let waiting = desk.palpate(&["run", "next.toml"]);
    desk.until_one_waits();
    let (_, code) = desk.palpate(&["stop", "2"]).end();
    assert_eq!(code, 1, "a stop is of the active run");
    let (_, code) = desk.palpate(&["abort", "2"]).end();
    assert_eq!(code, 0);
    let (last, code) = waiting.end();
    assert_eq!((code, &last["scan_id"]), (1, &json!(2)), "{last:#}");
    assert_eq!(last["reason"], "it does not begin by itself any more: start it again");
    let next = &desk.queued()[0];
    assert_eq!((&next["experiment"], &next["waiting_since"]), (&json!("next"), &Value::Null));
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_takes_back_the_start_of_a_stopped_run_that_waits_for_its_turn() {
    let desk = Desk::new("taken-back").await;
    desk.palpate(&["run", "e.toml", "--speed", "10", "--detach"]).detached();
    let mut attached = desk.palpate(&["attach"]);
    attached.until_stored(1);
    attached.signal(Signal::INT);
    let (stopped, _) = attached.end();
    assert_eq!(stopped["exit_status"], "stopped", "{stopped:#}");
    let (left, code) = desk.palpate(&["run", "next.toml", "--detach"]).end();
    assert_eq!((code, &left["scan_id"]), (0, &json!(2)), "{left:#}");

    let resumed = desk.palpate(&["run", "e.toml"]);
    let row = || desk.palpate(&["show", "1"]).end().0["summary"]["run"].clone();
    until("a stopped run that waits", || row()["waiting_since"].is_string());
    resumed.signal(Signal::INT);
    let (last, code) = resumed.end();
    assert_eq!((code, &last["scan_id"]), (1, &json!(1)), "{last:#}");
    assert_eq!((&last["exit_status"], &last["resumable"]), (&json!("stopped"), &json!(true)));
    let row = row();
    assert_eq!((&row["state"], &row["waiting_since"]), (&json!("ended"), &Value::Null));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_ends_during_a_run_states_how_the_run_resumes() {
    let desk = Desk::new("service-ended").await;
    desk.run(&["--detach"]).detached();
    let mut attached = desk.palpate(&["attach"]);
    attached.until_stored(1);
    attached.signal(Signal::HUP);
    attached.detached();
    let service = desk.service().unwrap();
    kill_process(Pid::from_raw(service as i32).unwrap(), Signal::TERM).unwrap();
    until("the end of the service", || desk.service().is_none());
    let log = std::fs::read_to_string(desk.data().join("service.log")).unwrap();
    assert!(log.contains("leaves run 1 to be resumed: the next `palpate serve`"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_terminal_that_is_closed_before_the_run_begins_leaves_it_to_the_service() {
    let desk = Desk::new("hung-up").await;
    let run = desk.run(&[]);
    until("a service", || desk.service().is_some());
    run.signal(Signal::HUP);
    run.detached();
    let (last, code) = desk.palpate(&["attach", "1"]).end();
    assert_eq!((code, &last["exit_status"]), (0, &json!("success")), "{last:#}");
}
