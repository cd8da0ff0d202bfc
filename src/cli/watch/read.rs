//! Reads what the screen shows: the status five times per second, all else less often.
//! Uses: `client`, `night` (what it takes). Never: the terminal, a wait of the screen for an answer.

use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::answers::Tour;
use super::night::News;
use crate::api::{History, Page, RunProgress, SensorOut};
use crate::cli::client::Client;
use crate::cli::error::CliResult;
use crate::cli::view::EventView;
use crate::event::notable_kinds;
use crate::ids::RunUid;

/// Interval of polling the status.
const STATUS_READ: Duration = Duration::from_millis(200);
/// Interval of polling events.
const EVENTS_POLL: Duration = Duration::from_secs(1);
/// Interval of polling progress and twins.
const PROGRESS: Duration = Duration::from_secs(5);
/// Interval of polling the course of a run, which the service reads from all its trials.
const COURSE: Duration = Duration::from_secs(30);
/// Bins of a course, as the page asks for them: the service then reads it once for both.
const COURSE_BINS: u32 = 120;
/// Longest wait for an answer.
const WATCH_ANSWER_WAIT: Duration = Duration::from_secs(2);
/// Number of earlier events that are read first.
const EARLIER_EVENTS: i64 = 100;

/// Reads the status until the receiver is closed. `runs` receives the active run.
pub async fn follow_status(
    client: Client,
    runs: watch::Sender<Option<RunUid>>,
    news: mpsc::Sender<News>,
) {
    let client = client.patient(WATCH_ANSWER_WAIT);
    let mut tick = interval(STATUS_READ);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        let asked = Timestamp::now();
        let read = match client.status().await {
            Ok(status) => {
                let run = status.run.as_ref().map(|run| run.uid);
                runs.send_if_modified(|seen| run.is_some() && std::mem::replace(seen, run) != run);
                News::Status(asked, Box::new(status))
            }
            Err(error) => News::NoStatus(error.to_string()),
        };
        if news.send(read).await.is_err() {
            return;
        }
    }
}

/// Reads all else until the receiver is closed: the skin and the tour once per run.
pub async fn follow_rest(
    client: Client,
    runs: watch::Receiver<Option<RunUid>>,
    news: mpsc::Sender<News>,
) {
    let client = client.patient(WATCH_ANSWER_WAIT);
    let mut rest =
        Rest { client, news, run: None, skin: false, tour: false, course: None, since: None };
    let mut tick = interval(EVENTS_POLL);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut polled: Option<Instant> = None;
    while !rest.news.is_closed() {
        tick.tick().await;
        let run = *runs.borrow();
        let changed = run != rest.run;
        if changed {
            (rest.run, rest.skin, rest.tour, rest.course) = (run, false, false, None);
        }
        let due = changed || polled.is_none_or(|at| at.elapsed() >= PROGRESS);
        if due {
            polled = Some(Instant::now());
        }
        // What fails is read again; that the service is away, the status reports.
        if let Err(error) = rest.read(due).await {
            tracing::debug!(%error, "not all of the screen could be read");
        }
    }
}

/// What `follow_rest` has read.
struct Rest {
    client: Client,
    news: mpsc::Sender<News>,
    run: Option<RunUid>,
    skin: bool,
    tour: bool,
    /// When the course was asked for.
    course: Option<Instant>,
    /// Number of the last event.
    since: Option<i64>,
}

impl Rest {
    /// Reads the events, and if it is `due` all else.
    async fn read(&mut self, due: bool) -> CliResult<()> {
        self.events().await?;
        if !due {
            return Ok(());
        }
        if let Some(rates) = self.client.if_there("/api/v1/rig/rates").await? {
            self.tell(News::Rates(rates)).await;
        }
        let twins = self.client.get("/api/v1/twins").await?;
        self.tell(News::Twins(twins)).await;
        let Some(run) = self.run else { return Ok(()) };
        let path = format!("/api/v1/runs/{run}");
        if !self.tour {
            let tour: Option<Tour> = self.client.if_there(&format!("{path}/tour")).await?;
            self.tour = tour.is_some();
            self.tell(News::Tour(run, tour)).await;
        }
        if !self.skin {
            let skin: Option<SensorOut> =
                self.client.if_there(&format!("/api/v1/sensor?run={run}")).await?;
            self.skin = skin.is_some();
            self.tell(News::Skin(run, skin)).await;
        }
        let progress: Option<RunProgress> =
            self.client.if_there(&format!("{path}/progress")).await?;
        let Some(progress) = progress else { return Ok(()) };
        self.tell(News::Progress(run, progress)).await;
        if self.course.is_some_and(|at| at.elapsed() < COURSE) {
            return Ok(());
        }
        self.course = Some(Instant::now());
        let course: Option<History> =
            self.client.if_there(&format!("{path}/history?bins={COURSE_BINS}")).await?;
        if let Some(course) = course {
            self.tell(News::Course(run, course)).await;
        }
        Ok(())
    }

    async fn events(&mut self) -> CliResult<()> {
        let since = self.since.unwrap_or(-EARLIER_EVENTS);
        // Only kinds of which the screen shows some: what matters may be hours older than the newest event.
        let kinds = notable_kinds().chain(["state"]).collect::<Vec<_>>().join(",");
        let path = format!("/api/v1/events?since={since}&kind={kinds}");
        let page: Page<EventView> = self.client.get(&path).await?;
        if let Some(last) = page.items.last() {
            self.since = Some(last.seq);
            self.tell(News::Events(page.items)).await;
        }
        Ok(())
    }

    /// Tells the screen; one that has ended ends the reading.
    async fn tell(&self, news: News) {
        let _ = self.news.send(news).await;
    }
}
