//! The base of the store: the database file, its one writing connection, and what all other files use.
//! Uses: `words`, sqlx. Never: `table`, `bench` or `lab`; the tables of trials.

/// The errors of the store.
pub(crate) mod error;
/// Encoding and decoding of values in columns.
pub(crate) mod columns;
/// The connections that read many rows.
pub(crate) mod bulk;
/// The thread with the one connection that writes.
pub(crate) mod writer;
/// Damage in SQLite's write-ahead log that SQLite does not report.
mod log;
/// The migrations, embedded.
mod migrations;
/// Opening, sharing and closing the database.
pub(crate) mod store;
/// One statement alone: its rows, or the number of rows that it changes.
pub(crate) mod statements;
/// Facts of a run that never change.
pub(crate) mod facts;
/// Those of runs that were read or written, cached in memory.
mod known_facts;
/// API keys, stored as hashes.
pub(crate) mod keys;
/// Requests that are carried out once.
pub(crate) mod once;

pub(crate) use error::{During, StoreError, StoreResult};
pub(crate) use store::Store;
