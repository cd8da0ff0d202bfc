//! Durable records in one SQLite file: runs, trials, events, and who did what.
//! Uses: `words` (its records and its `Journal`, which the store implements), sqlx, rusqlite.
//! Never: HTTP, the rig, a write from a connection other than the writer's.
//!
//! ```text
//! campaign, api --jobs--> writer thread, one connection, WAL, synchronous=FULL --> palpate.db
//!                                                     read-only connections <-----/
//! ```
//! Four folders, each of which imports only the ones before it: `core` (the file and its writer),
//! `table` (the table of trials), `bench` (records of the bench), `lab` (what is computed from trials,
//! tasks, and imports). `tests/architecture` checks this order. Each folder adds methods to [`Store`].
//!
//! A trial is one transaction. Its key is unique in the file, so that no trial is lost or stored twice.
//! Reads never wait for the writer, and the writer never waits for reads. Measured values carry
//! checksums, which every read compares.
//!
//! Methods of `Journal` wait for the disk without limit, since the campaign has its own deadlines; all
//! others return [`StoreError::Late`] after 30 s.

use palpate_words::{clock, digest, ids, journal, near, plain, priority, record, state};

mod core;
pub mod table;
mod bench;
mod lab;

#[cfg(test)]
mod tests;

pub use crate::core::error::{StoreError, StoreResult};
pub use crate::core::facts::{Label, RunKind};
pub use crate::core::keys::{KEYLESS, KEYLESS_SUFFIX, Key, KeyRing, KeyRow, Role};
pub use crate::core::once::{OnceKey, OnceResponse, OnceRow};
pub use crate::core::store::{Sharing, Soundness, Store};
pub use bench::actions::{ActionRow, NewAction};
pub use bench::attempts::SkipRow;
pub use bench::counts::SettingCount;
pub use bench::lock::LockRow;
pub use bench::placed::LastPlaced;
pub use bench::run_row::{NewRun, RunPage, RunRow};
pub use bench::untouched::BeforeTrial;
pub use bench::wear::{PressedPoint, StoredWear};
pub use lab::datasets::{DatasetRow, RunExtent};
pub use lab::forces::DepthForce;
pub use lab::imports::{
    IMPORTED_CONTACTS_MAX, IMPORTED_FRAMES_MAX, IMPORTED_MODEL, ImportedTrial, TAG_MAX_CHARS,
};
pub use lab::models::{ModelRow, NewPromotion, PromotionRow};
pub use lab::progress::{Bins, PartTrials, StoredParts};
pub use lab::task_queue::TaskQueue;
pub use lab::tasks::{TaskEnd, TaskKind, TaskRow, TaskState};
pub use lab::twins::{Fit, NewTwinModel, Twin, TwinCount, TwinModelId, TwinOutcome};
pub use table::condition::{Comparison, Condition, Operand, Part};
pub use table::query::{MAX_PAGE, Order, TrialQuery};
pub use table::trial_row::{Contact, TipsAsContacts, TrialRow};
