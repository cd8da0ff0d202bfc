//! Which trials, in which order: a query and the statement that it becomes.
//! Uses: `store::condition`, sqlx's builder. Never: a connection, an OFFSET.

use sqlx::{QueryBuilder, Sqlite};

use super::condition::Condition;
use crate::ids::{RunUid, TrialId};
use crate::record::Flag;

/// The largest page.
pub const MAX_PAGE: u32 = 10_000;

/// What a row is made of, with the fit of its newest twin; `CROSS JOIN` keeps SQLite walking the
/// trials in their order.
pub(crate) const SELECT: &str = "SELECT t.*, r.uid, r.experiment, r.kind, r.label, r.deadband_n,
         r.tip_diameter_mm, w.rmse_v, w.fvu, m.hash AS sim_model
     FROM trials t CROSS JOIN runs r ON r.scan_id = t.run
     LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
     LEFT JOIN twin_models m ON m.id = w.model";

/// The ids alone.
pub(crate) const SELECT_IDS: &str =
    "SELECT t.id FROM trials t CROSS JOIN runs r ON r.scan_id = t.run
     LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
     LEFT JOIN twin_models m ON m.id = w.model";

/// The same with the mean voltages and the twin's.
pub(crate) const SELECT_WITH_VOLTAGES: &str =
    "SELECT t.*, r.uid, r.experiment, r.kind, r.label, r.deadband_n,
         r.tip_diameter_mm, w.rmse_v, w.fvu, m.hash AS sim_model, v.voltages_v,
         v.crc32 AS volts_crc32, s.voltages_v AS sim_voltages_v, s.crc32 AS sim_volts_crc32
     FROM trials t CROSS JOIN runs r ON r.scan_id = t.run
     CROSS JOIN trial_voltages v ON v.trial = t.id
     LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
     LEFT JOIN twin_models m ON m.id = w.model
     LEFT JOIN twin_voltages s ON s.trial = t.id AND s.model = w.model";

/// In which order trials come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// As they were stored.
    #[default]
    OldestFirst,
    /// The last one first.
    NewestFirst,
}

/// Which trials.
#[derive(Debug, Clone, Default)]
pub struct TrialQuery {
    /// Of this run only.
    pub run: Option<RunUid>,
    /// All of these hold.
    pub filters: Vec<Condition>,
    /// All of these flags are set.
    pub flags: Vec<Flag>,
    /// Only with, or only without, any flag.
    pub flagged: Option<bool>,
    /// The cursor: the last id of the page before.
    pub after: Option<TrialId>,
    /// The order, which the cursor follows.
    pub order: Order,
    /// Up to so many, at most [`MAX_PAGE`].
    pub limit: u32,
    /// Bring the mean voltages along.
    pub with_voltages: bool,
}

impl TrialQuery {
    /// The statement that brings these trials' rows.
    pub(crate) fn build(&self, scan_id: Option<i64>) -> QueryBuilder<Sqlite> {
        self.select(if self.with_voltages { SELECT_WITH_VOLTAGES } else { SELECT }, scan_id)
    }

    /// The statement that brings `select` of these trials.
    pub(crate) fn select(
        &self,
        select: &'static str,
        scan_id: Option<i64>,
    ) -> QueryBuilder<Sqlite> {
        let mut query = QueryBuilder::new(select);
        query.push(" WHERE TRUE");
        if let Some(scan_id) = scan_id {
            query.push(" AND t.run = ").push_bind(scan_id);
        }
        if let Some(after) = self.after {
            let side = match self.order {
                Order::OldestFirst => " AND t.id > ",
                Order::NewestFirst => " AND t.id < ",
            };
            query.push(side).push_bind(after.0);
        }
        for filter in &self.filters {
            filter.push_onto(&mut query);
        }
        match self.flagged {
            Some(true) => drop(query.push(" AND t.flags <> '[]'")),
            Some(false) => drop(query.push(" AND t.flags = '[]'")),
            None => {}
        }
        for flag in &self.flags {
            let word = serde_json::to_value(flag).unwrap_or_default();
            query.push(" AND EXISTS (SELECT 1 FROM json_each(t.flags) WHERE value = ");
            query.push_bind(word.as_str().unwrap_or_default().to_owned()).push(")");
        }
        query.push(match self.order {
            Order::OldestFirst => " ORDER BY t.id LIMIT ",
            Order::NewestFirst => " ORDER BY t.id DESC LIMIT ",
        });
        query.push_bind(i64::from(self.limit.min(MAX_PAGE)));
        query
    }
}
