//! How many tips are mounted, as the person who mounts them says.
//! Uses: `store::writer`. Never: a judgement whether it is so (the campaign checks it by evidence).

use jiff::Timestamp;

use super::columns::time_text;
use super::{Store, StoreError};

impl Store {
    pub(super) async fn insert_mounting(
        &self,
        tips: u8,
        who: &str,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        const OPERATION: &str = "storing how many tips are mounted";
        let (who, at) = (who.to_owned(), time_text(at));
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                sqlx::query("INSERT INTO mountings (tips, who, at) VALUES (?1, ?2, ?3)")
                    .bind(tips)
                    .bind(who)
                    .bind(at)
                    .execute(connection)
                    .await
                    .map_err(StoreError::sql(OPERATION))?;
                Ok(())
            })
            .await
    }

    /// What was said last; absent where nobody has said anything yet.
    pub(super) async fn read_last_mounted(&self) -> Result<Option<u8>, StoreError> {
        sqlx::query_scalar("SELECT tips FROM mountings ORDER BY id DESC LIMIT 1")
            .fetch_optional(&self.inner.readers)
            .await
            .map_err(StoreError::sql("reading how many tips are mounted"))
    }
}
