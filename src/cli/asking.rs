//! A question at the terminal, whose answer arrives while other work continues.
//! Uses: a thread that waits for standard input. Never: a wait of the program for a person.

use std::io::IsTerminal;

use tokio::sync::oneshot;

use super::begin::entered_line;

/// The question that is open, if any.
#[derive(Debug, Default)]
pub struct Asking(Option<oneshot::Receiver<String>>);

impl Asking {
    /// Whether a person can be asked: standard input and standard error are a terminal.
    pub fn is_possible() -> bool {
        std::io::stdin().is_terminal() && std::io::stderr().is_terminal()
    }

    /// Waits for a line, in place of an earlier question. The caller prints the question.
    pub fn open(&mut self) {
        let (answer, line) = oneshot::channel();
        self.0 = Some(line);
        // Not a task of the runtime: a person who never answers must not keep the program from ending.
        std::thread::spawn(move || answer.send(entered_line().unwrap_or_default()));
    }

    /// Drops the question.
    pub fn close(&mut self) {
        self.0 = None;
    }

    /// The entered line, once; empty at the end of the input. Waits for ever if nothing is asked.
    pub async fn answer(&mut self) -> String {
        let Some(line) = &mut self.0 else { return std::future::pending().await };
        let line = line.await.unwrap_or_default();
        self.0 = None;
        line
    }
}
