//! A query for trials (which, in which order), and its SQL statement.
//! PURE. Uses: `condition`. Never: a connection, an OFFSET.

use super::condition::Condition;
use crate::core::bulk::Statement;
use crate::ids::{RunUid, TrialId};
use crate::record::Flag;

/// Largest number of trials of a page.
pub const MAX_PAGE: u32 = 10_000;

/// Columns of a row, with the fit of its newest twin.
pub(crate) const SELECT: &str = "SELECT t.*, w.rmse_v, w.fvu, m.hash AS sim_model
     FROM trials t LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
     LEFT JOIN twin_models m ON m.id = w.model";

/// The trials, block by block: of a block whose bounds exclude a condition none is read.
const OF_BLOCKS: &str = "SELECT t.id FROM trial_blocks b CROSS JOIN trials t
     ON t.id BETWEEN b.block << 10 AND (b.block << 10) + 1023";
/// A block has the ids whose other bits are equal: 1024.
const BLOCK_BITS: u32 = 10;

/// Joins of the tables that conditions may need in addition to `trials`.
const JOIN_RUN: &str = " CROSS JOIN runs r ON r.scan_id = t.run";
const JOIN_TWIN: &str = " LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)";
const JOIN_MODEL: &str = " LEFT JOIN twin_models m ON m.id = w.model";

/// Columns of a row, with the mean voltages and the frame of its newest twin. `CROSS JOIN` makes SQLite read
/// the trials in their order.
pub(crate) const SELECT_WITH_VOLTAGES: &str =
    "SELECT t.*, w.rmse_v, w.fvu, m.hash AS sim_model, v.voltages_v,
         v.crc32 AS volts_crc32, s.voltages_v AS sim_voltages_v, s.crc32 AS sim_volts_crc32
     FROM trials t CROSS JOIN trial_voltages v ON v.trial = t.id
     LEFT JOIN twins w ON w.trial = t.id
         AND w.model = (SELECT max(model) FROM twins n WHERE n.trial = t.id)
     LEFT JOIN twin_models m ON m.id = w.model
     LEFT JOIN twin_voltages s ON s.trial = t.id AND s.model = w.model";

/// Order of the trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// In the order in which they were stored.
    #[default]
    OldestFirst,
    /// In the reverse of the order in which they were stored.
    NewestFirst,
}

/// Selection of trials, and the size of a page.
#[derive(Debug, Clone, Default)]
pub struct TrialQuery {
    /// Only trials of this run.
    pub run: Option<RunUid>,
    /// Conditions, all of which must be met.
    pub filters: Vec<Condition>,
    /// Flags, all of which must be set.
    pub flags: Vec<Flag>,
    /// Only trials with a flag (true), or only trials without (false).
    pub flagged: Option<bool>,
    /// Cursor: last id of the previous page.
    pub after: Option<TrialId>,
    /// Order of the trials; the cursor follows it.
    pub order: Order,
    /// Largest number of trials of the page; at most [`MAX_PAGE`], and one more to see whether
    /// others follow.
    pub limit: u32,
    /// Whether the rows hold their voltages.
    pub with_voltages: bool,
}

impl TrialQuery {
    /// Returns the statement for the ids of these trials; `scan_id` is the number of `run`, `but` those of runs whose
    /// trials are not selected.
    pub(crate) fn ids(&self, scan_id: Option<i64>, but: &[i64]) -> Statement {
        let by_blocks = self.is_by_blocks();
        let mut query =
            Statement::new(if by_blocks { OF_BLOCKS } else { "SELECT t.id FROM trials t" });
        let needs = |table: &str| {
            let mut columns = self.filters.iter().flat_map(Condition::columns);
            columns.any(|column| column.sql.starts_with(table))
        };
        let model = needs("m.");
        if needs("r.") {
            query.push(JOIN_RUN);
        }
        if model || needs("w.") {
            query.push(JOIN_TWIN);
        }
        if model {
            query.push(JOIN_MODEL);
        }
        query.push(" WHERE TRUE");
        if by_blocks {
            self.push_blocks(scan_id, &mut query);
        }
        if let Some(scan_id) = scan_id {
            query.push(" AND t.run = ").bind(scan_id);
        }
        if !but.is_empty() {
            let but = format!("{but:?}");
            query.push(" AND t.run NOT IN (SELECT value FROM json_each(").bind(but).push("))");
        }
        if let Some(after) = self.after {
            let side = match self.order {
                Order::OldestFirst => " AND t.id > ",
                Order::NewestFirst => " AND t.id < ",
            };
            query.push(side).bind(after.0);
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
            let word = flag.as_str().to_owned();
            query.push(" AND EXISTS (SELECT 1 FROM json_each(t.flags) WHERE value = ");
            query.bind(word).push(")");
        }
        query.push(match (by_blocks, self.order) {
            (false, Order::OldestFirst) => " ORDER BY t.id LIMIT ",
            (false, Order::NewestFirst) => " ORDER BY t.id DESC LIMIT ",
            (true, Order::OldestFirst) => " ORDER BY b.block, t.id LIMIT ",
            (true, Order::NewestFirst) => " ORDER BY b.block DESC, t.id DESC LIMIT ",
        });
        query.bind(i64::from(self.limit.min(MAX_PAGE + 1)));
        query
    }

    /// Whether the bounds of blocks can exclude trials. Ids are found without them.
    fn is_by_blocks(&self) -> bool {
        let known = self.filters.iter().any(Condition::lists_ids);
        let bounded = self.filters.iter().any(Condition::is_bounded);
        !known && (bounded || self.flagged.is_some() || !self.flags.is_empty())
    }

    /// Appends what a block meets if it may hold a trial of the page.
    fn push_blocks(&self, scan_id: Option<i64>, query: &mut Statement) {
        if let Some(scan_id) = scan_id {
            query.push(" AND b.scan_id_least <= ").bind(scan_id);
            query.push(" AND b.scan_id_most >= ").bind(scan_id);
        }
        if let Some(after) = self.after {
            let side = match self.order {
                Order::OldestFirst => " AND b.block >= ",
                Order::NewestFirst => " AND b.block <= ",
            };
            query.push(side).bind(after.0 >> BLOCK_BITS);
        }
        for filter in &self.filters {
            filter.push_onto_blocks(query);
        }
        // Flags are a JSON array of words: every other array is less than the empty one.
        let is_flagged = self.flagged == Some(true) || !self.flags.is_empty();
        query.push(if is_flagged { " AND b.flags_least < '[]'" } else { "" });
        query.push(if self.flagged == Some(false) { " AND b.flags_most >= '[]'" } else { "" });
    }
}
