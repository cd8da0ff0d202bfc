//! Ctrl-C at a terminal, at `run` and at `train`: it asks, and each answer does what it states; a second one aborts the
//! run, or stops the training.
//! Uses: the program, at a pseudo-terminal of `script` (util-linux). Never: a signal that is not of its keys.

use std::io::{Read, Write};
use std::process::{ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use serde_json::json;

use crate::bench::{LIMIT, Process, WHOLE, left_out};
use crate::leaving::{Desk, POLL, until};

const CTRL_C: &str = "\u{3}";
/// The last line of each question on a run.
const QUESTION: &str = "Ctrl-C again raises the tips now and aborts";
/// The last line of the question on a training.
const QUESTION_ON_TRAINING: &str = "Ctrl-C again stops";

/// A net as small as it can be, which learns until it is stopped, from simulations: it needs no trials.
const ENDLESS: &str = "name = 'endless'\nrows = 640\n[training]\nseed = 1\nepochs = 1000000\n\
    batch = 64\n[training.net]\nkind = 'point-net'\nhidden = 1\nwidth = 64\n\
    [training.noise]\nwhite_v = 1.2e-3\n";

/// A terminal at which a command runs.
struct Terminal {
    process: Process,
    keys: ChildStdin,
    /// All that was printed, and the length of it that the test has passed.
    shown: Arc<Mutex<String>>,
    passed: usize,
}

impl Terminal {
    fn new(desk: &Desk, words: &str) -> Self {
        let palpate = env!("CARGO_BIN_EXE_palpate");
        let line = format!("stty cols 100 rows 40 && exec '{palpate}' {words}");
        let mut command = desk.command("script");
        command.args(["-qec", &line, "/dev/null"]).env("SHELL", "/bin/sh").env("TERM", "xterm");
        command.env("NO_COLOR", "1");
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = Process(command.spawn().unwrap());
        let (keys, mut printed) =
            (process.0.stdin.take().unwrap(), process.0.stdout.take().unwrap());
        let shown = Arc::<Mutex<String>>::default();
        let all = shown.clone();
        std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(n @ 1..) = printed.read(&mut piece) {
                all.lock().push_str(&String::from_utf8_lossy(&piece[..n]));
            }
        });
        Self { process, keys, shown, passed: 0 }
    }

    /// Waits for something that is printed after what was waited for before; all that was printed since.
    fn until(&mut self, what: &str, is_shown: impl Fn(&str) -> bool) -> String {
        let start = Instant::now();
        loop {
            let shown = self.shown.lock().clone();
            let since = &shown[self.passed..];
            if is_shown(since) {
                self.passed = shown.len();
                return since.to_owned();
            }
            assert!(start.elapsed() < LIMIT, "{what} is not shown: {shown}");
            std::thread::sleep(POLL);
        }
    }

    fn until_words(&mut self, words: &str) {
        self.until(words, |shown| shown.contains(words));
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// Presses Ctrl-C, and waits for the last line of its question.
    fn ask(&mut self, last_line: &str) {
        self.press(CTRL_C);
        self.until_words(last_line);
    }

    /// Presses Ctrl-C once the run has a trial, and waits for the question.
    fn interrupt(&mut self) {
        let has_trial = |shown: &str| (1..66).any(|n| shown.contains(&format!(" {n}/66")));
        self.until("a trial", has_trial);
        self.ask(QUESTION);
    }

    /// Waits until the bar of a training shows an epoch; the first one.
    fn until_epoch(&mut self) -> u64 {
        let shown = self.until("an epoch", |shown| epoch(shown).is_some());
        epoch(&shown).unwrap()
    }

    /// Waits for the end of the command; its exit code.
    fn code(mut self) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.process.0.try_wait().unwrap() {
                return status.code();
            }
            assert!(start.elapsed() < LIMIT, "it does not end: {}", self.shown.lock());
            std::thread::sleep(POLL);
        }
    }
}

/// The first epoch that the bar of a training has shown, followed by a comma and the loss.
fn epoch(shown: &str) -> Option<u64> {
    shown.split(", epoch ").skip(1).find_map(|rest| rest.split_once(',')?.0.parse().ok())
}

/// Whether there is a program that makes terminals; without it a test is left out.
fn has_terminals() -> bool {
    let is_there = Command::new("script").arg("--version").output().is_ok();
    if !is_there {
        left_out::<()>("no script (util-linux)");
    }
    is_there
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_at_a_terminal_asks_and_each_answer_does_what_it_states() {
    if !has_terminals() {
        return;
    }
    let desk = Desk::new("terminal").await;
    let row = || desk.palpate(&["show", "1"]).end().0["summary"]["run"].clone();

    let mut run = Terminal::new(&desk, "run e.toml --speed 10");
    run.interrupt();
    run.press("d\n");
    run.until_words("run 1 continues without this terminal");
    assert_eq!(run.code(), Some(0));

    // It has: there is a run to attach to, and it stores trials.
    let mut attached = Terminal::new(&desk, "attach");
    attached.interrupt();
    attached.press("p\n");
    attached.until_words("pausing after this trial");
    until("the pause", || row()["state"] == "paused");
    let (answer, code) = desk.palpate(&["resume"]).end();
    assert_eq!(code, 0, "{answer:#}");
    until("the run again", || row()["state"] == "running");

    attached.interrupt();
    attached.press("s\n");
    attached.until_words("(virtual): stopped at ");
    assert_eq!(attached.code(), Some(1));
    let stopped = row();
    assert_eq!((&stopped["state"], &stopped["exit_status"]), (&json!("ended"), &json!("stopped")));

    // The detached service stays, with its speed.
    let mut resumed = Terminal::new(&desk, "run e.toml");
    resumed.until_words("run 1 resumes where it stopped");
    resumed.interrupt();
    resumed.press(CTRL_C);
    resumed.until_words("aborting: raising the tips now");
    assert_eq!(resumed.code(), Some(1));
    assert_eq!(row()["exit_status"], "abort");
}

/// It has the whole machine: the trainer computes on all cores.
#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_at_train_at_a_terminal_asks_and_each_answer_does_what_it_states() {
    if !has_terminals() {
        return;
    }
    let desk = Desk::with_share("terminal-train", WHOLE).await;
    desk.write("endless.toml", ENDLESS);
    let job = |named: &str| desk.palpate(&["job", "show", named]).end().0;

    let mut train = Terminal::new(&desk, "train endless.toml");
    let learned = train.until_epoch();
    train.ask(QUESTION_ON_TRAINING);
    // Another line than the answers: the question is repeated.
    train.press("p\n");
    train.until_words(QUESTION_ON_TRAINING);
    train.press("s\n");
    train.until("the stop", |shown| {
        shown.contains("stopping at a checkpoint, from which the same command resumes")
            && shown.contains("it was stopped; the same command resumes it from its checkpoint")
    });
    assert_eq!(train.code(), Some(1));
    assert_eq!(desk.service(), None, "its service ends with it");
    assert_eq!(job("last")["state"], "stopped");

    // The same command resumes, and leaves the training to the service that it started.
    let mut train = Terminal::new(&desk, "train endless.toml");
    let resumed = train.until_epoch();
    assert!(resumed >= learned, "epoch {resumed} after epoch {learned}");
    train.ask(QUESTION_ON_TRAINING);
    train.press("d\n");
    train.until_words("continues without this terminal");
    assert_eq!(train.code(), Some(0));
    assert!(desk.service().is_some(), "a detached service stays");
    until("an epoch without a terminal", || {
        let job = job("last");
        assert_eq!(job["state"], "running", "{job:#}");
        job["progress"]["epoch"].as_u64() > Some(resumed + 1)
    });

    // Another one waits for it. A second Ctrl-C stops without an answer.
    let mut waiting = Terminal::new(&desk, "train endless.toml");
    waiting.until_words("waits in the queue");
    waiting.ask(QUESTION_ON_TRAINING);
    waiting.press(CTRL_C);
    waiting.until_words("taking the training out of the queue; the same command requests it again");
    assert_eq!(waiting.code(), Some(1));
    assert_eq!([job("2")["state"].clone(), job("3")["state"].clone()], ["running", "stopped"]);
    let (stopped, code) = desk.palpate(&["job", "stop", "2"]).end();
    assert_eq!(code, 0, "{stopped:#}");
    until("the end of the training", || job("2")["state"] == "stopped");
}
