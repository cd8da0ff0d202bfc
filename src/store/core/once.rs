//! Requests that are carried out once: which began, and with which response they ended.
//! Uses: `core::writer`. Never: the meaning of a request; HTTP; a request forgotten by its age: the
//! wall clock may jump.

use jiff::Timestamp;
use sqlx::sqlite::SqliteConnection;

use super::columns::{Columns, row};
use super::{During, Store, StoreResult};

/// Removes all requests of the caller `?1` except the newest `?2`.
pub(crate) const KEEP_NEWEST: &str = "DELETE FROM requests_once WHERE id IN (
    SELECT id FROM requests_once WHERE caller = ?1 ORDER BY id DESC LIMIT -1 OFFSET ?2)";

/// Name of a request: the caller, and the key that it chose.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct OnceKey {
    /// Number of the API key; absent for callers without one.
    pub caller: Option<i64>,
    /// The key of the request.
    pub name: String,
}

impl OnceKey {
    fn caller(&self) -> i64 {
        self.caller.unwrap_or(0)
    }
}

/// A stored response.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OnceResponse {
    /// HTTP status that was sent.
    pub status: u16,
    /// Address of the new object; absent without one.
    pub location: Option<String>,
    /// Media type of the body; absent without a body.
    pub content_type: Option<String>,
    /// Bytes of the body; empty without one.
    pub body: Vec<u8>,
}

/// A request that began before.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OnceRow {
    /// sha256 of the request.
    pub request: String,
    /// Wall time at which it began.
    pub began_at: Timestamp,
    /// Its response; absent if none is stored.
    pub response: Option<OnceResponse>,
}

impl OnceRow {
    fn read(c: &Columns<'_>) -> StoreResult<Self> {
        let response = match c.get("status")? {
            Some(status) => {
                Some(row!(c, OnceResponse { status }, get: location, content_type, body))
            }
            None => None,
        };
        Ok(row!(c, Self { response }, get: request; time: began_at))
    }
}

impl Store {
    /// Stores that a request begins, and removes all except the newest `most` of its caller. If one with the same key
    /// began before, returns that one instead.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn begin_once(
        &self,
        key: &OnceKey,
        request: &str,
        most: u32,
    ) -> StoreResult<Option<OnceRow>> {
        const OPERATION: &str = "storing that a request begins";
        let (key, request, now) = (key.clone(), request.to_owned(), self.now_text());
        self.write(OPERATION, async move |connection| {
            let inserted = sqlx::query(
                "INSERT INTO requests_once (caller, name, request, began_at)
                 VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO NOTHING",
            )
            .bind(key.caller())
            .bind(&key.name)
            .bind(request)
            .bind(now)
            .execute(&mut *connection)
            .await
            .during(OPERATION)?;
            if inserted.rows_affected() == 0 {
                let row =
                    sqlx::query("SELECT * FROM requests_once WHERE caller = ?1 AND name = ?2")
                        .bind(key.caller())
                        .bind(&key.name)
                        .fetch_one(connection)
                        .await
                        .during(OPERATION)?;
                return OnceRow::read(&Columns::of(&row, OPERATION)).map(Some);
            }
            let surplus = sqlx::query(KEEP_NEWEST).bind(key.caller()).bind(most);
            surplus.execute(connection).await.during(OPERATION)?;
            Ok(None)
        })
        .await
    }

    /// Stores the response of a request that began; without one, removes the request.
    ///
    /// # Errors
    /// `Sql`, `Late` or `Closed` if the write fails.
    pub async fn end_once(&self, key: &OnceKey, response: Option<OnceResponse>) -> StoreResult<()> {
        const OPERATION: &str = "storing the response of a request";
        let key = key.clone();
        self.write(OPERATION, async move |connection| {
            let statement = match response {
                Some(response) => sqlx::query(
                    "UPDATE requests_once
                     SET status = ?3, location = ?4, content_type = ?5, body = ?6
                     WHERE caller = ?1 AND name = ?2",
                )
                .bind(key.caller())
                .bind(&key.name)
                .bind(response.status)
                .bind(response.location)
                .bind(response.content_type)
                .bind(response.body),
                None => sqlx::query("DELETE FROM requests_once WHERE caller = ?1 AND name = ?2")
                    .bind(key.caller())
                    .bind(&key.name),
            };
            statement.execute(connection).await.map(drop).during(OPERATION)
        })
        .await
    }
}

/// Removes the requests of an API key that is not valid any more.
pub(super) async fn forget_caller(
    connection: &mut SqliteConnection,
    key_id: i64,
) -> Result<(), sqlx::Error> {
    let forget = sqlx::query("DELETE FROM requests_once WHERE caller = ?1").bind(key_id);
    forget.execute(connection).await.map(drop)
}
