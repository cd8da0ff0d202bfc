//! Questions in SQL: a SELECT statement over the stored trials and the datasets.
//! Uses: `dataset::{catalog, format}`, `store`, `words::{program, query_lines}`. Never: a write to the store, SQL
//! that no client sent, an answer that the campaign waits for.
//!
//! ```text
//! statement -> engine (a process): which tables?   -> tables: their Parquet files
//!                                                      ended run:  its dataset, if it is current; without
//!                                                                  its frames, unless they are asked for
//!                                                      other runs: pieces of up to 1000 trials, kept
//!              engine: evaluates                   <-
//!           -> rows: batches, as they arrive
//! ```

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::time::timeout;

mod engine;
mod error;
pub mod groups;
mod narrow;
mod pieces;
mod records;
mod rows;
mod tables;

pub use engine::{MEMORY_MAX_BYTES, QUERY};
pub use error::QueryError;
pub use rows::ResultRows;
pub use tables::{TABLES, TableAbout};

use crate::dataset::catalog::Catalog;
use crate::store::Store;
use engine::{ENGINE_THREADS, Engine, Starter};
use tables::Tables;

/// Longest time of a query, without that of sending its result.
pub const TIME_MAX: Duration = Duration::from_secs(60);
/// Longest time in which a client takes the rows of a result, from their first one; then the query ends without the
/// rest.
pub const TAKEN_WITHIN: Duration = Duration::from_secs(300);
/// Longest wait for the turn of a query.
const QUERY_WAIT: Duration = Duration::from_secs(10);
/// Queries in progress; further ones wait. While a run is driven it is one, with one thread.
pub const QUERIES: usize = 2;
/// Largest number of rows of a result.
pub const ROWS_MAX: u64 = 1_000_000;

/// The queries of a service. Clones share them.
#[derive(Clone)]
pub struct Queries {
    inner: Arc<Inner>,
}

struct Inner {
    tables: Tables,
    starter: Starter,
    turns: Arc<Semaphore>,
}

impl Queries {
    /// Queries over the store and the datasets of a data folder.
    pub fn new(store: Store, datasets: Catalog, data: &Path) -> Self {
        let turns = Arc::new(Semaphore::new(QUERIES));
        let tables = Tables::new(store, datasets, data);
        Self { inner: Arc::new(Inner { tables, starter: Starter::default(), turns }) }
    }

    /// Evaluates a SELECT statement. If the result or this future is dropped, the evaluation ends.
    ///
    /// # Errors
    /// `QueryError::Refused` if the statement is invalid, or needs more time, memory or rows than a
    /// query may use; `Building` while the engine is built, `Busy` if no turn comes; another variant
    /// if files, the store or the engine fail.
    pub async fn answer(&self, sql: &str) -> Result<ResultRows, QueryError> {
        let program = self.inner.starter.program()?;
        // A thread of low priority keeps its processor for some ms: during a run one stays free.
        let is_alone = self.inner.tables.has_driven_run().await?;
        let (places, threads) = if is_alone { (QUERIES, 1) } else { (1, ENGINE_THREADS) };
        let turns = self.inner.turns.clone().acquire_many_owned(places as u32);
        let turn = timeout(QUERY_WAIT, turns).await;
        let turn = turn.map_err(|_| QueryError::Busy)?.map_err(|_| QueryError::Busy)?;
        let work = async {
            let (engine, names) = Engine::start(&program, sql, ROWS_MAX, threads).await?;
            let (tables, records) = self.inner.tables.of_names(&names).await?;
            let answer = engine.evaluate(&tables).await;
            drop(records);
            answer
        };
        let (engine, count) = timeout(TIME_MAX, work).await.map_err(|_| {
            QueryError::Refused(format!(
                "takes more than {} s: select fewer rows, runs or columns",
                TIME_MAX.as_secs()
            ))
        })??;
        ResultRows::read(engine, count, turn).await
    }
}
