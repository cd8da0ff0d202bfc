//! Runs and the queue: numbers, provenance, states, ends, order.
//! Uses: `store`, `journal`. Never: trials (see `trials.rs`).

use super::{execute, findings, fresh, hex_trial, new_run, now, open, time, with_run};
use crate::ids::RunUid;
use crate::journal::{ExitStatus, Journal};
use crate::record::TareRecord;
use crate::state::{PausedWhy, StateChange, StoredState};
use crate::table::RUN_COLUMNS;
use crate::{Condition, Label, NewRun, RunKind, Store, StoreError};

fn planned(plan: &str) -> NewRun {
    NewRun { plan: Some(plan.into()), ..new_run(RunKind::RealHex) }
}

/// Runs of the queue, in its order.
async fn four_queued(store: &Store) -> [RunUid; 4] {
    let mut uids = [RunUid::new(); 4];
    for uid in &mut uids {
        *uid = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    }
    uids
}

#[tokio::test]
async fn a_run_keeps_its_provenance() {
    let (_folder, store) = fresh().await;
    let new = new_run(RunKind::RealRandom);
    let row = store.create_run(new.clone()).await.unwrap();
    assert_eq!((row.scan_id, row.state, row.seed), (1, StoredState::Idle, Some(7)));
    assert_eq!(row.definition, new.definition);
    // printf rig | sha256sum
    let known = "c00ae0a63348054ecc8343f23278fe13bfa5c44255e208ff6102ffc2d7910a53";
    assert_eq!(row.rig_sha256.as_deref(), Some(known));
    assert_ne!(row.rig_sha256.as_deref(), Some(row.sensor_sha256.as_str()));
    assert_eq!(store.run(new.uid).await.unwrap(), Some(row.clone()));
    assert_eq!(store.run_by_scan_id(1).await.unwrap(), Some(row));
    assert_eq!(store.run(RunUid::new()).await.unwrap(), None);
    let twice = store.create_run(new).await.unwrap_err();
    assert!(!twice.outcome_unknown(), "a refused id is known not to be stored: {twice}");
    let mut huge = new_run(RunKind::RealHex);
    huge.seed = Some(u64::MAX);
    assert!(matches!(store.create_run(huge).await, Err(StoreError::Refused { field: "seed", .. })));
}

#[tokio::test]
async fn states_advance_until_the_end_and_no_further() {
    let (_folder, store) = fresh().await;
    let run = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    assert_eq!(store.run(run).await.unwrap().unwrap().queue_position, Some(1));
    let at = time("2026-11-20T18:00:00.5Z");
    let pausing = Some(StoredState::Pausing);
    let change = StateChange { requested: pausing, ..StateChange::to(StoredState::Running) };
    store.run_state(run, change, at).await.unwrap();
    let row = store.run(run).await.unwrap().unwrap();
    assert_eq!(row.started_at, Some(at), "when it happened, not when it was written");
    assert_eq!((row.state, row.queue_position), (StoredState::Running, None));
    assert_eq!(row.requested_state, pausing);
    let started = row.started_at.unwrap();
    let why = Some(PausedWhy::TipChange);
    let change = StateChange { why, ..StateChange::to(StoredState::Paused) };
    store.run_state(run, change, now()).await.unwrap();
    let row = store.run(run).await.unwrap().unwrap();
    assert_eq!((row.paused_why, row.requested_state), (why, None));
    assert_eq!(row.started_at, Some(started));
    assert!(store.run_state(run, StateChange::to(StoredState::Queued), now()).await.is_err());

    store.end_run(run, ExitStatus::Success, "finished", now()).await.unwrap();
    let ended = store.run(run).await.unwrap().unwrap();
    assert_eq!((ended.state, ended.exit_status), (StoredState::Ended, Some(ExitStatus::Success)));
    assert_eq!((ended.reason.as_deref(), ended.paused_why), (Some("finished"), None));
    store.end_run(run, ExitStatus::Success, "asked twice", now()).await.unwrap();
    assert!(store.end_run(run, ExitStatus::Fail, "no", now()).await.is_err());
    assert!(store.run_state(run, StateChange::to(StoredState::Running), now()).await.is_err());
    assert_eq!(store.run(run).await.unwrap().unwrap(), ended);
    let unknown = store
        .run_state(RunUid::new(), StateChange::to(StoredState::Running), now())
        .await
        .unwrap_err();
    let cause = std::error::Error::source(&unknown).unwrap().to_string();
    assert!(cause.contains("there is no run"), "{cause}");
}

#[tokio::test]
async fn open_runs_are_interrupted_at_the_start() {
    let (_folder, store) = fresh().await;
    let mut uids = Vec::new();
    use StoredState::{Ended, Paused, Queued, Running};
    for state in [Running, Paused, Ended, Queued] {
        let new = new_run(RunKind::RealHex);
        let uid = new.uid;
        if state == Queued {
            store.enqueue(new).await.unwrap();
        } else {
            store.create_run(new).await.unwrap();
            store.run_state(uid, StateChange::to(StoredState::Running), now()).await.unwrap();
        }
        if state == Paused {
            let (requested, why) = (Some(Running), Some(PausedWhy::Operator));
            store.run_state(uid, StateChange { state, requested, why }, now()).await.unwrap();
        }
        if state == Ended {
            store.end_run(uid, ExitStatus::Abort, "by request", now()).await.unwrap();
        }
        uids.push(uid);
    }
    let open =
        async || -> Vec<_> { store.open_runs().await.unwrap().iter().map(|run| run.uid).collect() };
    assert_eq!(open().await, uids[..2]);
    store.interrupt_open_runs(Some(uids[0])).await.unwrap();
    assert_eq!(open().await, uids[..1], "the run that resumes keeps its state");
    store.interrupt_open_runs(None).await.unwrap();
    assert!(open().await.is_empty());
    let left = store.run(uids[1]).await.unwrap().unwrap();
    assert_eq!((left.state, left.requested_state), (StoredState::Interrupted, None));
    store.run_state(uids[0], StateChange::to(StoredState::Running), now()).await.unwrap();
}

#[tokio::test]
async fn open_runs_that_are_left_are_read_as_interrupted_and_stay_as_they_are_stored() {
    let (folder, store) = fresh().await;
    let (open_run, queued) = (new_run(RunKind::RealHex), new_run(RunKind::RealHex));
    let [uid, next] = [open_run.uid, queued.uid];
    let scan_id = store.create_run(open_run).await.unwrap().scan_id;
    store.enqueue(queued).await.unwrap();
    store.set_waiting(next).await.unwrap();
    let (requested, why) = (Some(StoredState::Running), Some(PausedWhy::Operator));
    let state = StoredState::Paused;
    store.run_state(uid, StateChange { state, requested, why }, now()).await.unwrap();
    let stored = store.run(uid).await.unwrap().unwrap();
    store.leave_open_runs();
    let read = store.run(uid).await.unwrap().unwrap();
    assert_eq!((read.state, read.requested_state), (StoredState::Interrupted, None));
    assert_eq!((read.paused_why, read.is_resumable), (Some(PausedWhy::Restart), true));
    assert_eq!(store.run_by_scan_id(scan_id).await.unwrap().as_ref(), Some(&read));
    assert_eq!(store.all_runs().await.unwrap()[0], read);
    assert!(store.open_runs().await.unwrap().is_empty());
    let listed = async |condition: &str| -> Vec<RunUid> {
        let condition = Condition::parse_of(&RUN_COLUMNS, condition).unwrap();
        let page = store.runs(&[condition], 10, None).await.unwrap();
        page.runs.iter().map(|run| run.uid).collect()
    };
    assert_eq!(listed("state=interrupted").await, [uid]);
    assert_eq!(listed("state__in=queued,interrupted").await, [next, uid]);
    assert!(listed("state=paused").await.is_empty());
    store.close().await;
    let store = open(&folder.file()).await;
    assert_eq!(store.run(uid).await.unwrap(), Some(stored));
    assert_eq!(store.open_runs().await.unwrap().len(), 1);
    assert_eq!(store.waiting_runs().await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_stop_by_a_person_is_stored_also_of_open_runs_that_are_left() {
    let (folder, store, uid) = with_run(RunKind::RealHex).await;
    store.run_state(uid, StateChange::to(StoredState::Running), now()).await.unwrap();
    store.leave_open_runs();
    store.interrupt_open_runs(None).await.unwrap();
    store.close().await;
    // The next process reads what is stored.
    let store = open(&folder.file()).await;
    assert_eq!(store.run(uid).await.unwrap().unwrap().state, StoredState::Interrupted);
}

#[tokio::test]
async fn the_newest_run_that_pressed_the_skin_before_a_time_is_found() {
    let (_folder, store) = fresh().await;
    let mut pressed = Vec::new();
    for (sensor, at, forces_n) in [
        ("sensor", "2026-11-20T18:00:00Z", Some([7.0])),
        ("sensor", "2026-11-21T18:00:00Z", Some([9.0])),
        ("sensor", "2026-11-22T18:00:00Z", None),
        ("another", "2026-11-23T18:00:00Z", Some([8.0])),
    ] {
        let new = NewRun { sensor: sensor.into(), ..new_run(RunKind::RealHex) };
        let run = store.create_run(new).await.unwrap();
        let running = StateChange::to(StoredState::Running);
        store.run_state(run.uid, running, time(at)).await.unwrap();
        if let Some(forces_n) = forces_n {
            store.trial(run.uid, &hex_trial(0, 0, &forces_n)).await.unwrap();
        }
        pressed.push(run);
    }
    let skin = pressed[0].sensor_sha256.as_str();
    let found = async |label: Label, before: &str| {
        let found = store.pressed_before(skin, label, time(before)).await.unwrap();
        found.map(|run| run.scan_id)
    };
    assert_eq!(found(Label::Virtual, "2026-11-24T00:00:00Z").await, Some(pressed[1].scan_id));
    assert_eq!(found(Label::Virtual, "2026-11-21T18:00:00Z").await, Some(pressed[0].scan_id));
    assert_eq!(found(Label::Virtual, "2026-11-20T18:00:00Z").await, None);
    assert_eq!(found(Label::Measured, "2026-11-24T00:00:00Z").await, None);
}

#[tokio::test]
async fn a_run_that_ended_short_of_its_plan_can_be_driven_again() {
    let (_folder, store) = fresh().await;
    let running = StateChange::to(StoredState::Running);
    for status in [ExitStatus::Stopped, ExitStatus::Abort, ExitStatus::Fail, ExitStatus::Success] {
        let run = store.create_run(new_run(RunKind::RealHex)).await.unwrap().uid;
        store.run_state(run, running, now()).await.unwrap();
        store.end_run(run, status, "requested", now()).await.unwrap();
        let ended = store.run(run).await.unwrap().unwrap();
        assert_eq!(ended.is_resumable, status != ExitStatus::Success);
        let pausing = StateChange::to(StoredState::Pausing);
        assert!(store.run_state(run, pausing, now()).await.is_err(), "a late change");
        assert_eq!(store.run_state(run, running, now()).await.is_ok(), ended.is_resumable);
        let open = store.run(run).await.unwrap().unwrap();
        if ended.is_resumable {
            assert_eq!((open.exit_status, open.reason, open.ended_at), (None, None, None));
            assert_eq!(open.started_at, ended.started_at);
            store.end_run(run, ExitStatus::Success, "every trial", now()).await.unwrap();
        } else {
            assert_eq!(open, ended);
        }
    }
}

#[tokio::test]
async fn the_queue_is_in_the_order_that_was_asked_for() {
    let (_folder, store) = fresh().await;
    let [a, b, c, d] = four_queued(&store).await;
    let order = |rows: Vec<crate::RunRow>| {
        let positions: Vec<_> = rows.iter().map(|r| r.queue_position.unwrap()).collect();
        assert_eq!(positions, (1..=rows.len() as u32).collect::<Vec<_>>());
        rows.into_iter().map(|r| r.uid).collect::<Vec<_>>()
    };
    assert_eq!(order(store.queue().await.unwrap()), [a, b, c, d]);
    assert_eq!(order(store.move_item(d, 1).await.unwrap()), [d, a, b, c]);
    assert_eq!(order(store.move_item(d, 99).await.unwrap()), [a, b, c, d]);
    assert_eq!(order(store.move_item(a, 3).await.unwrap()), [b, c, a, d]);
    assert_eq!(store.queue().await.unwrap()[0].uid, b);
    let removed = store.remove(c).await.unwrap();
    assert_eq!((removed.state, removed.queue_position), (StoredState::Removed, None));
    assert_eq!(order(store.queue().await.unwrap()), [b, a, d]);
    assert!(matches!(store.remove(c).await, Err(StoreError::NotQueued(u)) if u == c));
    assert!(matches!(store.move_item(c, 1).await, Err(StoreError::NotQueued(_))));
    assert!(store.run_state(c, StateChange::to(StoredState::Running), now()).await.is_err());
    store.run_state(b, StateChange::to(StoredState::Running), now()).await.unwrap();
    assert_eq!(store.queue().await.unwrap()[0].uid, a);
}

#[tokio::test]
async fn an_edited_run_keeps_number_place_and_submitter_and_is_no_longer_started() {
    let (_folder, store) = fresh().await;
    let before = store.enqueue(planned("one")).await.unwrap();
    let other = store.enqueue(planned("two")).await.unwrap();
    store.set_waiting(before.uid).await.unwrap();
    let edit = NewRun {
        uid: before.uid,
        experiment: "night".into(),
        definition: "name = \"night\"\n".into(),
        not_before: Some(time("2026-11-24T21:00:00Z")),
        auto_resume: false,
        deadband_n: 4.0,
        trials_planned: 7,
        submitted_by: "somebody else".into(),
        ..planned("two")
    };
    let after = store.replace_queued(edit.clone()).await.unwrap();
    assert_eq!(store.run(before.uid).await.unwrap().unwrap(), after);
    let kept = |run: &crate::RunRow| {
        (run.uid, run.scan_id, run.queue_position, run.created_at, run.submitted_by.clone())
    };
    assert_eq!(kept(&after), kept(&before));
    assert_eq!((after.experiment.as_str(), after.trials_planned), ("night", 7));
    assert_eq!((after.not_before, after.waiting_since), (edit.not_before, None));
    assert!(!after.auto_resume && after.definition_sha256 != before.definition_sha256);
    assert_eq!(after.plan_sha256, other.plan_sha256);
    assert_eq!(store.plan_of(before.uid).await.unwrap().as_deref(), Some("two"));
    // A plan is removed with the last run that has it.
    store.replace_queued(NewRun { uid: other.uid, ..planned("three") }).await.unwrap();
    assert_eq!(store.plan_of(before.uid).await.unwrap().as_deref(), Some("two"));
    store.run_state(before.uid, StateChange::to(StoredState::Running), now()).await.unwrap();
    for uid in [before.uid, RunUid::new()] {
        let refused = store.replace_queued(NewRun { uid, ..planned("four") }).await;
        assert!(matches!(refused, Err(StoreError::NotQueued(u)) if u == uid));
    }
    assert_eq!(store.runs(&[], 10, None).await.unwrap().runs.len(), 2);
}

#[tokio::test]
async fn trials_are_labelled_by_an_edit_that_was_stored_although_it_failed() {
    let (_folder, store) = fresh().await;
    let run = store.enqueue(new_run(RunKind::RealHex)).await.unwrap().uid;
    assert!(store.skips(run).await.unwrap().is_empty(), "its facts were read");
    store.inner.writer.fail_after_next_commit().await.unwrap();
    let edit = NewRun { uid: run, deadband_n: 4.0, ..new_run(RunKind::RealHex) };
    store.replace_queued(edit).await.unwrap_err();
    store.run_state(run, StateChange::to(StoredState::Running), now()).await.unwrap();
    let id = store.trial(run, &hex_trial(0, 0, &[4.5])).await.unwrap();
    let trial = store.trial_by_id(id).await.unwrap().unwrap();
    assert_eq!((trial.contact_count, trial.contacts.len()), (1, 1));
}

#[tokio::test]
async fn runs_come_in_pages_newest_first() {
    let (_folder, store) = fresh().await;
    for _ in 0..5 {
        store.create_run(new_run(RunKind::RealHex)).await.unwrap();
    }
    let mut seen = Vec::new();
    let mut before = None;
    loop {
        let page = store.runs(&[], 2, before).await.unwrap();
        seen.extend(page.runs.iter().map(|r| r.scan_id));
        before = page.next;
        if before.is_none() {
            break;
        }
    }
    assert_eq!(seen, [5, 4, 3, 2, 1]);
}

#[tokio::test]
async fn the_last_run_to_end_is_found_behind_newer_runs() {
    let (_folder, store) = fresh().await;
    let uids = four_queued(&store).await;
    let ended = async |limit| {
        let runs = store.ended_runs(limit).await.unwrap();
        runs.iter().map(|run| run.scan_id).collect::<Vec<_>>()
    };
    assert_eq!(ended(1).await, [0_i64; 0]);
    let at = ["2026-11-20T18:00:00Z", "2026-11-20T19:00:00Z"].map(time);
    store.end_run(uids[0], ExitStatus::Stopped, "stopped", at[0]).await.unwrap();
    assert_eq!(ended(1).await, [1], "of four, the three newer ones are queued");
    store.end_run(uids[1], ExitStatus::Success, "finished", at[0]).await.unwrap();
    assert_eq!(ended(2).await, [2, 1]);
    // A stopped run is resumed and ends again.
    store.run_state(uids[0], StateChange::to(StoredState::Running), at[1]).await.unwrap();
    assert_eq!(ended(2).await, [2]);
    store.end_run(uids[0], ExitStatus::Success, "finished", at[1]).await.unwrap();
    assert_eq!(ended(1).await, [1, 2], "and the newest of those that have ended");
    // The clock is set back.
    let early = time("2026-11-19T18:00:00Z");
    store.end_run(uids[2], ExitStatus::Success, "finished", early).await.unwrap();
    assert_eq!(ended(1).await, [1, 3], "the last one to end is the newest");
    assert_eq!(ended(9).await, [1, 2, 3]);
}

#[tokio::test]
async fn runs_are_selected_by_conditions() {
    let (_folder, store) = fresh().await;
    for experiment in ["one", "two", "three"] {
        let new = NewRun { experiment: experiment.into(), ..new_run(RunKind::RealHex) };
        store.create_run(new).await.unwrap();
    }
    let selected = async |texts: &[&str], limit| {
        let parse = |text: &&str| Condition::parse_of(&RUN_COLUMNS, text).unwrap();
        let conditions: Vec<Condition> = texts.iter().map(parse).collect();
        let page = store.runs(&conditions, limit, None).await.unwrap();
        (page.runs.iter().map(|run| run.scan_id).collect::<Vec<_>>(), page.next)
    };
    assert_eq!(selected(&["experiment__in=one,three"], 10).await, (vec![3, 1], None));
    assert_eq!(selected(&["experiment=one|scan_id__gte=3"], 1).await, (vec![3], Some(3)));
    assert_eq!(selected(&["state=idle", "kind=real-hex"], 10).await.0, [3, 2, 1]);
    // A time that is absent meets no condition.
    assert_eq!(selected(&["started_at__gt=2000-01-01T00:00:00Z"], 10).await.0, [0_i64; 0]);
    assert_eq!(selected(&["created_at__gt=2000-01-01T00:00:00Z"], 10).await.0, [3, 2, 1]);
}

#[tokio::test]
async fn a_run_that_waits_for_its_turn_does_so_through_a_crash() {
    let (folder, store) = fresh().await;
    let [a, b, c, d] = four_queued(&store).await;
    assert!(store.waiting_runs().await.unwrap().is_empty());
    store.run_state(a, StateChange::to(StoredState::Running), now()).await.unwrap();
    for run in [d, b, c] {
        store.set_waiting(run).await.unwrap();
    }
    let since = store.run(d).await.unwrap().unwrap().waiting_since;
    store.set_waiting(d).await.unwrap();
    assert!(store.set_waiting(a).await.is_err(), "it is active");
    // The process ends: the next one opens the same file.
    let store = open(&folder.file()).await;
    let waiting = async || -> Vec<_> {
        store.waiting_runs().await.unwrap().iter().map(|run| run.uid).collect()
    };
    assert_eq!(waiting().await, [b, c, d], "in the order of the queue");
    assert_eq!(store.run(d).await.unwrap().unwrap().waiting_since, since);
    // One is removed from the queue, one begins, one must be started again.
    store.remove(b).await.unwrap();
    assert_eq!(waiting().await, [c, d]);
    store.run_state(c, StateChange::to(StoredState::Running), now()).await.unwrap();
    assert_eq!(waiting().await, [d]);
    store.clear_waiting(d).await.unwrap();
    assert!(waiting().await.is_empty());
    // An interrupted run may wait, too, before those of the queue.
    store.interrupt_open_runs(None).await.unwrap();
    assert!(waiting().await.is_empty(), "a run that begins is no longer marked");
    store.set_waiting(d).await.unwrap();
    store.set_waiting(a).await.unwrap();
    assert_eq!(waiting().await, [a, d]);
}

#[tokio::test]
async fn nothing_is_stored_for_a_run_that_is_not_there() {
    let (_folder, store) = fresh().await;
    assert!(store.trial(RunUid::new(), &hex_trial(0, 0, &[9.0])).await.is_err());
    assert!(store.event(Some(RunUid::new()), "state", serde_json::json!({}), now()).await.is_err());
    let tare = TareRecord { configuration: 0, volts: vec![], samples: 1, at: now() };
    assert!(store.tare(RunUid::new(), &tare).await.is_err());
    assert!(store.progress_by_configuration(RunUid::new()).await.is_err());
    assert!(store.wear(RunUid::new()).await.is_err());
    assert!(store.events_since(0, 10, None, &[]).await.unwrap().is_empty());
}

#[tokio::test]
async fn a_plan_is_kept_once_and_read_with_its_digest() {
    let (_folder, store) = fresh().await;
    let first = store.enqueue(planned("{\"steps\":[1]}")).await.unwrap();
    let same = store.enqueue(planned("{\"steps\":[1]}")).await.unwrap();
    assert_eq!(first.plan_sha256, same.plan_sha256);
    assert_eq!(store.plan_of(same.uid).await.unwrap().as_deref(), Some("{\"steps\":[1]}"));

    // Queued by an older version: kept later, and then never replaced.
    let older = store.enqueue(new_run(RunKind::RealHex)).await.unwrap();
    assert_eq!(store.plan_of(older.uid).await.unwrap(), None);
    store.keep_plan(older.uid, "{\"steps\":[2]}".into()).await.unwrap();
    store.keep_plan(older.uid, "{\"steps\":[3]}".into()).await.unwrap();
    assert_eq!(store.plan_of(older.uid).await.unwrap().as_deref(), Some("{\"steps\":[2]}"));
    assert!(matches!(store.plan_of(RunUid::new()).await, Err(StoreError::NoSuchRun(_))));

    execute(&store, "UPDATE plans SET plan = '{}'").await;
    let damaged = store.plan_of(first.uid).await.unwrap_err().to_string();
    assert!(damaged.contains("was changed after it was stored"), "{damaged}");
    let findings = findings(&store).await;
    assert!(findings[0].starts_with("the plan "), "{findings:?}");
}
