//! The table of trials: its columns, its filters, and its rows as read from the database.
//! Uses: `core`. Never: `bench` or `lab`; a write.

/// The columns, one line each.
mod column;
/// Filters such as `tips__gte=2`.
pub(crate) mod condition;
/// A selection of trials, as an SQL statement.
pub(crate) mod query;
/// A stored trial and its contacts.
pub(crate) mod trial_row;
/// Checksums of measured values.
pub(crate) mod checksum;
/// Rows of the database, joined to trials.
pub(crate) mod assemble;
/// Single trials, pages of trials, voltages and frames.
pub(crate) mod pages;

pub use column::{Column, Kind, Of, RUN_COLUMNS, TABLE, names, names_of};
