//! The queue of tasks: order, continuation after a restart, ends that are stored late, stops.
//! Uses: `store`. Never: a file outside its own temporary folder.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::json;
use tokio::task::JoinHandle;

use super::{execute, fresh, open};
use crate::ids::TaskId;
use crate::{Store, TaskEnd, TaskKind, TaskQueue, TaskRow, TaskState};

/// Longest wait of a test for a state, which a slow machine may need.
const PATIENCE: Duration = Duration::from_secs(20);

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
}

impl Shared {
    fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    async fn until_stopped(&self) -> TaskEnd {
        while !self.stop.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        TaskEnd::Stopped
    }
}

type Queue = Arc<TaskQueue<Shared>>;
/// Ids of the tasks in the order in which they ran.
type Ran = Arc<Mutex<Vec<TaskId>>>;

fn queue(store: &Store, kinds: &'static [TaskKind]) -> Queue {
    Arc::new(TaskQueue::new(store.clone(), kinds))
}

async fn added(queue: &Queue, kind: TaskKind) -> TaskId {
    queue.add(kind, json!({}), "ada").await.unwrap().id
}

/// Starts a worker whose tasks end with `Done`, or if `endless` when they are stopped.
fn worker(queue: &Queue, endless: bool) -> (JoinHandle<()>, Ran) {
    let (queue, ran) = (queue.clone(), Ran::default());
    let seen = ran.clone();
    let working = async move {
        let run = |task: TaskRow, shared: Arc<Shared>| {
            seen.lock().push(task.id);
            async move {
                if endless {
                    shared.until_stopped().await
                } else {
                    TaskEnd::Done(json!({ "task": task.id }))
                }
            }
        };
        queue.work(run, |_, _| ()).await;
    };
    (tokio::spawn(working), ran)
}

async fn in_state(store: &Store, id: TaskId, state: TaskState) -> TaskRow {
    let waiting = async {
        loop {
            let row = store.task(id).await.unwrap().unwrap();
            if row.state == state {
                return row;
            }
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    };
    tokio::time::timeout(PATIENCE, waiting).await.unwrap()
}

#[tokio::test]
async fn tasks_run_in_the_order_of_their_requests() {
    let (_folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    let export = added(&queue(&store, TaskKind::EXPORTS), TaskKind::Export).await;
    let mut asked = Vec::new();
    for kind in [TaskKind::Training, TaskKind::Evaluation, TaskKind::Training] {
        asked.push(added(&jobs, kind).await);
    }
    assert!(jobs.is_full(3).await.unwrap() && !jobs.is_full(4).await.unwrap());
    let (worker, ran) = worker(&jobs, false);
    // One that is requested while the worker is idle, too.
    in_state(&store, asked[2], TaskState::Done).await;
    asked.push(added(&jobs, TaskKind::Evaluation).await);
    let done = in_state(&store, asked[3], TaskState::Done).await;
    assert_eq!(done.result, Some(json!({ "task": asked[3] })));
    assert_eq!(*ran.lock(), asked);
    // The worker drops the shared state after the end is stored.
    let forgotten = async {
        while jobs.running(asked[3]).is_some() {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    };
    tokio::time::timeout(PATIENCE, forgotten).await.unwrap();
    // Another queue serves exports.
    in_state(&store, export, TaskState::Waiting).await;
    worker.abort();
}

#[tokio::test]
async fn one_queue_does_not_wait_for_another() {
    let (_folder, store) = fresh().await;
    let (jobs, exports) = (queue(&store, TaskKind::JOBS), queue(&store, TaskKind::EXPORTS));
    let workers = [worker(&jobs, true), worker(&exports, false)];
    let training = added(&jobs, TaskKind::Training).await;
    in_state(&store, training, TaskState::Running).await;
    let export = added(&exports, TaskKind::Export).await;
    in_state(&store, export, TaskState::Done).await;
    in_state(&store, training, TaskState::Running).await;
    workers.iter().for_each(|(worker, _)| worker.abort());
}

#[tokio::test]
async fn after_a_restart_the_running_task_continues_first() {
    let (folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    let first = added(&jobs, TaskKind::Training).await;
    let second = added(&jobs, TaskKind::Training).await;
    let (working, _) = worker(&jobs, true);
    let begun = in_state(&store, first, TaskState::Running).await;
    working.abort();
    working.await.unwrap_err();
    store.close().await;

    let store = open(&folder.file()).await;
    let jobs = queue(&store, TaskKind::JOBS);
    let (working, ran) = worker(&jobs, false);
    in_state(&store, second, TaskState::Done).await;
    assert_eq!(*ran.lock(), [first, second]);
    let done = in_state(&store, first, TaskState::Done).await;
    assert_eq!(done.started_at, begun.started_at);
    working.abort();
}

#[tokio::test]
async fn an_end_that_cannot_be_stored_is_stored_later_without_a_second_run() {
    let (_folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    execute(
        &store,
        "CREATE TRIGGER full AFTER UPDATE ON tasks WHEN new.state = 'done'
             BEGIN SELECT RAISE(ABORT, 'the disk is full'); END",
    )
    .await;
    let (working, ran) = worker(&jobs, false);
    let first = added(&jobs, TaskKind::Training).await;
    in_state(&store, first, TaskState::Running).await;
    let second = added(&jobs, TaskKind::Training).await;
    // Longer than the first pause.
    tokio::time::sleep(Duration::from_millis(700)).await;
    in_state(&store, first, TaskState::Running).await;
    assert_eq!(*ran.lock(), [first]);
    execute(&store, "DROP TRIGGER full").await;
    in_state(&store, second, TaskState::Done).await;
    in_state(&store, first, TaskState::Done).await;
    assert_eq!(*ran.lock(), [first, second]);
    working.abort();
}

/// The end is stored although its commit reported a failure: the next attempt finds it.
#[tokio::test]
async fn an_end_whose_commit_failed_may_be_stored() {
    let (_folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    let (working, ran) = worker(&jobs, true);
    let first = added(&jobs, TaskKind::Training).await;
    let second = added(&jobs, TaskKind::Training).await;
    in_state(&store, first, TaskState::Running).await;
    store.inner.writer.fail_after_next_commit().await.unwrap();
    jobs.stop(first, Shared::stop).await.unwrap();
    in_state(&store, second, TaskState::Running).await;
    jobs.stop(second, Shared::stop).await.unwrap();
    in_state(&store, second, TaskState::Stopped).await;
    in_state(&store, first, TaskState::Stopped).await;
    assert_eq!(*ran.lock(), [first, second]);
    working.abort();
}

#[tokio::test]
async fn a_begin_that_cannot_be_stored_is_tried_again() {
    let (_folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    execute(
        &store,
        "CREATE TRIGGER full AFTER UPDATE ON tasks WHEN new.state = 'running'
             BEGIN SELECT RAISE(ABORT, 'the disk is full'); END",
    )
    .await;
    let (working, ran) = worker(&jobs, false);
    let id = added(&jobs, TaskKind::Training).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert!(ran.lock().is_empty());
    execute(&store, "DROP TRIGGER full").await;
    in_state(&store, id, TaskState::Done).await;
    assert_eq!(*ran.lock(), [id]);
    working.abort();
}

#[tokio::test]
async fn a_waiting_and_a_running_task_can_be_stopped() {
    let (_folder, store) = fresh().await;
    let jobs = queue(&store, TaskKind::JOBS);
    let mut asked = Vec::new();
    for _ in 0..3 {
        asked.push(added(&jobs, TaskKind::Evaluation).await);
    }
    // Without a worker nothing runs yet.
    jobs.stop(asked[0], Shared::stop).await.unwrap();
    in_state(&store, asked[0], TaskState::Stopped).await;
    let (working, ran) = worker(&jobs, true);
    in_state(&store, asked[1], TaskState::Running).await;
    jobs.stop(asked[2], Shared::stop).await.unwrap();
    in_state(&store, asked[2], TaskState::Stopped).await;
    jobs.stop(asked[1], Shared::stop).await.unwrap();
    let stopped = in_state(&store, asked[1], TaskState::Stopped).await;
    assert_eq!(*ran.lock(), [asked[1]]);
    // One that has ended does not change.
    jobs.stop(asked[1], Shared::stop).await.unwrap();
    assert_eq!(store.task(asked[1]).await.unwrap().unwrap(), stopped);
    working.abort();
}

#[tokio::test]
async fn a_task_that_panics_fails_and_the_next_one_runs() {
    let (_folder, store) = fresh().await;
    let queue = queue(&store, TaskKind::JOBS);
    let (first, second) =
        (added(&queue, TaskKind::Training).await, added(&queue, TaskKind::Evaluation).await);
    let (working, stored) = (queue.clone(), Arc::new(Mutex::new(Vec::new())));
    let ended = stored.clone();
    let worker = tokio::spawn(async move {
        let run = |task: TaskRow, _| async move {
            assert!(task.kind != TaskKind::Training, "on purpose");
            TaskEnd::Done(json!({}))
        };
        working.work(run, |id, end: &TaskEnd| ended.lock().push((id, end.state()))).await;
    });
    let failed = in_state(&store, first, TaskState::Failed).await;
    assert_eq!(failed.error.as_deref(), Some("the program failed: see its log"));
    in_state(&store, second, TaskState::Done).await;
    while stored.lock().len() < 2 {
        tokio::task::yield_now().await;
    }
    let both = [(first, TaskState::Failed), (second, TaskState::Done)];
    assert_eq!(*stored.lock(), both, "each end is announced once it is stored");
    worker.abort();
}
