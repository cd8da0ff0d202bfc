//! A worker: takes chunks, makes them and acknowledges them until it is requested to end.
//! Uses: `queue`, `chunk`, `pause`, `scratch`, tokio's signals. Never: a chunk acknowledged before its result is in the
//! store; another chunk after SIGTERM or after its terminal was closed; a program that runs after the worker's folder
//! was removed.
//!
//! - One lease per worker, renewed by its heartbeats also while chunks are made. Each worker looks for leases
//!   that have ended, and returns the chunks of those workers to the queue.
//! - An attempt counts when a chunk is taken, so that a chunk that kills its workers is set aside as well. If the
//!   machine fails, it does not count: the machine leaves the order for a while. An order that machines refuse
//!   again and again is set aside as a whole.
//! - A lost connection is replaced. A chunk that was being made is then acknowledged by this worker, or found
//!   done by the next one.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use graphile_worker::{HookRegistry, Job, JobRecovery, JobRecoveryContext, JobRecoveryResult};
use parking_lot::Mutex;
use serde_json::{Value, json};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::child::{MakeError, Maker, clipped};
use crate::chunk::{Bench, Outcome};
use crate::inputs::Inputs;
use crate::needs::Needs;
use crate::order::Failed;
use crate::pause::{LeftOrders, Pause};
use crate::queue::{ANSWER, ChunkRef, Queue};
use crate::scratch::Scratch;
use crate::store::Store;
use crate::{WorkerError, WorkerResult};

/// Connections of a worker without those of its slots: heartbeat, sweep, listener.
pub const CONNECTIONS: u32 = 3;
/// Interval at which an idle worker asks for a chunk; the queue also notifies it of new ones.
const IDLE: Duration = Duration::from_secs(5);
/// The same for a worker that ends with the last chunk.
const IDLE_AT_END: Duration = Duration::from_secs(1);
/// Refusals of one chunk, the first of its order for every machine, after which the order is set aside. With pauses
/// of a minute one machine takes three and a half days for them, ten machines take a night.
const REFUSALS_MAX: u32 = 5000;
/// Longest time for which a result is acknowledged: later the chunk is found done.
const ACKNOWLEDGE: Duration = Duration::from_secs(300);

/// What a worker is and does.
#[derive(Debug, Clone)]
pub struct Work {
    /// Chunks that are made at once.
    pub at_once: usize,
    /// Threads of a program.
    pub threads: usize,
    /// What the machine has.
    pub has: Needs,
    /// Time without a heartbeat after which the chunks of a worker are returned.
    pub lease: Duration,
    /// Longest time for one chunk.
    pub limit: Duration,
    /// The program that makes chunks.
    pub program: PathBuf,
    /// Folder in which chunks are made.
    pub scratch: PathBuf,
    /// Whether the worker ends when no chunk is left that it may make.
    pub until_idle: bool,
}

/// Everything that the slots of a worker share.
struct Shared {
    queue: Queue,
    store: Store,
    work: Work,
    id: String,
    allowed: Vec<String>,
    ending: watch::Receiver<bool>,
    /// Whether the present chunks are abandoned.
    ending_now: watch::Receiver<bool>,
    /// Numbers of the chunks that the slots have.
    held: Mutex<BTreeSet<i64>>,
    left: Mutex<LeftOrders>,
    added: Notify,
    made: AtomicU64,
    existed: AtomicU64,
    failed: AtomicU64,
}

/// Works until SIGTERM, SIGINT or SIGHUP; a second SIGTERM or SIGINT ends it within the present chunk.
///
/// # Errors
/// `WorkerError` if the queue is not set up, refuses the role, or if the folder cannot be made.
pub async fn work(queue: Queue, store: Store, work: Work) -> WorkerResult<()> {
    let scratch = Scratch::create(&work.scratch)?;
    let host = host();
    let id = format!("{host}/{}/{}", std::process::id(), scratch.name());
    let (tell, ending) = watch::channel(false);
    let (tell_now, ending_now) = watch::channel(false);
    let mut signals = Signals::new().map_err(WorkerError::file("signals"))?;
    tracing::info!(
        worker = id,
        at_once = work.at_once,
        gpu = work.has.gpu,
        memory_mib = work.has.memory_mib,
        "starts"
    );
    let shared = Arc::new(Shared {
        allowed: work.has.allowed(),
        queue,
        store,
        work,
        id,
        ending,
        ending_now,
        held: Mutex::default(),
        left: Mutex::default(),
        added: Notify::new(),
        made: AtomicU64::new(0),
        existed: AtomicU64::new(0),
        failed: AtomicU64::new(0),
    });
    let mut slots = JoinSet::new();
    let inputs = Inputs::new(scratch.inputs());
    for slot in 0..shared.work.at_once {
        let maker = Maker::new(shared.work.program.clone(), shared.work.threads, shared.work.limit);
        let bench = Bench::new(shared.store.clone(), inputs.clone(), maker, scratch.slot(slot));
        slots.spawn(run_slot(shared.clone(), bench));
    }
    let mut helpers = JoinSet::new();
    let about = json!({ "host": host, "pid": std::process::id(), "at_once": shared.work.at_once,
        "gpu": shared.work.has.gpu, "memory_mib": shared.work.has.memory_mib });
    helpers.spawn(beat(shared.clone(), about));
    helpers.spawn(sweep(shared.clone()));
    helpers.spawn(listen(shared.clone()));
    let mut ended = Ok(());
    loop {
        tokio::select! {
            slot = slots.join_next() => match slot {
                Some(Ok(Ok(()))) => (),
                Some(Ok(Err(error))) => {
                    ended = Err(error);
                    tell.send_replace(true);
                }
                Some(Err(error)) => {
                    ended = Err(WorkerError::Failed(format!("a slot of the worker ended: {error}")));
                    tell.send_replace(true);
                }
                None => break,
            },
            kind = signals.next() => {
                // The shell and the kernel may both report that the terminal was closed.
                if tell.send_replace(true) && kind != SignalKind::hangup() {
                    tracing::warn!("ends now; its chunks are returned when its lease ends");
                    tell_now.send_replace(true);
                    while slots.join_next().await.is_some() {}
                    return Err(WorkerError::Failed("ended by a second signal".into()));
                }
                tracing::info!("ends after its present chunks");
            }
        }
    }
    helpers.shutdown().await;
    if let Err(error) = shared.queue.leave(&shared.id).await {
        tracing::warn!(%error, "the lease ends by itself");
    }
    let count = |number: &AtomicU64| number.load(Ordering::Relaxed);
    tracing::info!(
        made = count(&shared.made),
        existed = count(&shared.existed),
        failed = count(&shared.failed),
        "has ended"
    );
    ended
}

/// Makes chunks until the worker ends. Afterwards the program of the slot has ended, and writes no file.
async fn run_slot(shared: Arc<Shared>, mut bench: Bench) -> WorkerResult<()> {
    let mut now = shared.ending_now.clone();
    let ended = tokio::select! {
        ended = make_chunks(&shared, &mut bench) => ended,
        () = async { drop(now.wait_for(|now| *now).await) } => Ok(()),
    };
    bench.kill().await;
    ended
}

/// Takes and makes chunks until the worker ends.
async fn make_chunks(shared: &Shared, bench: &mut Bench) -> WorkerResult<()> {
    let mut ending = shared.ending.clone();
    let mut pause = Pause::default();
    let mut connected = false;
    while !*ending.borrow() {
        let left = shared.left.lock().now(Instant::now());
        let taken = async {
            let orders = shared.queue.orders(&left).await?;
            let job = shared.queue.take(&orders, &shared.id, &shared.allowed).await?;
            let is_over = job.is_none()
                && shared.work.until_idle
                && !shared.queue.has_work(&shared.allowed).await?;
            Ok((job, is_over))
        };
        let (job, is_over) = match taken.await {
            Ok(taken) => {
                if pause.ends() {
                    tracing::info!("the queue answers again");
                }
                connected = true;
                taken
            }
            // A mistake of the setup is not waited for, a queue that restarts is.
            Err(error @ WorkerError::NotSetUp(_)) if !connected => return Err(error),
            Err(error) => {
                pause.warn(&error, "the queue does not answer");
                rest(pause.next_pause(), &mut ending).await;
                continue;
            }
        };
        let Some(job) = job else {
            if is_over {
                break;
            }
            let idle = if shared.work.until_idle { IDLE_AT_END } else { IDLE };
            let back = shared.left.lock().first_end(Instant::now());
            let idle = back.map_or(idle, |back| back.min(idle));
            tokio::select! {
                () = rest(idle, &mut ending) => (),
                () = shared.added.notified() => (),
            }
            continue;
        };
        shared.held.lock().insert(*job.id());
        settle(shared, bench, &job).await;
        shared.held.lock().remove(job.id());
    }
    bench.end().await;
    Ok(())
}

/// Makes a chunk that was taken, and reports it to the queue.
async fn settle(shared: &Shared, bench: &mut Bench, job: &Job) {
    let chunk: Result<ChunkRef, _> = serde_json::from_value(job.payload().clone());
    let made = match &chunk {
        Ok(chunk) => bench.make(chunk).await,
        Err(error) => Err(MakeError::Chunk(format!("payload: {error}"))),
    };
    let error = match made {
        Ok(outcome) => {
            let is_made = outcome == Outcome::Made;
            let number = if is_made { &shared.made } else { &shared.existed };
            number.fetch_add(1, Ordering::Relaxed);
            if is_made && let Ok(chunk) = &chunk {
                shared.left.lock().returns(&chunk.order);
            }
            acknowledge(|| shared.queue.complete(job, &shared.id)).await;
            return;
        }
        Err(error) => error,
    };
    shared.failed.fetch_add(1, Ordering::Relaxed);
    let text = format!("{}: {}", host(), clipped(&error.to_string()));
    tracing::warn!(chunk = job.key().as_deref().unwrap_or(""), attempt = job.attempts(), "{text}");
    match (error, chunk) {
        (MakeError::Machine(_), Ok(chunk)) => give_back(shared, bench, job, chunk, &text).await,
        (MakeError::Refused(_), Ok(mut chunk)) => {
            chunk.refused = chunk.refused.saturating_add(1);
            give_back(shared, bench, job, chunk, &text).await;
        }
        (_, chunk) => {
            if job.attempts() >= job.max_attempts()
                && let Ok(chunk) = &chunk
                && let Ok(key) = bench.key(chunk).await
            {
                set_aside(&shared.store, chunk, key, *job.attempts(), text.clone()).await;
            }
            acknowledge(|| shared.queue.fail(job, &shared.id, &text)).await;
        }
    }
}

/// Returns a chunk that this machine could not make, and leaves its order for a while. After too many refusals the
/// order is set aside: no machine has made its first chunk.
async fn give_back(shared: &Shared, bench: &mut Bench, job: &Job, chunk: ChunkRef, text: &str) {
    shared.left.lock().leave(&chunk.order, Instant::now());
    acknowledge(|| shared.queue.give_back(job, &shared.id, &chunk, text)).await;
    if chunk.refused < REFUSALS_MAX {
        return;
    }
    let text = format!("refused {} times by machines, last by {text}", chunk.refused);
    tracing::warn!(order = chunk.order, "the order is set aside: {text}");
    if let Ok(key) = bench.key(&chunk).await {
        set_aside(&shared.store, &chunk, key, *job.attempts(), text.clone()).await;
    }
    acknowledge(|| shared.queue.set_aside(&chunk.order, &text)).await;
}

/// Writes why a chunk is set aside. Without it, the queue alone has the error.
async fn set_aside(store: &Store, chunk: &ChunkRef, key: String, attempts: i16, error: String) {
    let attempts = u32::try_from(attempts).unwrap_or(0);
    let failed = Failed { key, index: chunk.index, attempts, error };
    if let Err(error) = store.put_failed(&chunk.order, &failed).await {
        tracing::warn!(%error, "the error of a chunk is not in the store");
    }
}

/// Repeats a request until the queue has answered.
async fn acknowledge<F, Answer>(request: F)
where
    F: Fn() -> Answer,
    Answer: Future<Output = WorkerResult<()>>,
{
    let mut pause = Pause::default();
    let repeated = async {
        while let Err(error) = request().await {
            pause.warn(&error, "a chunk is not acknowledged yet");
            sleep(pause.next_pause()).await;
        }
    };
    if timeout(ACKNOWLEDGE, repeated).await.is_err() {
        tracing::warn!("a chunk was not acknowledged; the next worker finds its result");
    }
}

/// Renews the lease, and returns chunks that the queue believes to be here: as long as the worker runs, nobody
/// else would.
async fn beat(shared: Arc<Shared>, about: Value) {
    loop {
        let renewed = async {
            shared.queue.heartbeat(&shared.id, &about).await?;
            let held: Vec<i64> = shared.held.lock().iter().copied().collect();
            shared.queue.return_unknown(&shared.id, &held, ANSWER * 2).await
        };
        match renewed.await {
            Ok(0) => (),
            Ok(chunks) => tracing::info!(chunks, "returned chunks whose delivery was lost"),
            Err(error) => tracing::debug!(%error, "a heartbeat was lost"),
        }
        sleep(shared.work.lease / 4).await;
    }
}

/// Returns the chunks of workers whose lease has ended.
async fn sweep(shared: Arc<Shared>) {
    let mut hooks = HookRegistry::new();
    let store = shared.store.clone();
    hooks.on(JobRecovery, move |lost| recover(store.clone(), lost));
    let hooks = Arc::new(hooks);
    loop {
        sleep(shared.work.lease / 2).await;
        match shared.queue.sweep(shared.work.lease, hooks.clone()).await {
            Ok(0) => (),
            Ok(chunks) => tracing::info!(chunks, "returned the chunks of ended workers"),
            Err(error) => tracing::debug!(%error, "a sweep failed"),
        }
    }
}

/// Returns a chunk whose worker has ended. Its attempt counts: the chunk may be the cause.
async fn recover(store: Store, lost: JobRecoveryContext) -> JobRecoveryResult {
    let job = &lost.job;
    if job.attempts() >= job.max_attempts()
        && let Ok(chunk) = serde_json::from_value::<ChunkRef>(job.payload().clone())
        && let Ok(Some((order, _))) = store.order(&chunk.order).await
    {
        let error =
            format!("{}: the worker ended while it made this chunk", lost.previous_worker_id);
        set_aside(&store, &chunk, order.key(chunk.index), *job.attempts(), error).await;
    }
    JobRecoveryResult::Reschedule { run_at: *job.run_at(), attempts: Some(*job.attempts()) }
}

/// Passes on that chunks were added.
async fn listen(shared: Arc<Shared>) {
    loop {
        // Without notifications an idle worker asks at intervals.
        drop(shared.queue.listen(|| shared.added.notify_waiters()).await);
        sleep(IDLE).await;
    }
}

/// Waits, at most until the worker ends.
async fn rest(time: Duration, ending: &mut watch::Receiver<bool>) {
    drop(timeout(time, ending.wait_for(|ending| *ending)).await);
}

/// SIGTERM, SIGINT, and SIGHUP unless the worker was started to ignore it, as by `nohup`.
struct Signals {
    terminate: Signal,
    interrupt: Signal,
    hang_up: Option<Signal>,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        let own = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let hang_up = match ignores_hang_up(&own) {
            true => None,
            false => Some(signal(SignalKind::hangup())?),
        };
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hang_up,
        })
    }

    /// Waits for the next signal.
    async fn next(&mut self) -> SignalKind {
        let Self { terminate, interrupt, hang_up } = self;
        let hung_up = async {
            match hang_up {
                Some(signal) => {
                    signal.recv().await;
                }
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = terminate.recv() => SignalKind::terminate(),
            _ = interrupt.recv() => SignalKind::interrupt(),
            () = hung_up => SignalKind::hangup(),
        }
    }
}

/// Whether a process ignores SIGHUP; `status`: its `/proc/PID/status`.
fn ignores_hang_up(status: &str) -> bool {
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    // SIGHUP is signal 1, the lowest bit.
    mask.is_some_and(|mask| mask & 1 == 1)
}

/// Name of this machine.
fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    if name.is_empty() { "worker".to_owned() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_under_nohup_ignores_that_its_terminal_is_closed() {
        let status = |mask: &str| format!("SigBlk:\t0000000000000001\nSigIgn:\t{mask}\n");
        assert!(ignores_hang_up(&status("0000000000001001")));
        assert!(!ignores_hang_up(&status("0000000000001000")));
        assert!(!ignores_hang_up(""));
    }
}
