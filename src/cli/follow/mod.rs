//! Follows a run to its end, and carries out what Ctrl-C and a closed terminal mean to the run (`leave`).
//! Uses: `client`, `screen`. Never: decisions for the run (it is requested, and then observed).

mod screen;

use std::time::Duration;

use jiff::Timestamp;
use serde_json::json;
use tokio::time::{Instant, MissedTickBehavior, interval};

use self::screen::Screen;
use super::asking::Asking;
use super::client::Client;
use super::error::{CliError, CliResult};
use super::leave::{
    Choice, Interrupt, QUESTION_ON_PAUSED_RUN, QUESTION_ON_RUN, QUESTION_ON_WAITING_RUN,
};
use super::output::say_json;
use super::signals::{Asked, Signals};
use crate::campaign::shown::status::RunStatus;
use crate::ids::RunUid;
use crate::state::StoredState;

/// Interval of polling the status.
const STATUS_POLL: Duration = Duration::from_millis(200);
/// Time without an answer after which the service counts as ended.
const SILENT_MAX: Duration = Duration::from_secs(15);
/// Longest wait for a started run to appear in the status.
const TAKEN_UP: Duration = Duration::from_secs(30);

/// The reason of each action.
const WHY: &str = "Ctrl-C at the command line";
/// Reason to leave a run that waited for its turn.
const NOT_BEGUN: &str = "it does not begin by itself any more: start it again";
/// What a stop is answered with.
const STOPPING: &str = "stopping after this trial; Ctrl-C again aborts";

/// How following ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Left {
    /// The run has ended.
    Ended,
    /// The service continues the run, and this program ends.
    Detached,
    /// The run is open and not driven, or this program leaves it; with the reason.
    Open(&'static str),
}

/// Run to follow, and mode of output.
#[derive(Debug, Clone, Copy)]
pub struct Watch {
    /// Id of the started run.
    pub run: RunUid,
    /// Number of the last event that was already shown.
    pub since: i64,
    /// Whether it waits behind another run.
    pub waiting: bool,
    /// Print one line per event on standard output, for scripts.
    pub json: bool,
    /// Whether the virtual operator handles requests of the run.
    pub by_itself: bool,
    /// Whether the service ends with this program, unless the run is detached.
    pub own_service: bool,
    /// Longest wait for a person, after which the run is aborted.
    pub patience: Option<Duration>,
}

/// Follows one run.
pub struct Follower {
    client: Client,
    watch: Watch,
    screen: Screen,
    started: Instant,
    seen: bool,
    /// Interrupts since the last answer.
    interrupts: u32,
    asking: Asking,
    /// State in which the run was seen last.
    state: Option<StoredState>,
    /// Time of the newest status, and of the one before the question.
    status_at: Option<Timestamp>,
    asked_on: Option<Timestamp>,
    /// Time since which the run waits for a person.
    waits: Option<Instant>,
}

impl Follower {
    /// Follower of a started run.
    pub fn new(client: Client, watch: Watch) -> Self {
        let screen = Screen::new(watch.json, client.url());
        let started = Instant::now();
        Self {
            client,
            watch,
            screen,
            started,
            seen: false,
            interrupts: 0,
            asking: Asking::default(),
            state: None,
            status_at: None,
            asked_on: None,
            waits: None,
        }
    }

    /// Follows the run until it has ended, or is left.
    ///
    /// # Errors
    /// `CliError` if the service does not answer, or the run does not start.
    pub async fn follow(mut self, signals: &mut Signals) -> CliResult<Left> {
        let mut tick = interval(STATUS_POLL);
        tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut heard = Instant::now();
        loop {
            let left = tokio::select! {
                _ = tick.tick() => None,
                asked = signals.next() => self.asked(asked).await,
                line = self.asking.answer() => self.chosen(&line).await,
            };
            if let Some(left) = left {
                return Ok(left);
            }
            match self.look().await {
                Ok(None) => heard = Instant::now(),
                Ok(Some(left)) => return Ok(left),
                Err(error @ CliError::Late { .. }) => return Err(error),
                Err(error) if heard.elapsed() > SILENT_MAX => return Err(error),
                Err(error) => tracing::warn!(%error, "the service did not answer"),
            }
        }
    }

    async fn look(&mut self) -> CliResult<Option<Left>> {
        self.tell_events().await?;
        let status = self.client.status().await?;
        self.status_at = status.at;
        if let Some(run) = status.run.as_ref().filter(|r| r.uid == self.watch.run) {
            self.seen = true;
            self.state = Some(run.state);
            self.screen.progress(run, &status);
            self.be_patient(run).await?;
            return Ok(None);
        }
        let row = self.client.run(self.watch.run).await?;
        // A stopped run that is to be resumed has ended until its turn comes.
        let waits = self.waits_for_turn() && row.waiting_since.is_some();
        let left = match row.state {
            StoredState::Ended | StoredState::Removed if !waits => Some(Left::Ended),
            StoredState::Interrupted if self.seen => {
                Some(Left::Open("the service stopped driving it"))
            }
            // A person took its start back, or an event states why it does not begin.
            StoredState::Queued | StoredState::Interrupted if self.waits_for_turn() && !waits => {
                Some(Left::Open(NOT_BEGUN))
            }
            _ if self.seen || self.watch.waiting => None,
            _ if self.started.elapsed() > TAKEN_UP => {
                let what = format!("the start of run {} ({})", row.scan_id, row.state);
                return Err(CliError::Late { what, after_s: TAKEN_UP.as_secs() });
            }
            _ => None,
        };
        if left.is_some() {
            self.tell_events().await?;
        } else if self.waits_for_turn() {
            self.screen.waits_in_queue(row.queue_position);
        }
        Ok(left)
    }

    async fn tell_events(&mut self) -> CliResult<()> {
        loop {
            let page = self.client.events(self.watch.run, self.watch.since).await?;
            let Some(last) = page.items.last() else { return Ok(()) };
            self.watch.since = last.seq;
            for event in page.items {
                if self.watch.json {
                    say_json(&event);
                }
                // Actions of the virtual operator are not shown.
                let kind = event.kind.as_str();
                let by_operator = matches!(kind, "wanted" | "tips" | "placed");
                // The end is shown by the summary.
                let routine = kind == "ended" || self.watch.by_itself && by_operator;
                if let Some(words) = event.words().filter(|_| !routine) {
                    self.screen.note(&words);
                }
                if event.kind == "trip" {
                    let at = format!("--url {}", self.client.url());
                    self.screen.note(&format!(
                        "  if it does not resume automatically: palpate rig reset {at}; palpate rig home {at}; \
                         palpate resume {at}; or Ctrl-C to end"
                    ));
                }
            }
        }
    }

    /// Aborts a run that has waited too long for a person.
    async fn be_patient(&mut self, run: &RunStatus) -> CliResult<()> {
        if run.waiting_for.is_none() {
            self.waits = None;
            return Ok(());
        }
        let since = *self.waits.get_or_insert_with(Instant::now);
        if self.watch.patience.is_some_and(|most| since.elapsed() > most) {
            self.waits = None;
            self.screen.note("no person confirmed within --patience: aborting");
            let why = json!({ "why": "no person confirmed within --patience" });
            self.client.act(self.watch.run, "abort", why).await?;
        }
        Ok(())
    }

    /// A closed terminal leaves the run to the service. An interrupt asks what to do, or stops without a
    /// terminal; the second one aborts, the third one leaves the run as it is.
    async fn asked(&mut self, asked: Asked) -> Option<Left> {
        match asked {
            Asked::HangUp => return Some(Left::Detached),
            Asked::Terminate if self.watch.own_service => {
                return Some(Left::Open("this program received a signal to end"));
            }
            Asked::Terminate => return Some(Left::Detached),
            Asked::Interrupt => self.interrupts += 1,
        }
        match Interrupt::of(self.interrupts, Asking::is_possible()) {
            Interrupt::Ask => self.ask(),
            Interrupt::Stop => return self.halt("stop", STOPPING).await,
            Interrupt::Abort => {
                self.asking.close();
                let words = "aborting: raising the tips now; Ctrl-C again leaves";
                return self.halt("abort", words).await;
            }
            Interrupt::Leave => return Some(Left::Open("left at the third Ctrl-C")),
        }
        None
    }

    /// Asks at the terminal what to do; the answer arrives later.
    fn ask(&mut self) {
        self.screen.note(match self.state {
            _ if self.waits_for_turn() => QUESTION_ON_WAITING_RUN,
            Some(StoredState::Paused) => QUESTION_ON_PAUSED_RUN,
            _ => QUESTION_ON_RUN,
        });
        self.asked_on = self.status_at;
        self.asking.open();
    }

    /// Does what a person has chosen.
    async fn chosen(&mut self, line: &str) -> Option<Left> {
        let Some(choice) = Choice::of(line) else {
            self.ask();
            return None;
        };
        self.interrupts = u32::from(choice == Choice::Stop);
        match choice {
            Choice::Detach => return Some(Left::Detached),
            Choice::Continue => {}
            Choice::Pause => {
                self.request(&self.client, "pause", "pausing after this trial").await;
            }
            // It is refused if the answer comes late: a person may be at the rig.
            Choice::Resume => {
                let client = self.client.acting_on(self.asked_on);
                self.request(&client, "resume", "resuming").await;
            }
            Choice::Stop => return self.halt("stop", STOPPING).await,
        }
        None
    }

    fn waits_for_turn(&self) -> bool {
        self.watch.waiting && !self.seen
    }

    /// Takes a run that waits for its turn out of the queue, or takes back the start of a stopped one that is to be
    /// resumed; stops or aborts any other one.
    async fn halt(&self, action: &str, words: &str) -> Option<Left> {
        let run = self.watch.run;
        if self.waits_for_turn() {
            // It is refused if the turn has come, or if the run is one that resumes.
            if self.client.delete(&format!("/api/v1/queue/{run}")).await.is_ok() {
                return Some(Left::Open("taken out of the queue"));
            }
            let row = self.client.run(run).await;
            let resumes =
                row.is_ok_and(|row| row.state == StoredState::Ended && row.waiting_since.is_some());
            if resumes && self.client.act(run, "abort", json!({ "why": WHY })).await.is_ok() {
                self.screen.note("its start is taken back: it stays stopped");
                return Some(Left::Open("its start was taken back"));
            }
        }
        self.request(&self.client, action, words).await;
        None
    }

    async fn request(&self, client: &Client, action: &str, words: &str) {
        self.screen.note(words);
        if let Err(error) = client.act(self.watch.run, action, json!({ "why": WHY })).await {
            self.screen.note(&error.to_string());
        }
    }
}
