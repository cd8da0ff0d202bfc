//! What the tests of the conductor share: a conductor whose campaign is the test, its runs, and answers to its
//! requests.
//! Uses: `conductor`, a store in a temporary folder. Never: in a program.

use jiff::{SignedDuration, Timestamp};
use tempfile::TempDir;
use tokio::sync::oneshot;

use super::{Conductor, RigFile, Started, Submission, Terms};
use crate::campaign::bench::estop::StopSwitch;
use crate::campaign::shown::command::{Envelope, Inbox, Refusal, Request, channel};
use crate::campaign::shown::show;
use crate::clock::Clock;
use crate::journal::Journal;
use crate::rig::setup::RigSetup;
use crate::state::{StateChange, StoredState};
use crate::store::{RunRow, Store};

/// A conductor with an empty database and a disconnected rig, which answers nothing.
pub(super) async fn conductor() -> (Conductor, Inbox, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("palpate.db"), Clock::new(1.0)).await.unwrap();
    let text = include_str!("../../../experiments/rigs/virtual.toml");
    let config = RigSetup::from_toml("virtual.toml", text).unwrap();
    let (handle, inbox) = channel(StopSwitch::default(), show::closed(&config));
    let rig = RigFile { file: "virtual.toml".into(), text: text.into(), config };
    (Conductor::new(store, handle, rig, None), inbox, folder)
}

pub(super) async fn queued_on(conductor: &Conductor, terms: Terms) -> RunRow {
    let definition = "name = 'small'\nseed = 3\nsensor = 's'\n[real_hex]\ntips = [1]\n\
                      configurations = 2\ndepths = 2\n";
    let sensor = include_str!("../../../experiments/sensors/ert-28.toml");
    let submission = Submission {
        file: "small.toml".into(),
        definition: definition.into(),
        sensor: Some(sensor.into()),
    };
    conductor.enqueue(submission, "ada".into(), terms).await.unwrap()
}

/// A person arms and starts a run whose time has not come.
pub(super) async fn start(conductor: &Conductor, run: &RunRow) {
    let code = conductor.arm(run).await.unwrap().code;
    assert_eq!(conductor.start(run, &code, "ada".into()).await.unwrap(), Started::Waiting);
}

/// Waits for the next request, which must be this one; its answer is due.
pub(super) async fn asked(
    inbox: &mut Inbox,
    is_this: fn(&Request) -> bool,
) -> oneshot::Sender<Result<(), Refusal>> {
    let Envelope { request, answer, .. } = inbox.next().await.expect("a request");
    assert!(is_this(&request), "{request:?}");
    answer
}

/// Grants the next request, which must be this one.
pub(super) async fn granted(inbox: &mut Inbox, is_this: fn(&Request) -> bool) {
    let _ = asked(inbox, is_this).await.send(Ok(()));
}

/// Stores that a run is driven, as its campaign does.
pub(super) async fn driven(conductor: &Conductor, run: &RunRow) {
    let running = StateChange::to(StoredState::Running);
    conductor.inner.store.run_state(run.uid, running, Timestamp::now()).await.unwrap();
}

/// A run that the earlier process drove, and one that waited behind it.
pub(super) async fn earlier(conductor: &Conductor) -> [RunRow; 2] {
    let terms = Terms { auto_resume: Some(true), not_before: None };
    let [run, next] = [queued_on(conductor, terms).await, queued_on(conductor, terms).await];
    driven(conductor, &run).await;
    conductor.inner.store.set_waiting(next.uid).await.unwrap();
    [run, next]
}

/// What becomes of work that requests nothing of the campaign.
pub(super) async fn unasked<T>(inbox: &mut Inbox, work: impl Future<Output = T>) -> T {
    tokio::select! {
        done = work => done,
        asked = inbox.next() => panic!("{asked:?}"),
    }
}

pub(super) fn in_an_hour() -> Option<Timestamp> {
    Some(Timestamp::now() + SignedDuration::from_hours(1))
}
