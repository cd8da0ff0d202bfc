//! Fetches the results of an order into a folder, each checked by length and hash.
//! Uses: `store`. Never: the queue; bytes in the folder that are not those that were made.

use std::path::Path;

use futures::{StreamExt, TryStreamExt, stream};
use serde::Serialize;

use crate::order::Order;
use crate::store::{Part, Store};
use crate::{WorkerError, WorkerResult};

/// Results that are fetched at once.
const AT_ONCE: usize = 4;

/// What was fetched.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Fetched {
    /// Chunks of the order.
    pub chunks: u64,
    /// Results that were fetched.
    pub fetched: u64,
    /// Results that the folder had.
    pub present: u64,
    /// Chunks that are not done.
    pub missing: u64,
    /// Bytes that were fetched.
    pub bytes: u64,
    /// Results that are damaged, with what differs.
    pub damaged: Vec<String>,
}

/// What becomes of a damaged result of the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damaged {
    /// It remains in the store.
    Kept,
    /// It is removed, so that `submit` has it made again.
    Discarded,
}

/// What became of one chunk.
enum ChunkResult {
    Fetched(u64),
    Present,
    Missing,
    Damaged(String),
}

/// Fetches what is done, and why chunks are set aside. What the folder has is checked and kept.
///
/// # Errors
/// `WorkerError` if the folder has another order, if it cannot be written, or if the store does not answer.
pub async fn fetch(
    store: &Store,
    id: &str,
    folder: &Path,
    damaged: Damaged,
) -> WorkerResult<Fetched> {
    let missing = || WorkerError::Invalid(format!("order {id}: not in the store"));
    let (order, text) = store.order(id).await?.ok_or_else(missing)?;
    std::fs::create_dir_all(folder).map_err(WorkerError::file(folder))?;
    let here = Store::order_folder(folder)?;
    match here.order(id).await? {
        Some((other, _)) if !other.is_same(&order) => {
            let folder = folder.display();
            return Err(WorkerError::Invalid(format!(
                "{folder}: has the order {}: name another folder",
                other.id
            )));
        }
        Some(_) => (),
        None => here.put_order(id, text).await?,
    }
    let chunks =
        stream::iter(0..order.chunks).map(|index| one(store, &here, &order, index, damaged));
    let results: Vec<ChunkResult> = chunks.buffer_unordered(AT_ONCE).try_collect().await?;
    let mut fetched = Fetched { chunks: order.chunks, ..Fetched::default() };
    for result in results {
        match result {
            ChunkResult::Fetched(bytes) => {
                fetched.fetched += 1;
                fetched.bytes += bytes;
            }
            ChunkResult::Present => fetched.present += 1,
            ChunkResult::Missing => fetched.missing += 1,
            ChunkResult::Damaged(what) => fetched.damaged.push(what),
        }
    }
    fetched.damaged.sort();
    Ok(fetched)
}

async fn one(
    store: &Store,
    here: &Store,
    order: &Order,
    index: u64,
    damaged: Damaged,
) -> WorkerResult<ChunkResult> {
    let key = order.key(index);
    // A result that this folder has, but that is damaged, is fetched again.
    if let Ok(Some(done)) = here.done(&order.id, &key).await
        && let Ok(Some(_)) = here.bytes(order, &done).await
    {
        return Ok(ChunkResult::Present);
    }
    let found = async {
        let Some(done) = store.done(&order.id, &key).await? else { return Ok(None) };
        if done.key != key || done.index != index {
            return Err(WorkerError::Failed(format!(
                "{}/results/{key}.json: of another chunk",
                order.id
            )));
        }
        let bytes = store.bytes(order, &done).await?;
        let gone = || {
            let name = order.bytes_name(&key);
            WorkerError::Failed(format!("{}/results/{name}: missing", order.id))
        };
        Ok(Some((done, bytes.ok_or_else(gone)?)))
    };
    match found.await {
        Ok(Some((done, bytes))) => {
            here.put_result(order, &done, bytes).await?;
            Ok(ChunkResult::Fetched(done.bytes))
        }
        Ok(None) => {
            if let Some(failed) = store.failed(&order.id, &key).await? {
                here.put_failed(&order.id, &failed).await?;
            }
            Ok(ChunkResult::Missing)
        }
        Err(WorkerError::Failed(what)) => {
            if damaged == Damaged::Discarded {
                store.remove(&order.id, Part::Results, &key).await?;
            }
            Ok(ChunkResult::Damaged(what))
        }
        Err(error) => Err(error),
    }
}
