//! Solves the skin under a held load, once, on its own thread. Until then there is no frame of that
//! load.
//! Uses: `skin`, std threads. Never: time, frames.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use parking_lot::Mutex;

use crate::bench::Load;
use crate::skin::AnySkin;

/// Number of loads whose voltages are stored.
const LOADS_KEPT: usize = 32;
/// Number of loads that may wait; the newest is solved first, and the others are requested again if
/// needed.
const WAITING: usize = 16;
/// Period at which the thread checks whether a handle still exists.
const PATIENCE: Duration = Duration::from_millis(200);

/// Voltages of a held load, V, injection-major.
pub type Solved = Arc<Vec<f64>>;

type Known = Mutex<VecDeque<(Arc<Load>, Solved)>>;

/// Handle of the solver.
#[derive(Clone)]
pub struct Solver {
    requests: SyncSender<Arc<Load>>,
    known: Arc<Known>,
}

impl Solver {
    /// Starts the thread, and waits for the untouched skin. The thread ends when the last handle is
    /// dropped.
    ///
    /// # Errors
    /// The operating system's error if the thread cannot be created.
    pub fn start(skin: AnySkin) -> io::Result<Self> {
        let (requests, inbox) = sync_channel(WAITING);
        let known: Arc<Known> = Arc::default();
        let untouched = Arc::new(Load::default());
        let at_rest = skin.solve(&untouched.tips).map_err(io::Error::other)?;
        remember(&known, Arc::clone(&untouched), Arc::new(at_rest));
        let shelf = Arc::clone(&known);
        thread::Builder::new().name("skin".into()).spawn(move || work(&skin, &inbox, &shelf))?;
        Ok(Self { requests, known })
    }

    /// Requests a load. A full queue drops the request: the stream repeats it as long as it needs
    /// the load.
    pub fn request(&self, load: Arc<Load>) {
        if self.solved(&load).is_none() {
            self.requests.try_send(load).ok();
        }
    }

    /// Voltages of a load, V; none before it is solved.
    pub fn solved(&self, load: &Load) -> Option<Solved> {
        let mut known = self.known.lock();
        let at = known.iter().position(|(l, _)| **l == *load)?;
        let entry = known.remove(at)?;
        let solved = Arc::clone(&entry.1);
        known.push_front(entry);
        Some(solved)
    }
}

fn remember(known: &Known, load: Arc<Load>, solved: Solved) {
    let mut known = known.lock();
    known.push_front((load, solved));
    known.truncate(LOADS_KEPT);
}

fn work(skin: &AnySkin, inbox: &Receiver<Arc<Load>>, known: &Known) {
    loop {
        let load = match inbox.recv_timeout(PATIENCE) {
            Ok(load) => load,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let load = inbox.try_iter().last().unwrap_or(load);
        let have = known.lock().iter().any(|(l, _)| *l == load);
        if !have {
            match skin.solve(&load.tips) {
                Ok(solved) => remember(known, load, Arc::new(solved)),
                // No frame of this load is ever sent.
                Err(error) => tracing::error!(%error, ?load, "the skin has no solution"),
            }
        }
    }
}
