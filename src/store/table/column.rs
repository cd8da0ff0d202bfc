//! The table of trials: one line per column. Filters, SQL, Arrow schemas, answers and the API's
//! description follow from it.
//! PURE. Uses: `store`'s rows. Never: a name that another list repeats.

use jiff::Timestamp;

use super::trial_row::TrialRow;

/// A column of the trials table.
#[derive(Debug)]
pub struct Column {
    /// The name in every format, filter and answer; ends in its unit.
    pub name: &'static str,
    /// Unit, empty where it has none.
    pub unit: &'static str,
    /// What it holds, and where a stored trial has it.
    pub of: Of,
    /// The value in SQL over the tables of `trial_query`; empty where stored trials cannot be compared by it.
    pub(crate) sql: &'static str,
    /// What it means, for the API's description and the manual.
    pub about: &'static str,
}

/// What a column holds, with the value of a stored trial.
#[derive(Debug, Clone, Copy)]
pub enum Of {
    /// A whole number (i64).
    Id(fn(&TrialRow) -> i64),
    /// A count (u32) that may be absent.
    Count(fn(&TrialRow) -> Option<u32>),
    /// A small count (u8).
    Few(fn(&TrialRow) -> u8),
    /// A number (f64) that may be absent.
    Number(fn(&TrialRow) -> Option<f64>),
    /// A number kept as f32 that may be absent.
    Single(fn(&TrialRow) -> Option<f64>),
    /// A text that may be absent; compared for equality alone.
    Text(fn(&TrialRow) -> Option<String>),
    /// A time (UTC, milliseconds) that may be absent.
    Time(fn(&TrialRow) -> Option<Timestamp>),
    /// A number (u64) that only Sim-Random has.
    Drawn,
    /// The part of a dataset's row.
    Part,
    /// Contacts: x_mm, y_mm, force_n, diameter_mm each.
    Contacts,
    /// One force per arm.
    Forces,
    /// Flags.
    Flags,
    /// A frame: the mean of the measured ones.
    Measured(fn(&TrialRow) -> Option<&[f32]>),
    /// A frame: that of the newest simulated twin.
    Simulated(fn(&TrialRow) -> Option<&[f32]>),
}

/// What a column can be compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Numbers in the column's unit.
    Number,
    /// RFC 3339 times.
    Time,
    /// Words, for equality alone.
    Word,
    /// Nothing: it holds a list or a frame.
    List,
}

impl Column {
    /// The column of this name.
    pub fn find(name: &str) -> Option<&'static Self> {
        TABLE.iter().find(|column| column.name == name)
    }

    /// What it can be compared with.
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

    /// False for columns that only rows of a dataset have.
    pub fn is_of_stored(&self) -> bool {
        !matches!(self.of, Of::Drawn | Of::Part)
    }

    /// True for frames of voltages.
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

/// Every column, in the order in which tables have them.
#[rustfmt::skip]
pub static TABLE: [Column; 34] = [
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
    c("contacts", "", Of::Contacts, "", "place, force and diameter of each contact"),
    c("forces_n", "N", Of::Forces, "", "raw forces of arms 1 to 6; absent where no tip is attached"),
    c("voltages_v", "V", Of::Measured(|t| t.voltages_v.as_deref()), "", "mean of the measured frames, injection-major"),
    c("sim_voltages_v", "V", Of::Simulated(|t| t.sim_voltages_v.as_deref()), "", "frame of the newest simulated twin, injection-major"),
    c("sim_model", "", Of::Text(|t| t.sim_model.clone()), "m.hash", "model of that twin"),
    c("rmse_v", "V", Of::Number(|t| t.rmse_v), "w.rmse_v", "root of the mean squared difference to that twin"),
    c("fvu", "", Of::Number(|t| t.fvu), "w.fvu", "fraction of variance unexplained by that twin (paper, Eq. 2)"),
    c("flags", "", Of::Flags, "", "what may be wrong with the trial"),
    c("saturated_channels", "", Of::Count(|t| t.quality.saturated_channels), "t.saturated_channels", "channels at the converter's end"),
    c("stuck_channels", "", Of::Count(|t| t.quality.stuck_channels), "t.stuck_channels", "channels with the same count in every trial"),
    c("missing_channels", "", Of::Count(|t| t.quality.missing_channels), "t.missing_channels", "channels without a value"),
    c("injection_sum_v", "V", Of::Number(|t| t.quality.injection_sum_v), "t.injection_sum_v", "largest sum over the voltages of an injection"),
    c("dropped_packets", "", Of::Count(|t| t.quality.dropped_packets), "t.dropped_packets", "packets lost or garbled while the frames were read"),
    c("depth_error_mm", "mm", Of::Number(TrialRow::depth_error_mm), "(t.reached_z_mm - t.target_z_mm)", "measured z minus its target"),
    c("settle_ms", "ms", Of::Number(|t| t.settle_ms), "t.settle_ms", "time between the end of motion and the measurement, process clock"),
    c("overshoot_n", "N", Of::Number(|t| t.overshoot_n), "t.overshoot_n", "largest force while approaching and settling minus the measured one"),
    c("frame_count", "", Of::Count(|t| Some(t.frame_count)), "t.frame_count", "raw frames kept"),
    c("started_at", "", Of::Time(|t| t.started_at), "t.started_at", "start of its motion"),
    c("measured_at", "", Of::Time(|t| t.measured_at), "t.measured_at", "time of its last frame"),
    c("split", "", Of::Part, "", "part of the dataset: `train`, `test` ..."),
];

/// The names of columns, for messages and descriptions.
pub fn names(which: impl Fn(&Column) -> bool) -> String {
    let names = TABLE.iter().filter(|column| which(column)).map(|column| column.name);
    names.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_manual_explains_every_column() {
        let manual = include_str!("../../../docs/how-to/datasets.md");
        for column in &TABLE {
            assert!(manual.contains(&format!("`{}`", column.name)), "{} is missing", column.name);
        }
    }
}
