//! The table of trials: one line per column. Filters, SQL, Arrow schemas, answers and the description
//! of the API follow from it.
//! PURE. Uses: `trial_row`. Never: a name that another list repeats.

use jiff::Timestamp;

use super::trial_row::TrialRow;

/// A column of the trials table.
#[derive(Debug)]
pub struct Column {
    /// Name in every format, filter and answer; it ends in the unit.
    pub name: &'static str,
    /// Unit; empty for counts, ratios, names and times.
    pub unit: &'static str,
    /// Type of the values, and the field of a stored trial that holds them.
    pub of: Of,
    /// SQL expression over the tables of `TrialQuery::ids`; empty if stored trials cannot be filtered
    /// by it.
    pub(crate) sql: &'static str,
    /// Meaning, for the description of the API and the manual.
    pub about: &'static str,
}

/// Type of a column, with the function that returns the value of a stored trial.
#[derive(Debug, Clone, Copy)]
pub enum Of {
    /// An integer (i64).
    Id(fn(&TrialRow) -> i64),
    /// A count (u32), or NULL.
    Count(fn(&TrialRow) -> Option<u32>),
    /// A small count (u8).
    Few(fn(&TrialRow) -> u8),
    /// A number (f64), or NULL.
    Number(fn(&TrialRow) -> Option<f64>),
    /// A number that tables store as f32, or NULL.
    Single(fn(&TrialRow) -> Option<f64>),
    /// A text, or NULL; compared only for equality.
    Text(fn(&TrialRow) -> Option<String>),
    /// A time (UTC, milliseconds), or NULL.
    Time(fn(&TrialRow) -> Option<Timestamp>),
    /// A number (u64) of Sim-Random; stored trials do not have it.
    Drawn,
    /// Part of a row of a dataset; stored trials do not have it.
    Part,
    /// List of contacts, each with x_mm, y_mm, force_n and diameter_mm.
    Contacts,
    /// Forces of arms 1 to 6, N.
    Forces,
    /// List of flags.
    Flags,
    /// Mean of the measured frames, V, injection-major.
    Measured(fn(&TrialRow) -> Option<&[f32]>),
    /// Frame of the newest twin, V, injection-major.
    Simulated(fn(&TrialRow) -> Option<&[f32]>),
}

/// Type of the values with which a filter compares a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Numbers in the unit of the column.
    Number,
    /// RFC 3339 times.
    Time,
    /// Words, only for equality.
    Word,
    /// None: the column holds lists or frames.
    List,
}

impl Column {
    /// Returns the column with this name.
    pub fn find(name: &str) -> Option<&'static Self> {
        TABLE.iter().find(|column| column.name == name)
    }

    /// Returns the type of the values with which a filter compares it.
    pub fn kind(&self) -> Kind {
        match self.of {
            Of::Id(_) | Of::Count(_) | Of::Few(_) | Of::Number(_) | Of::Single(_) | Of::Drawn => {
                Kind::Number
            }
            Of::Text(_) | Of::Part => Kind::Word,
            Of::Time(_) => Kind::Time,
            Of::Contacts | Of::Forces | Of::Flags | Of::Measured(_) | Of::Simulated(_) => {
                Kind::List
            }
        }
    }

    /// Whether stored trials have it; the others exist only in datasets.
    pub fn is_of_stored(&self) -> bool {
        !matches!(self.of, Of::Drawn | Of::Part)
    }

    /// Whether `trial_blocks` states between which values it is: directly, by the run or by the id.
    pub(crate) fn is_bounded(&self) -> bool {
        !self.sql.is_empty() && !self.sql.starts_with("m.")
    }

    /// Whether `trial_blocks` has its least and its largest value.
    pub(crate) fn has_bounds(&self) -> bool {
        self.is_bounded() && !self.sql.starts_with("r.") && self.name != "trial_id"
    }

    /// Whether it holds frames of voltages.
    pub fn is_frame(&self) -> bool {
        matches!(self.of, Of::Measured(_) | Of::Simulated(_))
    }
}

const fn c(
    name: &'static str,
    unit: &'static str,
    of: Of,
    sql: &'static str,
    about: &'static str,
) -> Column {
    Column { name, unit, of, sql, about }
}

/// All columns, in the order of every table.
#[rustfmt::skip]
pub static TABLE: [Column; 36] = [
    c("trial_id", "", Of::Id(|t| t.trial_id.0), "t.id", "number of the stored trial"),
    c("run", "", Of::Text(|t| Some(t.run.to_string())), "r.uid", "id of its run"),
    c("scan_id", "", Of::Id(|t| t.scan_id), "t.run", "number of its run"),
    c("seed", "", Of::Drawn, "", "seed that a simulated trial was drawn with (Sim-Random)"),
    c("index", "", Of::Drawn, "", "number of a simulated trial under its seed (Sim-Random)"),
    c("experiment", "", Of::Text(|t| Some(t.experiment.clone())), "r.experiment", "name of the experiment"),
    c("label", "", Of::Text(|t| Some(t.label.as_str().into())), "r.label", "`measured`, `virtual` or `simulated`"),
    c("configuration", "", Of::Count(|t| Some(t.configuration)), "t.configuration", "position of the configuration in the plan"),
    c("depth_index", "", Of::Count(|t| Some(t.depth_index)), "t.depth_index", "position of the depth in the configuration"),
    c("attempt", "", Of::Count(|t| Some(t.attempt)), "t.attempt", "which attempt it was, from 1"),
    c("depth_mm", "mm", Of::Number(|t| t.depth_mm), "t.depth_mm", "depth below the touch-off surface; absent for weights placed manually"),
    c("tips", "", Of::Few(|t| t.tips), "t.tips", "attached tips, or placed contacts"),
    c("contact_count", "", Of::Few(|t| t.contact_count), "t.contact_count", "number of contacts, by the deadband of the run or of the dataset"),
    c("max_force_n", "N", Of::Single(|t| t.max_force_n), "t.max_force_n", "largest raw force, also below the deadband"),
    c("contacts", "", Of::Contacts, "", "`x_mm`, `y_mm` from the corner of the skin, `force_n` and `diameter_mm` of each contact; empty: untouched"),
    c("forces_n", "N", Of::Forces, "", "raw forces of arms 1 to 6; null for an arm without a tip"),
    c("voltages_v", "V", Of::Measured(|t| t.voltages_v.as_deref()), "", "mean of the measured frames, injection-major: `v[28 k + j] = V_j - V_(j+1 mod 28)` with electrode k the sink"),
    c("sim_voltages_v", "V", Of::Simulated(|t| t.sim_voltages_v.as_deref()), "", "frame of the newest simulated twin, injection-major"),
    c("sim_model", "", Of::Text(|t| t.sim_model.clone()), "m.hash", "model of that twin"),
    c("rmse_v", "V", Of::Number(|t| t.rmse_v), "w.rmse_v", "root of the mean squared difference to that twin"),
    c("fvu", "", Of::Number(|t| t.fvu), "w.fvu", "fraction of variance unexplained by that twin (paper, Eq. 2)"),
    c("flags", "", Of::Flags, "", "possible faults: `unsettled`, `saturated_channels`, `injection_sum`, `dropped_frames`, `depth_missed`, `still_cell`, `silent_skin`, `doubted` (the skin contradicted a manual placement)"),
    c("saturated_channels", "", Of::Count(|t| t.quality.saturated_channels), "t.saturated_channels", "channels at the converter's end"),
    c("stuck_channels", "", Of::Count(|t| t.quality.stuck_channels), "t.stuck_channels", "channels with the same count in 12 consecutive trials"),
    c("missing_channels", "", Of::Count(|t| t.quality.missing_channels), "t.missing_channels", "channels without a value"),
    c("injection_sum_v", "V", Of::Number(|t| t.quality.injection_sum_v), "t.injection_sum_v", "largest sum over the voltages of an injection; zero up to noise"),
    c("dropped_packets", "", Of::Count(|t| t.quality.dropped_packets), "t.dropped_packets", "packets lost or garbled while the frames were read"),
    c("depth_error_mm", "mm", Of::Number(TrialRow::depth_error_mm), "(t.reached_z_mm - t.target_z_mm)", "measured z minus its target"),
    c("settle_ms", "ms", Of::Number(|t| t.settle_ms), "t.settle_ms", "time between the end of motion and the measurement, process clock"),
    c("overshoot_n", "N", Of::Number(|t| t.scalars.overshoot_n), "t.overshoot_n", "largest force while approaching and settling minus the measured one"),
    c("frame_count", "", Of::Count(|t| Some(t.frame_count)), "t.frame_count", "raw frames in the mean; 0 if an imported file does not state it"),
    c("started_at", "", Of::Time(|t| t.started_at), "t.started_at", "start of its motion"),
    c("measured_at", "", Of::Time(|t| t.measured_at), "t.measured_at", "time of its last frame"),
    c("imported_split", "", Of::Text(|t| t.imported_split.clone()), "t.imported_split", "part that the imported file states: `train`, `validation` or `test`"),
    c("imported_tag", "", Of::Text(|t| t.imported_tag.clone()), "t.imported_tag", "tag that the imported file states, such as a tip or a place"),
    c("split", "", Of::Part, "", "part of the dataset: `train`, `validation` or `test`"),
];

/// The columns by which runs are selected. No trial has a value of them: they are only compared.
#[rustfmt::skip]
pub static RUN_COLUMNS: [Column; 10] = [
    c("scan_id", "", Of::Number(|_| None), "r.scan_id", "number of the run"),
    c("experiment", "", Of::Text(|_| None), "r.experiment", "name of the experiment"),
    c("kind", "", Of::Text(|_| None), "r.kind", "`real-hex`, `real-random` or `imported`"),
    c("label", "", Of::Text(|_| None), "r.label", "`measured`, `virtual` or `simulated`"),
    c("state", "", Of::Text(|_| None), "r.state_read", "state of the run"),
    c("exit_status", "", Of::Text(|_| None), "r.exit_status", "how it ended"),
    c("submitted_by", "", Of::Text(|_| None), "r.submitted_by", "person or key that submitted it"),
    c("created_at", "", Of::Time(|_| None), "r.created_at", "when it was submitted"),
    c("started_at", "", Of::Time(|_| None), "r.started_at", "when it first left the queue"),
    c("ended_at", "", Of::Time(|_| None), "r.ended_at", "when it ended or was removed from the queue"),
];

/// Returns the names of the selected columns of trials, separated by commas, for messages and descriptions.
pub fn names(which: impl Fn(&Column) -> bool) -> String {
    names_of(&TABLE, which)
}

/// Returns the names of the selected columns of a table, separated by commas.
pub fn names_of(table: &[Column], which: impl Fn(&Column) -> bool) -> String {
    let names = table.iter().filter(|column| which(column)).map(|column| column.name);
    names.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::TrialScalars;

    #[test]
    fn every_scalar_of_a_trial_is_a_column() {
        for (name, _) in TrialScalars::default().columns() {
            let column = Column::find(name);
            assert!(matches!(column, Some(Column { of: Of::Number(_), .. })), "{name}: {column:?}");
            assert_eq!(column.unwrap().sql, format!("t.{name}"));
        }
    }
}
