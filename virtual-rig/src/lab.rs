//! The bench with its clock and solver, as shared by all wires.
//! Uses: `bench`, `clock`, `solver`. Never: sockets; the lock is held only for computation.

use std::sync::atomic::AtomicU64;

use parking_lot::{Mutex, MutexGuard};
use serde::Serialize;

use crate::bench::{Arrival, Bench, Served};
use crate::clock::{RigClock, unix_s};
use crate::config::RigFile;
use crate::solver::Solver;

/// Counters of the stream.
#[derive(Debug, Default, Serialize)]
pub struct StreamCounters {
    /// Number of frames sent to at least one reader.
    pub sent: AtomicU64,
    /// Number of frames not sent because their load was not solved yet.
    pub unsolved: AtomicU64,
    /// Number of readers at present.
    pub readers: AtomicU64,
}

/// The bench with everything that its wires share.
pub struct Lab {
    /// Rig file in use.
    pub rig: RigFile,
    /// Clock of the rig.
    pub clock: RigClock,
    /// Solver of the skin.
    pub solver: Solver,
    /// Counters of the stream.
    pub stream: StreamCounters,
    bench: Mutex<Bench>,
}

impl Lab {
    /// Combines a bench with its clock and solver.
    pub fn new(rig: RigFile, clock: RigClock, solver: Solver, bench: Bench) -> Self {
        let (bench, stream) = (Mutex::new(bench), StreamCounters::default());
        Self { rig, clock, solver, stream, bench }
    }

    /// Locks the bench.
    pub fn bench(&self) -> MutexGuard<'_, Bench> {
        self.bench.lock()
    }

    /// Executes one request that has just arrived over a wire.
    pub fn serve(&self, line: &str, unit: u8, pdu: &[u8]) -> Served {
        let unix_s = unix_s();
        let (served, expected) = {
            let mut bench = self.bench();
            let arrival = Arrival { process_s: self.clock.process_s(), unix_s };
            let served = bench.serve(line, unit, pdu, arrival);
            (served, bench.take_expected())
        };
        for load in expected {
            self.solver.request(load);
        }
        served
    }
}
