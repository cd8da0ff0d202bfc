//! The table of trials: its columns, its filters, and its rows as read from the database.
//! Uses: `core`. Never: `bench` or `lab`; a write.

mod column;
pub(crate) mod condition;
pub(crate) mod query;
pub(crate) mod trial_row;
pub(crate) mod checksum;
pub(crate) mod assemble;
pub(crate) mod pages;

pub use column::{Column, Kind, Of, RUN_COLUMNS, TABLE, names, names_of};
