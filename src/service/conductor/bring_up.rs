//! Brings the rig up for a run of the earlier process: opens the wires and homes, until a person comes to the rig.
//! Uses: `conductor::{take_over, stopped}`, `campaign` (its handle), `store` (an event).
//! Never: motion except through the campaign, HTTP.

use std::time::Duration;

use serde_json::json;
use tokio::time::Instant;

use super::take_over::Unattended;
use super::{Conductor, ConductorError, ConductorResult};
use crate::campaign::bench::rig_state::RigState;
use crate::campaign::bench::travel::HOMING_WAIT;
use crate::campaign::shown::command::{Refusal, Request};
use crate::campaign::shown::status::Motion;
use crate::ids::RunUid;
use crate::store::{RunKind, RunRow};

/// Interval of polling the rig's state.
const HOMING_POLL: Duration = Duration::from_millis(50);
/// Interval of reading the operator lock meanwhile.
const HOMING_LOCK_POLL: Duration = Duration::from_millis(200);

impl Conductor {
    /// Opens the wires and homes the rig, as needed. A skin alone has nothing to home, and for a manual run nothing
    /// moves: a person's hands may be on the skin. After a crash the first motion is z up, as in every homing. It ends
    /// if a person comes to the rig: one operates it, holds or aborts the run, or takes the operator lock.
    pub(super) async fn bring_up(&self, run: &RunRow, before: Unattended) -> ConductorResult<()> {
        let campaign = &self.inner.campaign;
        if campaign.status().rig.state == RigState::Disconnected {
            campaign.ask(Request::Connect).await?;
        }
        let rig = campaign.status().rig;
        if rig.is_ready() || run.kind == RunKind::RealRandom && rig.state == RigState::Disarmed {
            return Ok(());
        }
        if rig.state == RigState::Disarmed {
            // Opening the wires may have taken a while.
            self.require_unattended(run, before).await?;
            // Read after it: the run may have been aborted or held meanwhile.
            if self.is_brought_up(run.uid) {
                campaign.ask(Request::HomeForRun).await?;
            }
        }
        self.watch_homing(run, before, Instant::now() + HOMING_WAIT).await
    }

    /// Waits until the rig is homed, and ends the homing if a person comes to the rig. It lasts as long as the homing,
    /// also after `deadline`.
    async fn watch_homing(
        &self,
        run: &RunRow,
        before: Unattended,
        deadline: Instant,
    ) -> ConductorResult<()> {
        let campaign = &self.inner.campaign;
        let mut locked = std::pin::pin!(self.locked_meanwhile(run, before));
        loop {
            let rig = campaign.status().rig;
            if !self.is_brought_up(run.uid) || self.is_operated_since_start(run.uid) {
                if rig.state == RigState::Disarmed {
                    self.end_homing(run).await;
                }
                self.require_not_operated(run.uid)?;
                return Err(Refusal::State("the run was aborted or held".into()).into());
            }
            match rig.state {
                RigState::Homed => return Ok(()),
                RigState::Tripped => {
                    let why = rig.trip.map_or_else(String::new, |t| t.detail);
                    return Err(Refusal::State(format!("the rig tripped: {why}")).into());
                }
                RigState::Disconnected | RigState::Disarmed | RigState::Armed => {
                    let taken = tokio::time::timeout(HOMING_POLL, &mut locked).await;
                    if let Ok(refused) = taken {
                        // A run that has begun meanwhile continues.
                        if campaign.status().run.is_none() {
                            self.end_homing(run).await;
                        }
                        return Err(refused);
                    }
                }
            }
            if Instant::now() > deadline && rig.motion != Some(Motion::Homing) {
                let limit_s = HOMING_WAIT.as_secs();
                let words = format!("the rig was not homed within {limit_s} s: check its axes");
                return Err(Refusal::State(words).into());
            }
        }
    }

    /// Ends the homing for a run, since a person comes to the rig. If the campaign does not answer while it homes, the
    /// e-stop is pressed; once the homing has ended it is not, since it would hold the tips down.
    async fn end_homing(&self, run: &RunRow) {
        // Refused otherwise only if nothing moves any more.
        if self.halt(Request::Abort).await != Err(Refusal::Gone) {
            return;
        }
        let status = self.inner.campaign.status();
        if status.run.is_some() || status.rig.motion != Some(Motion::Homing) {
            return;
        }
        let gone = Refusal::Gone;
        let why = format!("the homing for run {} could not be aborted: {gone}", run.scan_id);
        self.inner.campaign.estop(&why);
        tracing::error!(why, "the e-stop was pressed");
        self.say(run, "not_resumed", json!({ "why": format!("{why}; the e-stop was pressed") }))
            .await;
    }

    /// Waits until a person has taken an operator lock that refuses this run, which then must be started again. A store
    /// that does not answer ends no motion.
    async fn locked_meanwhile(&self, run: &RunRow, before: Unattended) -> ConductorError {
        loop {
            let locked = self.require_no_lock(run, before.since).await;
            if let Err(ConductorError::Refused(refusal)) = locked {
                let words = format!("{refusal}; the homing for the run has ended: start it again");
                return ConductorError::Forbidden(words);
            }
            tokio::time::sleep(HOMING_LOCK_POLL).await;
        }
    }

    /// Ends the homing for a run that is not driven any more.
    pub(super) fn end_bringing_up(&self, run: RunUid) {
        self.inner.brought_up.lock().take_if(|uid| *uid == run);
    }

    fn is_brought_up(&self, run: RunUid) -> bool {
        *self.inner.brought_up.lock() == Some(run)
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::AutoResume;
    use super::super::stand_in::{conductor, earlier, granted, unasked};
    use super::*;
    use crate::campaign::shown::show;
    use crate::state::StoredState;

    #[tokio::test]
    async fn the_homing_for_a_run_ends_if_a_person_operates_the_rig() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
        let operates = async {
            granted(&mut inbox, |request| matches!(request, Request::HomeForRun)).await;
            conductor.note_operation();
            granted(&mut inbox, |request| matches!(request, Request::Abort)).await;
        };
        let resumes = conductor.resume_after_restart(AutoResume::Allowed);
        let (taken, ()) = tokio::join!(resumes, operates);
        assert!(matches!(taken, Err(ConductorError::Forbidden(_))), "{taken:?}");
        let tries = conductor.inner.store.events_of_kinds(run.uid, &["not_resumed"], 9);
        assert_eq!(tries.await.unwrap().len(), 1, "it is not tried again");
    }

    #[tokio::test]
    async fn the_homing_for_a_run_ends_if_a_person_takes_the_lock() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [run, next] = earlier(&conductor).await;
        inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
        let locks = async {
            granted(&mut inbox, |request| matches!(request, Request::HomeForRun)).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
            conductor.inner.store.set_lock("bob", "hands in the rig").await.unwrap();
            granted(&mut inbox, |request| matches!(request, Request::Abort)).await;
        };
        let resumes = conductor.resume_after_restart(AutoResume::Allowed);
        let both = async { tokio::join!(resumes, locks) };
        let (taken, ()) = tokio::time::timeout(HOMING_WAIT / 2, both).await.expect("it ends");
        let words = taken.unwrap_err().to_string();
        assert!(words.starts_with("bob has taken the operator lock: hands in the rig"), "{words}");
        assert_eq!(conductor.present(&run).await.unwrap().state, StoredState::Interrupted);
        assert!(conductor.why_dropped(next.uid).is_some());
    }

    #[tokio::test]
    async fn a_homing_that_cannot_be_aborted_is_stopped_by_the_e_stop_and_an_event_states_it() {
        let (conductor, inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        let before = Unattended { since: Some(Timestamp::UNIX_EPOCH), signs: 0 };
        *conductor.inner.brought_up.lock() = Some(run.uid);
        inbox.status.send_modify(|status| {
            (status.rig.state, status.rig.motion) = (RigState::Disarmed, Some(Motion::Homing));
        });
        conductor.inner.store.set_lock("bob", "hands in the rig").await.unwrap();
        // It takes no request any more.
        drop(inbox);
        let watched = conductor.watch_homing(&run, before, Instant::now() + HOMING_WAIT).await;
        let words = watched.unwrap_err().to_string();
        assert!(words.starts_with("bob has taken the operator lock: hands in the rig"), "{words}");
        let press = conductor.inner.campaign.stop_switch().pressed().expect("it is pressed");
        let why = "the homing for run 1 could not be aborted: the rig's thread does not answer";
        assert_eq!(press.why, why);
        let noted = conductor.inner.store.events_of_kinds(run.uid, &["not_resumed"], 9);
        let noted = noted.await.unwrap();
        let words = format!("{why}; the e-stop was pressed");
        assert_eq!((noted.len(), noted[0].data["why"].as_str()), (1, Some(words.as_str())));
    }

    #[tokio::test]
    async fn no_e_stop_is_pressed_if_the_homing_has_ended_and_the_campaign_does_not_answer() {
        let (conductor, inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        // The tips may be raised.
        inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
        drop(inbox);
        conductor.end_homing(&run).await;
        assert!(conductor.inner.campaign.stop_switch().pressed().is_none());
    }

    #[tokio::test]
    async fn the_lock_is_watched_for_until_a_long_homing_ends() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        let before = Unattended { since: Some(Timestamp::UNIX_EPOCH), signs: 0 };
        *conductor.inner.brought_up.lock() = Some(run.uid);
        let deadline = Instant::now();
        // It has ended, and the rig is not homed.
        inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
        let late = conductor.watch_homing(&run, before, deadline).await.unwrap_err().to_string();
        assert!(late.starts_with("the rig was not homed within "), "{late}");
        inbox.status.send_modify(|status| status.rig.motion = Some(Motion::Homing));
        let locks = async {
            tokio::time::sleep(3 * HOMING_POLL).await;
            conductor.inner.store.set_lock("bob", "hands in the rig").await.unwrap();
            granted(&mut inbox, |request| matches!(request, Request::Abort)).await;
        };
        let both = async { tokio::join!(conductor.watch_homing(&run, before, deadline), locks) };
        let (watched, ()) = tokio::time::timeout(HOMING_WAIT / 2, both).await.expect("it ends");
        let words = watched.unwrap_err().to_string();
        assert!(words.starts_with("bob has taken the operator lock: hands in the rig"), "{words}");
    }

    #[tokio::test]
    async fn a_lock_that_is_taken_during_the_homing_aborts_no_other_run() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let [run, _next] = earlier(&conductor).await;
        let job = conductor.prepare_stored(&run).await.unwrap().job(&run);
        inbox.status.send_modify(|status| status.rig.state = RigState::Disarmed);
        let resumes = async {
            let resumes = conductor.resume_after_restart(AutoResume::Allowed);
            let begins = async {
                granted(&mut inbox, |request| matches!(request, Request::HomeForRun)).await;
                inbox.status.send_modify(|status| {
                    status.rig.state = RigState::Armed;
                    status.run = Some(show::started(&job));
                });
                conductor.inner.store.set_lock("bob", "hands in the rig").await.unwrap();
                unasked(&mut inbox, std::future::pending::<()>()).await;
            };
            tokio::select! {
                taken = resumes => taken,
                () = begins => unreachable!(),
            }
        };
        let taken = tokio::time::timeout(HOMING_WAIT / 2, resumes).await.expect("it ends");
        let words = taken.unwrap_err().to_string();
        assert!(words.starts_with("bob has taken the operator lock: hands in the rig"), "{words}");
    }
}
