//! The bench with its clock and solver, as all wires share it.
//! Uses: `bench`, `clock`, `solver`. Never: sockets; the lock is held for computing only.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;

use crate::bench::{Bench, Served};
use crate::clock::{RigClock, unix_s};
use crate::config::RigFile;
use crate::solver::Solver;

/// What the stream has done.
#[derive(Debug, Default)]
pub struct StreamCounters {
    /// Frames sent to at least one reader.
    pub sent: AtomicU64,
    /// Frames not sent because their load was not solved yet.
    pub unsolved: AtomicU64,
    /// Readers right now.
    pub readers: AtomicU64,
}

/// The same, at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct StreamReport {
    /// Frames sent to at least one reader.
    pub sent: u64,
    /// Frames not sent because their load was not solved yet.
    pub unsolved: u64,
    /// Readers right now.
    pub readers: u64,
}

/// The whole lab.
pub struct Lab {
    /// The rig file in force.
    pub rig: RigFile,
    /// The rig's own clock.
    pub clock: RigClock,
    /// The skin's solver.
    pub solver: Solver,
    /// What the stream has done.
    pub stream: StreamCounters,
    bench: Mutex<Bench>,
}

impl Lab {
    /// Switches a bench on.
    pub fn new(rig: RigFile, clock: RigClock, solver: Solver, bench: Bench) -> Self {
        let (bench, stream) = (Mutex::new(bench), StreamCounters::default());
        Self { rig, clock, solver, stream, bench }
    }

    /// The bench, for a moment.
    pub fn bench(&self) -> MutexGuard<'_, Bench> {
        self.bench.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Carries out one request that has just come over a wire.
    pub fn serve(&self, line: &str, unit: u8, pdu: &[u8]) -> Served {
        let received = unix_s();
        let (served, expected) = {
            let mut bench = self.bench();
            let served = bench.serve(line, unit, pdu, self.clock.process_s(), received);
            (served, bench.take_expected())
        };
        for load in expected {
            self.solver.request(load);
        }
        served
    }

    /// The stream's counters.
    pub fn stream_report(&self) -> StreamReport {
        let read = |n: &AtomicU64| n.load(Ordering::Relaxed);
        StreamReport {
            sent: read(&self.stream.sent),
            unsolved: read(&self.stream.unsolved),
            readers: read(&self.stream.readers),
        }
    }
}
