//! The table of trials: its columns, its filters, and stored trials as rows of it.
//! Uses: `core`. Never: a write; `bench` or `lab`.

mod column;
/// Filters such as `tips__gte=2`.
pub(crate) mod condition;
/// Which trials in which order, as a statement.
pub(crate) mod query;
/// A stored trial and its contacts.
pub(crate) mod trial_row;
/// Checksums of what was measured.
pub(crate) mod checksum;
/// Rows of the database put together to trials.
pub(crate) mod assemble;
/// Single trials, pages of trials, voltages and frames.
mod pages;

pub use column::{Column, Kind, Of, TABLE, names};
