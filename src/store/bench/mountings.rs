//! How many tips are mounted, as the person who mounts them says.
//! Uses: `store::writer`. Never: a judgement whether it is so (the campaign checks it by evidence).

use jiff::Timestamp;

use crate::core::columns::{Columns, time_text};
use crate::core::{During, Store, StoreError};
use crate::journal::Mounting;

impl Store {
    pub(crate) async fn insert_mounting(
        &self,
        mounting: &Mounting,
        at: Timestamp,
    ) -> Result<(), StoreError> {
        const OPERATION: &str = "storing how many tips are mounted";
        let (mounting, at) = (mounting.clone(), time_text(at));
        self.inner
            .writer
            .patient()
            .run(OPERATION, async move |connection| {
                sqlx::query(
                    "INSERT INTO mountings (tips, live_cells, who, at) VALUES (?1, ?2, ?3, ?4)",
                )
                .bind(mounting.tips)
                .bind(mounting.live_cells)
                .bind(mounting.who)
                .bind(at)
                .execute(connection)
                .await
                .during(OPERATION)?;
                Ok(())
            })
            .await
    }

    /// What was said last; absent where nobody has said anything yet.
    pub(crate) async fn read_last_mounted(&self) -> Result<Option<Mounting>, StoreError> {
        const OPERATION: &str = "reading how many tips are mounted";
        let row = sqlx::query("SELECT * FROM mountings ORDER BY id DESC LIMIT 1")
            .fetch_optional(&self.inner.readers)
            .await
            .during(OPERATION)?;
        row.map(|row| {
            let c = Columns::of(&row, OPERATION);
            let (tips, live_cells) = (c.whole("tips")?, c.whole("live_cells")?);
            Ok(Mounting { tips, live_cells, who: c.get("who")? })
        })
        .transpose()
    }
}
