//! The base of the store: the database file, its one writing connection, and what all other files use.
//! Uses: `words`, sqlx. Never: `table`, `bench` or `lab`; the tables of trials.

pub(crate) mod error;
pub(crate) mod columns;
pub(crate) mod bulk;
pub(crate) mod writer;
mod log;
mod migrations;
pub(crate) mod store;
pub(crate) mod statements;
pub(crate) mod facts;
mod known_facts;
pub(crate) mod once;
pub(crate) mod keys;

pub(crate) use error::{During, StoreError, StoreResult};
pub(crate) use store::Store;
