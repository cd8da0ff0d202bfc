//! Submits an order: its definition and its files to the store, and its missing chunks to the queue.
//! Uses: `queue`, `store`. Never: a chunk that is done, or that the queue has.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;

use crate::needs::Needs;
use crate::order::ORDER_FILE;
use crate::queue::{ChunkRef, Queue};
use crate::store::{INPUTS, Part, Store};
use crate::{WorkerError, WorkerResult};

/// What a submission added to the queue, and what was there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Submitted {
    /// Id of the order.
    pub order: String,
    /// Chunks of the order.
    pub chunks: u64,
    /// Chunks that were done.
    pub done: u64,
    /// Chunks that the queue had.
    pub present: u64,
    /// Chunks that were added.
    pub added: u64,
    /// Chunks among these that had been set aside.
    pub again: u64,
}

/// Submits the order of a folder. A second call adds what is missing, and chunks that were set aside.
///
/// # Errors
/// `WorkerError` if the folder has no valid order or lacks a file of it, if the store has another order under its id, or
/// if store or queue do not answer.
pub async fn submit(
    queue: &Queue,
    store: &Store,
    folder: &Path,
    priority: i16,
    attempts: i16,
    needs: Needs,
) -> WorkerResult<Submitted> {
    let missing = || {
        WorkerError::Invalid(format!(
            "{}: no {ORDER_FILE}: write it with `palpate cluster sbatch`",
            folder.display()
        ))
    };
    let (order, text) = Store::order_folder(folder)?.order("").await?.ok_or_else(missing)?;
    match store.order(&order.id).await? {
        Some((stored, _)) if !stored.is_same(&order) => {
            let (of_store, of_folder) = (stored.chunks, order.chunks);
            let what = format!("the store has {of_store} chunks, the folder {of_folder}");
            return Err(WorkerError::Failed(format!("{}/{ORDER_FILE}: {what}", order.id)));
        }
        Some(_) => (),
        None => store.put_order(&order.id, text).await?,
    }
    for sha256 in &order.files {
        store.put_input(sha256, &folder.join(INPUTS).join(sha256)).await?;
    }
    let done = store.keys(&order.id, Part::Results).await?;
    let failed = store.keys(&order.id, Part::Failed).await?;
    // Set aside chunks leave the queue first: the same name is then free.
    queue.forget_failed(&order.id).await?;
    let present: BTreeSet<u64> = queue.present(&order.id).await?.into_iter().collect();
    let mut submitted = Submitted {
        order: order.id.clone(),
        chunks: order.chunks,
        done: 0,
        present: 0,
        added: 0,
        again: 0,
    };
    let mut chunks = Vec::new();
    for index in 0..order.chunks {
        let key = order.key(index);
        if done.contains_key(&key) {
            submitted.done += 1;
        } else if present.contains(&index) {
            submitted.present += 1;
        } else {
            if failed.contains_key(&key) {
                store.remove(&order.id, Part::Failed, &key).await?;
                submitted.again += 1;
            }
            chunks.push(ChunkRef { order: order.id.clone(), index, refused: 0 });
        }
    }
    let needs = Needs { gpu: needs.gpu || order.needs_gpu(), ..needs };
    queue.add(&chunks, priority, attempts, needs).await?;
    submitted.added = chunks.len() as u64;
    if let Err(error) = queue.forget_orders().await {
        tracing::debug!(%error, "the next submission forgets orders that have ended");
    }
    Ok(submitted)
}
