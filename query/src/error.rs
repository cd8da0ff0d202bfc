//! Why a statement is not evaluated, in the words that a person reads.
//! PURE. Uses: thiserror. Never: a statement.

use palpate_words::query_lines::SQL_MAX_BYTES;

/// Deepest nesting of expressions; polars recurses on threads with small stacks. A chain
/// `a OR b OR ..` is nested, too.
pub(crate) const DEPTH_MAX: usize = 250;

/// Why a statement is not evaluated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum StatementError {
    /// It is too long.
    #[error("sql: has {0} bytes; must have at most {SQL_MAX_BYTES}")]
    Long(usize),
    /// It is not SQL.
    #[error("sql: {0}")]
    Syntax(String),
    /// There is none, or there are several.
    #[error("sql: has {0} statements; must be one SELECT statement")]
    Count(usize),
    /// It is of another kind.
    #[error("sql: {0} is not possible; must be one SELECT statement (nothing can be written)")]
    Kind(String),
    /// It reads from something that is not a table.
    #[error("sql: {0} cannot be read; FROM takes tables, subqueries and UNNEST")]
    Source(String),
    /// Expressions in expressions.
    #[error("sql: is nested more than {DEPTH_MAX} times: use IN (..) for many values")]
    Deep,
    /// Polars would confuse two tables.
    #[error(
        "sql: {0} names two tables here: choose another name for the one that the statement defines"
    )]
    Names(String),
    /// An aggregate decides on single rows.
    #[error("sql: {0} in WHERE: a condition on an aggregate follows GROUP BY, in HAVING")]
    Where(String),
    /// HAVING has no groups.
    #[error("sql: HAVING needs GROUP BY")]
    Having,
    /// A value for each row next to one for all.
    #[error(
        "sql: {column} is next to {aggregate}, which is one value: add GROUP BY, with each column"
    )]
    Group { column: String, aggregate: String },
    /// A comparison with a subquery that may have any number of rows.
    #[error(
        "sql: a comparison takes a subquery of one aggregate, such as \
         (SELECT max(fvu) FROM trials); for several rows use IN, or JOIN"
    )]
    Subquery,
}
