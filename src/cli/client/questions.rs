//! Questions and requests that several commands send.
//! Uses: `client`. Never: a repetition; text for people.

use jiff::Timestamp;
use reqwest::Method;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::Client;
use crate::api::{Page, Summary};
use crate::cli::error::{CliError, CliResult};
use crate::cli::view::{EventView, StatusView};
use crate::ids::RunUid;
use crate::store::RunRow;

/// Entries per request: whole trials take about 2 kB each.
const PAGE_ENTRIES: usize = 500;

/// Time of a status.
#[derive(Deserialize)]
struct StatusTime {
    /// Absent from an older service.
    at: Option<Timestamp>,
}

impl Client {
    /// Returns the status of rig, run and service.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn status(&self) -> CliResult<StatusView> {
        self.get("/api/v1/status").await
    }

    /// Returns the same client for an action upon the present status, as [`Self::acting_on`].
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn acting_now(&self) -> CliResult<Self> {
        let status: StatusTime = self.get("/api/v1/status").await?;
        Ok(self.acting_on(status.at))
    }

    /// Returns one run, by uid or scan_id.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn run(&self, run: impl std::fmt::Display) -> CliResult<RunRow> {
        self.get(&format!("/api/v1/runs/{run}")).await
    }

    /// Returns the summary of a run.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn summary(&self, run: RunUid) -> CliResult<Summary> {
        self.get(&format!("/api/v1/runs/{run}/summary")).await
    }

    /// Returns the events of a run after the event number `since`.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn events(&self, run: RunUid, since: i64) -> CliResult<Page<EventView>> {
        self.get(&format!("/api/v1/events?since={since}&run={run}")).await
    }

    /// Returns all entries of a list; `path` has its parameters, or none after `?`.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn all<T: DeserializeOwned>(&self, path: &str) -> CliResult<Vec<T>> {
        let (mut all, mut cursor) = (Vec::new(), String::new());
        loop {
            let page: Page<T> = self.get(&format!("{path}{cursor}")).await?;
            all.extend(page.items);
            let Some(next) = page.next else { return Ok(all) };
            cursor = format!("&cursor={next}");
        }
    }

    /// Returns the first entries of a list, at most `most`, and whether they are all; `path` has its
    /// parameters, or none after `?`.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn first<T: DeserializeOwned>(
        &self,
        path: &str,
        most: usize,
    ) -> CliResult<(Vec<T>, bool)> {
        let (mut found, mut cursor) = (Vec::new(), String::new());
        loop {
            let limit = (most - found.len()).clamp(1, PAGE_ENTRIES);
            let page: Page<T> = self.get(&format!("{path}&limit={limit}{cursor}")).await?;
            found.extend(page.items);
            let is_all = page.next.is_none() && found.len() <= most;
            found.truncate(most);
            match page.next {
                Some(next) if found.len() < most => cursor = format!("&cursor={next}"),
                _ => return Ok((found, is_all)),
            }
        }
    }

    /// Returns an answer that is a text.
    ///
    /// # Errors
    /// As [`Self::send`]; `CliError::Http` if the connection breaks.
    pub async fn text(&self, path: &str) -> CliResult<String> {
        Ok(self.send(Method::GET, path, None::<&Value>).await?.text().await?)
    }

    /// Returns an answer that the service may lack: 404 is `None`.
    ///
    /// # Errors
    /// As [`Self::send`], except 404.
    pub async fn if_there<T: DeserializeOwned>(&self, path: &str) -> CliResult<Option<T>> {
        match self.get(path).await {
            Ok(found) => Ok(Some(found)),
            Err(CliError::Refused { status: 404, .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the newest of all runs that `fits` accepts.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn find_run(&self, fits: impl Fn(&RunRow) -> bool) -> CliResult<Option<RunRow>> {
        let mut path = "/api/v1/runs?".to_owned();
        loop {
            let page: Page<RunRow> = self.get(&path).await?;
            if let Some(run) = page.items.into_iter().find(&fits) {
                return Ok(Some(run));
            }
            let Some(next) = page.next else { return Ok(None) };
            path = format!("/api/v1/runs?cursor={next}");
        }
    }

    /// Sends an action on a run; `more` are its other fields.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn act(&self, run: RunUid, action: &str, more: Value) -> CliResult<()> {
        let path = format!("/api/v1/runs/{run}/actions");
        self.send(Method::POST, &path, Some(&self.body(action, more))).await.map(|_| ())
    }

    /// Sends an action on the rig, upon the present status; `more` are its other fields.
    ///
    /// # Errors
    /// As [`Self::send`]; `CliError::Refused` also if it comes late.
    pub async fn act_on_rig(&self, action: &str, more: Value) -> CliResult<()> {
        let (client, body) = (self.acting_now().await?, self.body(action, more));
        client.send(Method::POST, "/api/v1/rig/actions", Some(&body)).await.map(|_| ())
    }

    /// Aborts a homing or a jog, however late it comes.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn abort_motion(&self, why: Option<&str>) -> CliResult<()> {
        let body = json!({ "who": self.who(), "why": why });
        self.send(Method::POST, "/api/v1/rig/abort", Some(&body)).await.map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use tokio::task::JoinHandle;

    use super::*;
    use crate::cli::repeat::tests::answers;

    /// The answer to every request.
    const STATUS_BODY: &str = "{\"at\":\"2026-11-26T21:00:00.123456789Z\"}";
    /// The header of an action upon that status.
    const STATED: &str = "status-at: 2026-11-26t21:00:00.123456789z";

    /// A service that answers this number of requests, one per connection; returns them in lower case.
    async fn service(requests: usize) -> (Client, JoinHandle<Vec<String>>) {
        let head = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: application/json";
        let length = STATUS_BODY.len();
        let answer = format!("{head}\r\ncontent-length: {length}\r\n\r\n{STATUS_BODY}");
        let (url, heard) = answers(vec![answer; requests]).await;
        (Client::new(&url, None, None).unwrap(), heard)
    }

    /// Whether each request states the status.
    fn stated(heard: &[String]) -> Vec<bool> {
        heard.iter().map(|request| request.contains(STATED)).collect()
    }

    #[tokio::test]
    async fn an_action_on_the_rig_states_the_status_that_was_read_before() {
        let (client, heard) = service(2).await;
        client.act_on_rig("home", json!({})).await.unwrap();
        let heard = heard.await.unwrap();
        assert!(heard[0].starts_with("get /api/v1/status ") && heard[1].contains("\"home\""));
        assert_eq!(stated(&heard), [false, true], "{heard:?}");
    }

    #[tokio::test]
    async fn what_continues_a_run_states_the_status_that_was_seen_and_a_stop_states_none() {
        let (client, heard) = service(6).await;
        let (run, at) = (RunUid::new(), "2026-11-26T21:00:00.123456789Z".parse().unwrap());
        client.acting_on(Some(at)).act(run, "resume", json!({})).await.unwrap();
        for action in ["pause", "stop", "abort"] {
            client.act(run, action, json!({})).await.unwrap();
        }
        client.post::<Value>("/api/v1/estop", &json!({})).await.unwrap();
        client.abort_motion(None).await.unwrap();
        let heard = heard.await.unwrap();
        assert_eq!(stated(&heard), [true, false, false, false, false, false], "{heard:?}");
    }
}
