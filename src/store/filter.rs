//! Filters over the trials table: closed lists of columns and comparisons, so that no text of a
//! request becomes SQL.
//! Uses: sqlx's query builder. Never: HTTP.

use jiff::Timestamp;
use sqlx::{QueryBuilder, Sqlite};

use super::columns::time_text;

/// A column that trials can be filtered by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrialColumn {
    /// The trial's id.
    TrialId,
    /// Position of the configuration in the plan.
    Configuration,
    /// Position of the depth in the configuration.
    DepthIndex,
    /// Depth, mm.
    DepthMm,
    /// The run's number for people.
    ScanId,
    /// Attached tips, or placed contacts.
    Tips,
    /// Contacts, by the run's deadband.
    ContactCount,
    /// Largest raw force, N.
    MaxForceN,
    /// Overshoot, N.
    OvershootN,
    /// Settling time, process ms.
    SettleMs,
    /// Which try it was.
    Attempt,
    /// Channels at the converter's end.
    SaturatedChannels,
    /// Channels with one and the same count, trial after trial.
    StuckChannels,
    /// Channels without a value.
    MissingChannels,
    /// Largest sum over an injection, V.
    InjectionSumV,
    /// Packets lost or garbled.
    DroppedPackets,
    /// Raw frames kept.
    FrameCount,
    /// Start of its motion.
    StartedAt,
    /// Its last frame.
    MeasuredAt,
    /// Difference to its newest twin, V.
    RmseV,
    /// Fraction of variance unexplained by its newest twin.
    Fvu,
}

impl TrialColumn {
    /// All of them.
    pub const ALL: [Self; 21] = [
        Self::TrialId,
        Self::Configuration,
        Self::DepthIndex,
        Self::DepthMm,
        Self::ScanId,
        Self::Tips,
        Self::ContactCount,
        Self::MaxForceN,
        Self::OvershootN,
        Self::SettleMs,
        Self::Attempt,
        Self::SaturatedChannels,
        Self::StuckChannels,
        Self::MissingChannels,
        Self::InjectionSumV,
        Self::DroppedPackets,
        Self::FrameCount,
        Self::StartedAt,
        Self::MeasuredAt,
        Self::RmseV,
        Self::Fvu,
    ];

    /// Its name in answers and in filters.
    pub fn name(self) -> &'static str {
        match self {
            Self::TrialId => "trial_id",
            Self::Configuration => "configuration",
            Self::DepthIndex => "depth_index",
            Self::DepthMm => "depth_mm",
            Self::ScanId => "scan_id",
            Self::Tips => "tips",
            Self::ContactCount => "contact_count",
            Self::MaxForceN => "max_force_n",
            Self::OvershootN => "overshoot_n",
            Self::SettleMs => "settle_ms",
            Self::Attempt => "attempt",
            Self::SaturatedChannels => "saturated_channels",
            Self::StuckChannels => "stuck_channels",
            Self::MissingChannels => "missing_channels",
            Self::InjectionSumV => "injection_sum_v",
            Self::DroppedPackets => "dropped_packets",
            Self::FrameCount => "frame_count",
            Self::StartedAt => "started_at",
            Self::MeasuredAt => "measured_at",
            Self::RmseV => "rmse_v",
            Self::Fvu => "fvu",
        }
    }

    /// The column of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name() == name)
    }

    /// True for columns that hold times; the others hold numbers.
    pub fn is_time(self) -> bool {
        matches!(self, Self::StartedAt | Self::MeasuredAt)
    }

    fn sql(self) -> &'static str {
        match self {
            Self::TrialId => "t.id",
            Self::Configuration => "t.configuration",
            Self::DepthIndex => "t.depth_index",
            Self::DepthMm => "t.depth_mm",
            Self::ScanId => "t.run",
            Self::Tips => "t.tips",
            Self::ContactCount => "t.contact_count",
            Self::MaxForceN => "t.max_force_n",
            Self::OvershootN => "t.overshoot_n",
            Self::SettleMs => "t.settle_ms",
            Self::Attempt => "t.attempt",
            Self::SaturatedChannels => "t.saturated_channels",
            Self::StuckChannels => "t.stuck_channels",
            Self::MissingChannels => "t.missing_channels",
            Self::InjectionSumV => "t.injection_sum_v",
            Self::DroppedPackets => "t.dropped_packets",
            Self::FrameCount => "t.frame_count",
            Self::StartedAt => "t.started_at",
            Self::MeasuredAt => "t.measured_at",
            Self::RmseV => "w.rmse_v",
            Self::Fvu => "w.fvu",
        }
    }
}

/// How a column is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Comparison {
    /// `eq`
    Equal,
    /// `gt`
    Greater,
    /// `gte`
    GreaterOrEqual,
    /// `lt`
    Less,
    /// `lte`
    LessOrEqual,
}

impl Comparison {
    /// The comparison of a filter's suffix: `eq`, `gt`, `gte`, `lt`, `lte`.
    pub fn from_suffix(suffix: &str) -> Option<Self> {
        Some(match suffix {
            "eq" => Self::Equal,
            "gt" => Self::Greater,
            "gte" => Self::GreaterOrEqual,
            "lt" => Self::Less,
            "lte" => Self::LessOrEqual,
            _ => return None,
        })
    }

    fn sql(self) -> &'static str {
        match self {
            Self::Equal => " = ",
            Self::Greater => " > ",
            Self::GreaterOrEqual => " >= ",
            Self::Less => " < ",
            Self::LessOrEqual => " <= ",
        }
    }
}

/// What a column is compared with. A number on a column of times matches nothing, and so does a
/// time on a column of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FilterValue {
    /// A number, in the column's unit.
    Number(f64),
    /// A time.
    Time(Timestamp),
}

/// One condition on a trial; an absent value meets none.
#[derive(Debug, Clone, PartialEq)]
pub enum Filter {
    /// A comparison with one value.
    Compare(TrialColumn, Comparison, FilterValue),
    /// Equal to one of these.
    OneOf(TrialColumn, Vec<FilterValue>),
}

impl Filter {
    /// Adds ` AND` and the condition.
    pub(super) fn push_onto(&self, query: &mut QueryBuilder<Sqlite>) {
        match self {
            Self::Compare(column, comparison, value) => {
                query.push(" AND ");
                comparable(query, *column, *value);
                query.push(comparison.sql());
                bind(query, *value);
            }
            Self::OneOf(column, values) => {
                query.push(" AND (FALSE");
                for value in values {
                    query.push(" OR ");
                    comparable(query, *column, *value);
                    query.push(" = ");
                    bind(query, *value);
                }
                query.push(")");
            }
        }
    }
}

/// The column, or NULL where its type cannot be compared with the value's.
fn comparable(query: &mut QueryBuilder<Sqlite>, column: TrialColumn, value: FilterValue) {
    let fits = column.is_time() == matches!(value, FilterValue::Time(_));
    query.push(if fits { column.sql() } else { "NULL" });
}

fn bind(query: &mut QueryBuilder<Sqlite>, value: FilterValue) {
    match value {
        FilterValue::Number(number) => query.push_bind(number),
        FilterValue::Time(time) => query.push_bind(time_text(time)),
    };
}
