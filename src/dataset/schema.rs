//! Columns of the trials table, as datasets, exports and imports have them.
//! PURE. Uses: `simulate::schema`. Never: rows, files.

use std::sync::{Arc, LazyLock};

use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};

use super::definition::{Definition, SplitBy, Task};
use crate::simulate::schema as base;

/// Number of arms, attached or not.
pub const ARMS: i32 = 6;
/// Rows of a batch, and of a file's row group.
pub const BATCH_ROWS: usize = 1000;
/// Column of the measured frame.
pub const VOLTAGES_V: &str = "voltages_v";
/// Column of the forces of the arms.
pub const FORCES_N: &str = "forces_n";
/// Column of a rendered force map.
pub const FORCE_MAP_N: &str = "force_map_n";
/// Column of the part of a split.
pub const SPLIT: &str = "split";
/// Columns that only Sim-Random fills.
const DRAWN: [&str; 2] = [base::SEED, base::INDEX];

/// Key of a file's metadata that holds the text of its sensor file.
pub const SENSOR: &str = "palpate.sensor";

/// Number of voltages of the paper's skin, where nothing says otherwise.
pub const CHANNELS: i32 = 784;

/// A time: UTC, milliseconds.
fn time(name: &str) -> Field {
    Field::new(name, DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into())), true)
}

fn of(name: &str, kind: DataType) -> Field {
    Field::new(name, kind, true)
}

fn list(name: &str, items: i32, unit: &str) -> Field {
    let element = base::with_unit(Field::new(base::ELEMENT, DataType::Float32, true), unit);
    base::with_unit(Field::new(name, DataType::FixedSizeList(Arc::new(element), items), true), unit)
}

/// A force map of so many pixels as a column, N per pixel, row by row.
pub fn force_map(pixels: i32) -> Field {
    list(FORCE_MAP_N, pixels, "N")
}

/// All columns, for frames of so many voltages.
pub fn all(channels: i32) -> Schema {
    use DataType::{Float32, Float64, Int64, UInt8, UInt32, UInt64, Utf8};
    let flag = Field::new(base::ELEMENT, Utf8, false);
    let mm = |name| base::with_unit(of(name, Float64), "mm");
    Schema::new(vec![
        of("trial_id", Int64),
        of("run", Utf8),
        of("scan_id", Int64),
        of(base::SEED, UInt64),
        of(base::INDEX, UInt64),
        of(base::EXPERIMENT, Utf8),
        of("label", Utf8),
        of("configuration", UInt32),
        of("depth_index", UInt32),
        of("attempt", UInt32),
        mm("depth_mm"),
        of("tips", UInt8),
        of(base::CONTACT_COUNT, UInt8),
        base::with_unit(of(base::MAX_FORCE_N, Float32), "N"),
        of(base::CONTACTS, DataType::List(Arc::new(contact_element()))),
        list(FORCES_N, ARMS, "N"),
        base::voltages(VOLTAGES_V, channels, true),
        base::voltages(base::SIM_VOLTAGES_V, channels, true),
        of("sim_model", Utf8),
        base::with_unit(of("rmse_v", Float64), "V"),
        of("fvu", Float64),
        of("flags", DataType::List(Arc::new(flag))),
        of("saturated_channels", UInt32),
        of("stuck_channels", UInt32),
        of("missing_channels", UInt32),
        base::with_unit(of("injection_sum_v", Float64), "V"),
        of("dropped_packets", UInt32),
        mm("depth_error_mm"),
        base::with_unit(of("settle_ms", Float64), "ms"),
        base::with_unit(of("overshoot_n", Float64), "N"),
        of("frame_count", UInt32),
        time("started_at"),
        time("measured_at"),
        of(SPLIT, Utf8),
    ])
}

/// The columns that rows can be filtered by.
pub fn scalars() -> SchemaRef {
    let all = all(CHANNELS);
    let fields = all.fields().iter().filter(|field| kind(field.data_type()) != Kind::List);
    Arc::new(Schema::new(fields.cloned().collect::<Vec<_>>()))
}

/// A contact of which anything may be unknown.
pub fn contact_element() -> Field {
    let fields = base::contact_fields();
    let known: Vec<Field> = fields.iter().map(|f| f.as_ref().clone().with_nullable(true)).collect();
    Field::new(base::ELEMENT, DataType::Struct(known.into()), false)
}

/// The columns of a dataset: those that its task knows anything of.
pub fn of_dataset(definition: &Definition, channels: i32) -> SchemaRef {
    let task = definition.task;
    let has = |field: &Field| match field.name().as_str() {
        VOLTAGES_V => task.has_measured(),
        base::SIM_VOLTAGES_V | "sim_model" | "rmse_v" | "fvu" => task.has_simulated(),
        SPLIT => definition.split.by != SplitBy::None,
        name if DRAWN.contains(&name) => task == Task::S2sRecon,
        _ => true,
    };
    let fields: Vec<Field> =
        all(channels).fields().iter().map(|f| f.as_ref().clone()).filter(has).collect();
    Arc::new(Schema::new(fields))
}

/// A type in words: `float32[784]`, `list of {x_mm float64, ..}`.
pub fn type_words(data_type: &DataType) -> String {
    match data_type {
        DataType::Utf8 => "string".into(),
        DataType::Timestamp(..) => "timestamp, UTC".into(),
        DataType::List(item) => format!("list of {}", type_words(item.data_type())),
        DataType::FixedSizeList(item, size) => format!("{}[{size}]", type_words(item.data_type())),
        DataType::Struct(fields) => {
            let words =
                |field: &Arc<Field>| format!("{} {}", field.name(), type_words(field.data_type()));
            format!("{{{}}}", fields.iter().map(words).collect::<Vec<_>>().join(", "))
        }
        other => other.to_string().to_lowercase(),
    }
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

/// What a column of this type can be compared with.
pub fn kind(data_type: &DataType) -> Kind {
    match data_type {
        DataType::Utf8 => Kind::Word,
        DataType::Timestamp(..) => Kind::Time,
        DataType::List(_) | DataType::FixedSizeList(..) => Kind::List,
        _ => Kind::Number,
    }
}

/// All columns with their kinds, whatever the number of channels.
pub static COLUMNS: LazyLock<Vec<(String, Kind)>> = LazyLock::new(|| {
    all(CHANNELS).fields().iter().map(|f| (f.name().clone(), kind(f.data_type()))).collect()
});
