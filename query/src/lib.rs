//! The query engine: SQL over Parquet files, in a process that the service starts for each query.
//! Uses: polars (its only user), sqlparser, `words`. Never: the store, HTTP, a file that the
//! service did not name.
//!
//! A process, because a statement may need any amount of time and memory: it is killed alone.
//!
//! ```text
//! error          why a statement is refused
//! statement      one SELECT over named tables, or a refusal
//! aggregates     which of its parts are one value for many rows
//! rewrite        its form for polars
//! tables         how the rows of a table follow from its files
//! evaluate       the rows of the result
//! confine        low priority, bounded memory, no other files
//! polars_errors  errors of polars for a person
//! talk           the lines to and from the service
//! ```

pub mod aggregates;
pub mod confine;
pub mod error;
pub mod evaluate;
pub mod polars_errors;
pub mod rewrite;
pub mod statement;
pub mod tables;
pub mod talk;
