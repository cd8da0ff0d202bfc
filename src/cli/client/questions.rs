//! Questions and requests that several commands send.
//! Uses: `client`. Never: a repetition; text for people.

use reqwest::Method;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::Client;
use crate::api::{Page, Summary};
use crate::cli::error::{CliError, CliResult};
use crate::cli::view::{EventView, StatusView};
use crate::ids::RunUid;
use crate::store::RunRow;

/// Entries per request: whole trials take about 2 kB each.
const PAGE_ENTRIES: usize = 500;

impl Client {
    /// Returns the status of rig, run and service.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn status(&self) -> CliResult<StatusView> {
        self.get("/api/v1/status").await
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
        let answer = self.send(Method::GET, path, None::<&Value>).await?;
        let text = answer.text().await;
        text.map_err(|source| CliError::Http { operation: format!("GET {path}"), source })
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

    /// Sends an action on the rig; `more` are its other fields.
    ///
    /// # Errors
    /// As [`Self::send`].
    pub async fn act_on_rig(&self, action: &str, more: Value) -> CliResult<()> {
        let body = self.body(action, more);
        self.send(Method::POST, "/api/v1/rig/actions", Some(&body)).await.map(|_| ())
    }
}
