//! Ctrl-C at a terminal: it asks, and each answer does what it states; a second one aborts.
//! Uses: the program, at a pseudo-terminal of `script` (util-linux). Never: a signal that is not of its keys.

use std::io::{Read, Write};
use std::process::{ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use serde_json::json;

use crate::bench::{LIMIT, Process, left_out};
use crate::leaving::{Desk, POLL, until};

const CTRL_C: &str = "\u{3}";
/// The last line of each question.
const QUESTION: &str = "Ctrl-C again raises the tips now and aborts";

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

    /// Waits for something that is printed after what was waited for before.
    fn until(&mut self, what: &str, is_shown: impl Fn(&str) -> bool) {
        let start = Instant::now();
        loop {
            let shown = self.shown.lock().clone();
            if is_shown(&shown[self.passed..]) {
                self.passed = shown.len();
                return;
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

    /// Presses Ctrl-C once the run has a trial, and waits for the question.
    fn interrupt(&mut self) {
        let has_trial = |shown: &str| (1..66).any(|n| shown.contains(&format!(" {n}/66")));
        self.until("a trial", has_trial);
        self.press(CTRL_C);
        self.until_words(QUESTION);
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

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_at_a_terminal_asks_and_each_answer_does_what_it_states() {
    if Command::new("script").arg("--version").output().is_err() {
        left_out::<()>("no script (util-linux)");
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
