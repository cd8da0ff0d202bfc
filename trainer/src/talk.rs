//! The line to the service: events on standard output, the request to stop on standard input.
//! Uses: std. Never: a stop that leaves a started training without a checkpoint.

use std::io::{BufRead, Write};
use std::sync::Arc;

use parking_lot::Mutex;

use crate::learn::order::{Event, STOP_LINE};

/// The line to the service. Clones share it.
#[derive(Clone, Default)]
pub struct Talk(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    stopped: bool,
    /// Whether anything was learned that a stop must store.
    learning: bool,
}

impl Talk {
    /// Starts to listen: a line `stop` or the end of standard input, that is, of the service, stops the
    /// training. Before the first batch the process ends at once.
    pub fn begin() -> Self {
        let talk = Self::default();
        let listening = talk.clone();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                match line {
                    Ok(line) if line != STOP_LINE => {}
                    _ => break,
                }
            }
            let mut state = listening.0.lock();
            state.stopped = true;
            if !state.learning {
                say(&Event::Stopped);
                std::process::exit(0);
            }
        });
        talk
    }

    /// Reports an event.
    pub fn say(&self, event: &Event) {
        say(event);
    }

    /// Marks that something is learned, and returns whether a stop was requested.
    pub fn learns_on(&self) -> bool {
        let mut state = self.0.lock();
        state.learning = true;
        !state.stopped
    }
}

/// A service that has ended reads nothing: its end is noticed on standard input.
fn say(event: &Event) {
    let Ok(mut line) = serde_json::to_vec(event) else { return };
    line.push(b'\n');
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(&line).and_then(|()| out.flush());
}
