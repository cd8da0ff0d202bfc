//! What the service keeps in memory for its readers: values that are expensive to read, and the live
//! samples and messages.
//! Uses: `kept`, the resources whose values are kept. Never: a value that is not also stored, except the
//! samples of the last half hour and the counters of the last minute.

use std::sync::Arc;

use jiff::Timestamp;
use parking_lot::Mutex;

use super::estop::Stopper;
use super::gather::GatherOut;
use super::history::History;
use super::kept::Kept;
use super::limits::{
    HISTORY_KEPT, KEPT_RUNS, PROGRESS_KEPT, ROOM_MAX, STORED_PART_KEPT, TOUR_KEPT, TOURS_MAX,
    WEAR_KEPT, WORKERS_KEPT,
};
use super::live_status::Messages;
use super::queue_times::Planned;
use super::rates::Counters;
use super::samples::Ring;
use super::status::StoredPart;
use super::suspenders::Beyond;
use super::tour::KeptTour;
use super::wear::{EndedWear, Wear};
use super::workers::WorkersOut;
use crate::ids::RunUid;
use crate::record::Untouched;
use crate::schedule::experiment::TwinLimits;
use crate::store::StoredParts;

/// Answers that are kept, so that a request need not read the store again.
#[derive(Debug)]
pub struct Memory {
    /// Tours by run and plan.
    pub(super) tours: Kept<(RunUid, Option<String>), Arc<KeptTour>>,
    /// Stored parts of progresses.
    pub(super) progress: Kept<RunUid, Arc<StoredParts>>,
    /// Histories by run, number of bins, and whether the run has ended.
    pub(super) histories: Kept<(RunUid, u32, Option<Timestamp>), Arc<History>>,
    /// Start of runs, and their durations as they were predicted then, s.
    pub(super) predicted: Kept<RunUid, Option<(Timestamp, f64)>>,
    /// Limits of the fit of runs.
    pub(super) limits: Kept<RunUid, Option<Arc<TwinLimits>>>,
    /// Disk space of queued runs by definition and number of trials, bytes.
    pub(super) room: Kept<(String, u64), Option<u64>>,
    /// Durations of queued runs by run and plan.
    pub(super) planned: Kept<(RunUid, Option<String>), Arc<Planned>>,
    /// The stored part of the live status.
    pub(super) stored_part: Kept<(), StoredPart>,
    /// The stored frame of the untouched skin.
    pub(super) untouched: Kept<(), Option<Arc<Untouched>>>,
    /// Wear of skin, axes and cells.
    pub(super) wear: Kept<(), Arc<Wear>>,
    /// State of workers and their queue, or why there is none.
    pub(super) workers: Kept<(), Result<Arc<WorkersOut>, String>>,
    /// The last order that was gathered.
    pub(super) gather: Mutex<Option<GatherOut>>,
    /// The wear by runs that have ended.
    pub(super) ended_wear: EndedWear,
    /// Since when values are beyond their thresholds.
    pub(super) beyond: Beyond,
    /// Who latched the e-stop last.
    pub(super) stopper: Stopper,
    /// Messages of the live status.
    pub(super) live_status: Messages,
    /// Samples of the load cells.
    pub(super) samples: Ring,
    /// Counters of the stream and the wires.
    pub(super) counters: Counters,
}

impl Default for Memory {
    fn default() -> Self {
        Self {
            tours: Kept::new(TOUR_KEPT, TOURS_MAX),
            progress: Kept::new(PROGRESS_KEPT, KEPT_RUNS),
            histories: Kept::new(HISTORY_KEPT, KEPT_RUNS),
            predicted: Kept::new(HISTORY_KEPT, 1),
            limits: Kept::new(TOUR_KEPT, KEPT_RUNS),
            room: Kept::new(TOUR_KEPT, ROOM_MAX),
            planned: Kept::new(TOUR_KEPT, ROOM_MAX),
            stored_part: Kept::new(STORED_PART_KEPT, 1),
            untouched: Kept::new(WEAR_KEPT, 1),
            wear: Kept::new(WEAR_KEPT, 1),
            workers: Kept::new(WORKERS_KEPT, 1),
            gather: Mutex::default(),
            ended_wear: EndedWear::default(),
            beyond: Beyond::default(),
            stopper: Stopper::default(),
            live_status: Messages::default(),
            samples: Ring::default(),
            counters: Counters::default(),
        }
    }
}
