//! The base of the store: the file, its one writing connection, and what every other file needs.
//! Uses: `words`, sqlx. Never: another shelf; a table of runs or trials, except for the facts of a run.

/// The store's errors; the operation that failed.
pub(crate) mod error;
/// How values are stored in columns, and how they are read back.
pub(crate) mod columns;
/// The thread with the one connection that writes.
pub(crate) mod writer;
/// Damage in SQLite's write-ahead log that SQLite does not report.
mod log;
/// The database of a rig, opened and shared.
pub(crate) mod store;
/// What never changes in a run, kept in memory.
pub(crate) mod facts;
/// The operator lock, and the settings.
pub(crate) mod lock;
/// API keys.
pub(crate) mod keys;

pub(crate) use error::{During, StoreError};
pub(crate) use store::Store;
