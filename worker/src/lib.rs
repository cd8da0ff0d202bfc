//! Makes chunks of bulk work on any machine: a queue on PostgreSQL, results in an object store.
//! It links no crate of Palpate: `palpate cluster make --lines`, a child process, makes the bytes.
//!
//! ```text
//! submit --> queue (PostgreSQL) --> work --> palpate cluster make --lines
//!    |                                |
//!    +-------> store (folder, S3) <---+        fetch, status <-- store, queue
//! ```
//!
//! A chunk is done if the store has its `KEY.json`. The queue is transport: a chunk that it delivers twice
//! is made twice with the same bytes, and a chunk that it has lost is submitted again.

pub mod address;
pub mod child;
pub mod chunk;
pub mod error;
pub mod fetch;
pub mod inputs;
pub mod needs;
pub mod options;
pub mod order;
pub mod pause;
mod query_error;
pub mod queue;
pub mod scratch;
pub mod setup;
pub mod status;
pub mod store;
pub mod submit;
pub mod work;

pub use error::{WorkerError, WorkerResult};
