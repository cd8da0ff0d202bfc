//! Messages between the service and the query engine, one JSON object per line.
//! Uses: serde. Never: SQL, the meaning of a table.
//!
//! ```text
//! service                                palpate-query
//!   Order: a statement, its bounds   ->    parses it
//!                                    <-  Answer::Tables: which tables it reads
//!   Vec<Table>: their files          ->    evaluates it
//!                                    <-  Answer::Rows, then the rows as an Arrow IPC stream
//! ```
//! In place of either answer the engine may send `Answer::Refused`. It ends when its standard input ends.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Version of these lines; an engine refuses another one.
pub const LINES_VERSION: u32 = 1;

/// Longest statement, bytes.
pub const SQL_MAX_BYTES: usize = 65_536;

/// A statement to evaluate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Order {
    /// [`LINES_VERSION`] of the service.
    pub version: u32,
    /// One SELECT statement.
    pub sql: String,
    /// Largest number of rows of the result.
    pub rows_max: u64,
    /// Largest memory of the engine, bytes.
    pub memory_max_bytes: u64,
}

/// Rows of a table that a statement reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Table {
    /// Name in the statement.
    pub name: String,
    /// What the rows are made of.
    pub form: Form,
    /// Parquet files of the table of trials, or of the rows themselves; a column that a file lacks is
    /// null there.
    pub files: Vec<PathBuf>,
}

/// How the rows of a table follow from the rows of its files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// They are the rows.
    Rows,
    /// A row for each trial: all columns but the frames.
    Trials,
    /// A row for each contact of a trial.
    Contacts,
    /// A row for each trial: its measured and its simulated frame.
    Frames,
    /// A row for each trial with a twin.
    Twins,
    /// A row for each voltage of a frame.
    Voltages,
}

/// A line of the engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Names of the tables that the statement reads.
    Tables(Vec<String>),
    /// Number of rows of the result, which follows.
    Rows(u64),
    /// Why there is no result.
    Refused(String),
}
