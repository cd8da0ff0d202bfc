//! Makes one chunk: order and inputs from the store, bytes from the program, result into the store.
//! Uses: `store`, `inputs`, `child`. Never: the queue; bytes whose key, length or hash is not what the program stated.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tokio::fs;

use crate::WorkerError;
use crate::child::{MakeError, Maker};
use crate::inputs::Inputs;
use crate::order::{Done, ORDER_FILE, Order, is_hash};
use crate::queue::ChunkRef;
use crate::store::{Store, check};

/// Most orders whose definition a worker keeps.
const ORDERS_KEPT: usize = 16;

/// What one slot of a worker needs for a chunk.
#[derive(Debug)]
pub struct Bench {
    store: Store,
    inputs: Inputs,
    maker: Maker,
    scratch: PathBuf,
    orders: BTreeMap<String, Order>,
}

/// How a chunk became done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The program made it now.
    Made,
    /// Its result was in the store.
    Existed,
}

impl Bench {
    /// A slot that works in the folder `scratch`, which no other slot uses. All slots share the inputs.
    pub fn new(store: Store, inputs: Inputs, maker: Maker, scratch: PathBuf) -> Self {
        Self { store, inputs, maker, scratch, orders: BTreeMap::new() }
    }

    /// Key of a chunk.
    ///
    /// # Errors
    /// `MakeError` if its order is missing, damaged or shorter.
    pub async fn key(&mut self, chunk: &ChunkRef) -> Result<String, MakeError> {
        let order = self.order(&chunk.order).await?;
        if chunk.index >= order.chunks {
            let error = format!("index = {}: the order has {} chunks", chunk.index, order.chunks);
            return Err(MakeError::Chunk(error));
        }
        Ok(order.key(chunk.index))
    }

    /// Makes a chunk, unless it is done.
    ///
    /// # Errors
    /// `MakeError::Machine` if store, disk or program of this machine failed, `Refused` if it cannot make the order,
    /// `Chunk` if the chunk failed.
    pub async fn make(&mut self, chunk: &ChunkRef) -> Result<Outcome, MakeError> {
        let key = self.key(chunk).await?;
        if self.store.is_done(&chunk.order, &key).await.map_err(machine)? {
            return Ok(Outcome::Existed);
        }
        let folder = self.scratch.join(&chunk.order);
        let order = self.order(&chunk.order).await?.clone();
        self.inputs.link(&self.store, &order.files, &folder).await.map_err(here)?;
        let made = self.maker.make(&folder, chunk.index).await?;
        if made.key != key || made.index != chunk.index {
            return Err(MakeError::Machine(format!(
                "key {} of index {}: must be {key} of {}; worker and palpate are of different versions",
                made.key, made.index, chunk.index
            )));
        }
        let results = folder.join("results");
        let (row, path) =
            (results.join(format!("{key}.json")), results.join(order.bytes_name(&key)));
        // The row has more than the answer: host and commit.
        let done: Done = serde_json::from_slice(&read(&row).await?)
            .map_err(|error| MakeError::Machine(format!("{}: {error}", row.display())))?;
        if (&done.key, &done.sha256, done.bytes) != (&made.key, &made.sha256, made.bytes) {
            return Err(MakeError::Machine(format!("{}: differs from the answer", row.display())));
        }
        let bytes = read(&path).await?;
        check(&bytes, &done)
            .map_err(|what| MakeError::Machine(format!("{}: {what}", path.display())))?;
        self.store.put_result(&order, &done, bytes.into()).await.map_err(machine)?;
        // What remains is removed with the folder of the worker.
        drop(fs::remove_file(&path).await);
        drop(fs::remove_file(&row).await);
        Ok(Outcome::Made)
    }

    /// The definition of an order, which is also written for the program.
    async fn order(&mut self, id: &str) -> Result<&Order, MakeError> {
        if !self.orders.contains_key(id) {
            if !is_hash(id) {
                return Err(MakeError::Chunk(format!("order {id:?}: must be a sha256")));
            }
            // A share that is not mounted, or the store of another machine, is an empty folder.
            let found = self.store.order(id).await.map_err(here)?;
            let (order, text) = found.ok_or_else(|| {
                let what = "not in the store: PALPATE_STORE must be the one of the other machines";
                MakeError::Refused(format!("{id}/{ORDER_FILE}: {what}"))
            })?;
            let folder = self.scratch.join(id);
            let failed = |error: std::io::Error| {
                MakeError::Machine(format!("{}: {error}", folder.display()))
            };
            // Not by another thread, which could make it again after that of the worker was removed.
            std::fs::create_dir_all(&folder).map_err(failed)?;
            fs::write(folder.join(ORDER_FILE), &text).await.map_err(failed)?;
            if self.orders.len() >= ORDERS_KEPT
                && let Some((old, _)) = self.orders.pop_first()
            {
                drop(fs::remove_dir_all(self.scratch.join(old)).await);
                self.inputs.sweep().await;
            }
            self.orders.insert(id.to_owned(), order);
        }
        self.orders.get(id).ok_or_else(|| MakeError::Machine(format!("order {id}: dropped")))
    }

    /// Ends the program.
    pub async fn end(&mut self) {
        self.maker.end().await;
    }

    /// Kills the program, and waits until it has ended.
    pub async fn kill(&mut self) {
        self.maker.kill().await;
    }
}

async fn read(path: &Path) -> Result<Vec<u8>, MakeError> {
    fs::read(path).await.map_err(|error| MakeError::Machine(format!("{}: {error}", path.display())))
}

/// Why an order or its inputs are not here.
fn here(error: WorkerError) -> MakeError {
    match error {
        WorkerError::Store(_) | WorkerError::File { .. } => machine(error),
        other => MakeError::Refused(other.to_string()),
    }
}

fn machine(error: WorkerError) -> MakeError {
    MakeError::Machine(error.to_string())
}
