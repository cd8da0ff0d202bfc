//! Tasks: their states, their ends, their order, and the rows of the queues before them.
//! Uses: `store`. Never: a file outside its own temporary folder.

use serde_json::{Value, json};

use super::{Folder, fresh, is_intact, time};
use crate::ids::TaskId;
use crate::{Store, TaskEnd, TaskKind, TaskRow, TaskState};

async fn created(store: &Store, kind: TaskKind) -> TaskRow {
    store.create_task(kind, json!({ "dataset": "real" }), "ada").await.unwrap()
}

async fn stored(store: &Store, id: TaskId) -> TaskRow {
    store.task(id).await.unwrap().unwrap()
}

fn ids(rows: &[TaskRow]) -> Vec<TaskId> {
    rows.iter().map(|row| row.id).collect()
}

#[tokio::test]
async fn a_task_waits_runs_and_ends() {
    let (_folder, store) = fresh().await;
    for (kind, prefix) in
        [(TaskKind::Export, "ex-"), (TaskKind::Training, "job-"), (TaskKind::Evaluation, "job-")]
    {
        let task = created(&store, kind).await;
        assert!(task.id.to_string().starts_with(prefix));
        assert_eq!((task.kind, task.state), (kind, TaskState::Waiting));
        assert_eq!((task.request["dataset"].as_str(), &*task.asked_by), (Some("real"), "ada"));
        assert_eq!((task.started_at, task.finished_at), (None, None));
        assert!(store.begin_task(task.id, None).await.unwrap());
        let running = stored(&store, task.id).await;
        assert_eq!((running.state, running.finished_at), (TaskState::Running, None));
        assert!(running.started_at.is_some());
        assert!(store.end_task(task.id, TaskEnd::Done(json!({ "rows": 7 }))).await.unwrap());
        let done = stored(&store, task.id).await;
        assert_eq!((done.state, done.result), (TaskState::Done, Some(json!({ "rows": 7 }))));
        assert_eq!(done.started_at, running.started_at);
        assert!(done.finished_at.is_some());
    }
    assert_eq!(store.task(TaskId::new_job()).await.unwrap(), None);
}

#[tokio::test]
async fn a_task_ends_once() {
    let (_folder, store) = fresh().await;
    for (end, state) in [
        (TaskEnd::Done(Value::Null), TaskState::Done),
        (TaskEnd::Stopped, TaskState::Stopped),
        (TaskEnd::Failed("no rows".into()), TaskState::Failed),
    ] {
        let id = created(&store, TaskKind::Training).await.id;
        assert!(store.end_task(id, end).await.unwrap());
        let ended = stored(&store, id).await;
        assert_eq!(ended.state, state);
        assert!(!store.end_task(id, TaskEnd::Failed("later".into())).await.unwrap());
        assert!(!store.begin_task(id, None).await.unwrap());
        assert_eq!(stored(&store, id).await, ended);
    }
    assert!(!store.end_task(TaskId::new_job(), TaskEnd::Stopped).await.unwrap());
}

#[tokio::test]
async fn each_kind_is_listed_in_the_order_of_the_requests() {
    let (_folder, store) = fresh().await;
    let mut tasks = Vec::new();
    for kind in [TaskKind::Training, TaskKind::Export, TaskKind::Evaluation, TaskKind::Export] {
        tasks.push(created(&store, kind).await.id);
    }
    let [training, first, evaluation, second] = tasks[..] else { panic!() };
    let listed = async |kinds, limit| ids(&store.tasks(kinds, limit, None).await.unwrap());
    let waiting = async |kinds, limit| ids(&store.open_tasks(kinds, limit).await.unwrap());
    assert_eq!(listed(TaskKind::JOBS, 10).await, [evaluation, training]);
    assert_eq!(listed(TaskKind::EXPORTS, 10).await, [second, first]);
    assert_eq!(listed(TaskKind::EXPORTS, 1).await, [second]);
    store.begin_task(second, None).await.unwrap();
    assert_eq!(waiting(TaskKind::EXPORTS, 10).await, [first, second]);
    assert_eq!(waiting(TaskKind::JOBS, 1).await, [training]);
    store.end_task(training, TaskEnd::Stopped).await.unwrap();
    assert_eq!(waiting(TaskKind::JOBS, 10).await, [evaluation]);
    assert_eq!(listed(TaskKind::JOBS, 10).await, [evaluation, training]);
}

#[tokio::test]
async fn the_newest_training_of_a_model_is_found() {
    let (_folder, store) = fresh().await;
    for model in ["mdl-1", "mdl-1", "mdl-2"] {
        let training = created(&store, TaskKind::Training).await.id;
        store.end_task(training, TaskEnd::Done(json!({ "model": model }))).await.unwrap();
    }
    let ended = store.tasks(TaskKind::JOBS, 10, None).await.unwrap();
    let of = async |model: &str| store.training_of(&model.parse().unwrap()).await.unwrap();
    assert_eq!(of("mdl-1").await.as_ref(), Some(&ended[1]));
    assert_eq!(of("mdl-3").await, None);
}

#[tokio::test]
async fn the_evaluations_of_a_model_are_found() {
    let (_folder, store) = fresh().await;
    let evaluation = created(&store, TaskKind::Evaluation).await.id;
    let result = json!({ "models": ["mdl-1", "mdl-2"] });
    store.end_task(evaluation, TaskEnd::Done(result.clone())).await.unwrap();
    let training = created(&store, TaskKind::Training).await.id;
    store.end_task(training, TaskEnd::Done(result)).await.unwrap();
    assert_eq!(ids(&store.evaluations_of(&"mdl-2".parse().unwrap()).await.unwrap()), [evaluation]);
    assert_eq!(store.evaluations_of(&"mdl-3".parse().unwrap()).await.unwrap(), []);
}

/// States and kinds are stored under the names that the statements and the table contain.
#[test]
fn states_and_kinds_have_one_text() {
    let kinds = [TaskKind::Export, TaskKind::Training, TaskKind::Evaluation];
    let texts = ["export", "training", "evaluation"];
    assert_eq!(kinds.map(|kind| kind.to_string()), texts);
    assert_eq!(serde_json::to_value(kinds).unwrap(), json!(texts));
    let states = [
        TaskState::Waiting,
        TaskState::Running,
        TaskState::Done,
        TaskState::Stopped,
        TaskState::Failed,
    ];
    let texts = ["waiting", "running", "done", "stopped", "failed"];
    assert_eq!(states.map(|state| state.to_string()), texts);
    assert_eq!(serde_json::to_value(states).unwrap(), json!(texts));
}

/// A file of the version with two queues keeps all of their rows.
#[tokio::test]
async fn exports_and_jobs_become_tasks() {
    let folder = Folder::new();
    let filled = "INSERT INTO datasets VALUES ('ds-1', 'real', '{}', 3, 4, 'ab', '{}', '{}',
             '2026-11-20T18:00:00.000Z');
         INSERT INTO exports VALUES
             ('ex-0190a0a0-0000-7000-8000-000000000001', '{\"format\":\"csv\"}', 'done', 'ds-1',
                 'f.csv', 7, 'cd', NULL, 'ada', '2026-11-20T18:00:01.000Z',
                 '2026-11-20T18:00:02.000Z'),
             ('ex-0190a0a0-0000-7000-8000-000000000002', '{}', 'failed', NULL, NULL, NULL, NULL,
                 'no rows', 'ada', '2026-11-20T18:00:01.000Z', '2026-11-20T18:00:02.000Z'),
             ('ex-0190a0a0-0000-7000-8000-000000000003', '{}', 'waiting', NULL, NULL, NULL, NULL,
                 NULL, 'ada', '2026-11-20T18:00:01.000Z', NULL);
         INSERT INTO jobs VALUES
             ('job-0190a0a0-0000-7000-8000-000000000004', 'training', '{}', 'done', 'ds-1',
                 '{\"model\":\"mdl-1\"}', NULL, 'ben', '2026-11-20T18:00:01.000Z',
                 '2026-11-20T18:00:02.000Z', '2026-11-20T18:00:03.000Z'),
             ('job-0190a0a0-0000-7000-8000-000000000005', 'evaluation', '{}', 'running', 'ds-1',
                 NULL, NULL, 'ben', '2026-11-20T18:00:01.000Z', '2026-11-20T18:00:02.000Z', NULL),
             ('job-0190a0a0-0000-7000-8000-000000000006', 'training', '{}', 'stopped', NULL, NULL,
                 NULL, 'ben', '2026-11-20T18:00:01.000Z', NULL, '2026-11-20T18:00:03.000Z');";
    let store = folder.open_from_before(8, &[filled]).await;
    is_intact(&store).await;
    let exports = store.tasks(TaskKind::EXPORTS, 10, None).await.unwrap();
    let states: Vec<_> = exports.iter().map(|export| export.state).collect();
    assert_eq!(states, [TaskState::Waiting, TaskState::Failed, TaskState::Done]);
    assert_eq!(exports[1].error.as_deref(), Some("no rows"));
    let done = TaskRow {
        id: "ex-0190a0a0-0000-7000-8000-000000000001".parse().unwrap(),
        kind: TaskKind::Export,
        request: json!({ "format": "csv" }),
        state: TaskState::Done,
        dataset: Some("ds-1".parse().unwrap()),
        result: Some(json!({ "file": "f.csv", "bytes": 7, "sha256": "cd" })),
        error: None,
        asked_by: "ada".into(),
        created_at: time("2026-11-20T18:00:01Z"),
        started_at: None,
        finished_at: Some(time("2026-11-20T18:00:02Z")),
    };
    assert_eq!(exports[2], done);
    let jobs = store.tasks(TaskKind::JOBS, 10, None).await.unwrap();
    let states: Vec<_> = jobs.iter().map(|job| (job.kind, job.state)).collect();
    assert_eq!(
        states,
        [
            (TaskKind::Training, TaskState::Stopped),
            (TaskKind::Evaluation, TaskState::Running),
            (TaskKind::Training, TaskState::Done)
        ]
    );
    let done = TaskRow {
        id: "job-0190a0a0-0000-7000-8000-000000000004".parse().unwrap(),
        kind: TaskKind::Training,
        request: json!({}),
        result: Some(json!({ "model": "mdl-1" })),
        asked_by: "ben".into(),
        started_at: Some(time("2026-11-20T18:00:02Z")),
        finished_at: Some(time("2026-11-20T18:00:03Z")),
        ..done
    };
    assert_eq!(jobs[2], done);
}
