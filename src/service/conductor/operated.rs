//! A person at the rig, as far as it is known when a run begins: signs, the operator lock, the stored actions.
//! Uses: `campaign` (its status, the names of the actions, how a run begins), `store`.
//! Never: motion, HTTP, a delay of a stop.

use jiff::{SignedDuration, Timestamp};
use tokio::time::Instant;

use super::{Conductor, ConductorError, ConductorResult, locked};
use crate::campaign::run::job::Beginning;
use crate::campaign::shown::rig_action::RigAction;
use crate::campaign::shown::run_action::ActionOnRun;
use crate::store::StoreResult;

/// A person who operated the rig at most this long before a run of an earlier process did something last may still be
/// at it, wall time.
const OPERATED_BEFORE_END: SignedDuration = SignedDuration::from_secs(600);

impl Conductor {
    /// Refuses what was requested before the last sign of a person; `signs`: their number then.
    pub(super) fn require_no_sign(&self, signs: u64) -> ConductorResult<()> {
        let attended = self.inner.campaign.status().attended;
        match attended.signs == signs {
            true => Ok(()),
            false => Err(ConductorError::Forbidden(format!("{}: start it again", attended.why))),
        }
    }

    /// Refuses a start if a person may have come to the rig since it was requested: there was a sign of one, or
    /// another person has taken the operator lock. `by`: who starts it, as the holder of a lock is named.
    pub(super) async fn require_no_person(&self, signs: u64, by: &str) -> ConductorResult<()> {
        let lock = self.inner.store.lock().await?;
        self.require_no_sign(signs)?;
        lock.filter(|lock| lock.holder != by).map_or(Ok(()), |lock| Err(locked(&lock)))
    }

    /// How a run begins that no person starts now: with the time at which a person operated the rig last, in this
    /// process or an earlier one, and started or resumed no run since.
    pub(super) async fn unasked(&self) -> StoreResult<Beginning> {
        Ok(Beginning::Unasked { operated: self.last_operated().await?.map(instant_of) })
    }

    /// Refuses to drive a run of an earlier process again if a person operated the rig after it did something last, or
    /// shortly before, and started or resumed no run since. `since`: when it did something last; none if it was not
    /// driven.
    pub(super) async fn require_left_alone(&self, since: Option<Timestamp>) -> ConductorResult<()> {
        let Some(since) = since else { return Ok(()) };
        let operated = self.last_operated().await?;
        match operated.filter(|at| since.duration_since(*at) <= OPERATED_BEFORE_END) {
            None => Ok(()),
            Some(at) => Err(ConductorError::Forbidden(format!(
                "a person operated the rig at {at:.0}, shortly before the service ended or after it: start the run"
            ))),
        }
    }

    /// Wall time at which a person operated the rig last, unless a person started or resumed a run since, as far as it
    /// is stored.
    async fn last_operated(&self) -> StoreResult<Option<Timestamp>> {
        let operations: Vec<&str> = RigAction::ALL.iter().map(|action| action.as_str()).collect();
        let handovers = [ActionOnRun::Start, ActionOnRun::Resume, ActionOnRun::Confirm]
            .map(ActionOnRun::as_str);
        self.inner.store.last_operated(&operations, &handovers).await
    }
}

/// The process time of a wall time that has passed; now if it has not, since the clock was set back.
fn instant_of(at: Timestamp) -> Instant {
    let age = Timestamp::now().duration_since(at).max(SignedDuration::ZERO).unsigned_abs();
    let now = Instant::now();
    now.checked_sub(age).unwrap_or(now)
}

#[cfg(test)]
mod tests {
    use super::super::stand_in::{asked, conductor, earlier, queued_on, unasked};
    use super::super::{AutoResume, Terms};
    use super::*;
    use crate::campaign::shown::command::{Envelope, Inbox, Refusal, Request};
    use crate::store::{NewAction, RunRow};

    /// A person requests this; it is logged as accepted or refused.
    async fn log(conductor: &Conductor, action: &str, minutes_ago: i64, accepted: bool) {
        let at = Timestamp::now() - SignedDuration::from_mins(minutes_ago);
        let (action, who) = (action.into(), "ada".into());
        let (run, key_id, why, detail) = (None, None, None, None);
        let new = NewAction { at, run, action, who, key_id, why, accepted, detail };
        conductor.inner.store.log_action(new).await.unwrap();
    }

    /// How the campaign is told that this run begins.
    async fn beginning(
        conductor: &Conductor,
        inbox: &mut Inbox,
        run: &RunRow,
        by_person: bool,
    ) -> Beginning {
        let told = async {
            let Envelope { request, answer, .. } = inbox.next().await.expect("a request");
            let Request::Start(job) = request else { panic!("{request:?}") };
            let _ = answer.send(Err(Refusal::Busy("no".into())));
            job.beginning
        };
        let begins = conductor.begin(run, by_person, async { Ok(()) });
        let (refused, beginning) = tokio::join!(begins, told);
        assert!(refused.is_err());
        beginning
    }

    /// The time since the last operation that the campaign is told of, min.
    fn minutes(beginning: Beginning) -> Option<u64> {
        let Beginning::Unasked { operated } = beginning else { panic!("{beginning:?}") };
        operated.map(|at| at.elapsed().as_secs() / 60)
    }

    #[tokio::test]
    async fn a_run_that_begins_by_itself_knows_when_a_person_operated_the_rig_before() {
        let (conductor, mut inbox, _folder) = conductor().await;
        let run = queued_on(&conductor, Terms::default()).await;
        let unasked = beginning(&conductor, &mut inbox, &run, false).await;
        assert_eq!(minutes(unasked), None);
        // As an earlier process has stored it: an action is stored in the order of the requests.
        log(&conductor, "start", 9, true).await;
        log(&conductor, "home", 7, false).await;
        let unasked = beginning(&conductor, &mut inbox, &run, false).await;
        assert_eq!(minutes(unasked), Some(7));
        let by_person = beginning(&conductor, &mut inbox, &run, true).await;
        assert_eq!(by_person, Beginning::OfPerson);
        log(&conductor, "resume", 5, true).await;
        let unasked = beginning(&conductor, &mut inbox, &run, false).await;
        assert_eq!(minutes(unasked), None);
    }

    #[tokio::test]
    async fn an_operation_after_which_the_clock_was_set_back_has_just_been() {
        let (conductor, _inbox, _folder) = conductor().await;
        log(&conductor, "jog", -60, true).await;
        let beginning = conductor.unasked().await.unwrap();
        assert_eq!(minutes(beginning), Some(0));
    }

    #[tokio::test]
    async fn a_run_is_not_driven_again_if_a_person_operated_the_rig_shortly_before_its_end() {
        for (minutes_ago, is_driven) in [(5, false), (20, true)] {
            let (conductor, mut inbox, _folder) = conductor().await;
            let [_run, next] = earlier(&conductor).await;
            log(&conductor, "home", minutes_ago, false).await;
            let taken = conductor.resume_after_restart(AutoResume::Allowed);
            if is_driven {
                tokio::select! {
                    taken = taken => panic!("{taken:?}"),
                    _ = asked(&mut inbox, |request| matches!(request, Request::Connect)) => {}
                }
                continue;
            }
            let refused = unasked(&mut inbox, taken).await.unwrap_err();
            assert!(refused.to_string().contains("a person operated the rig at"), "{refused}");
            assert!(conductor.why_dropped(next.uid).is_some());
        }
    }
}
