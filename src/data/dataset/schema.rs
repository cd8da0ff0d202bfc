//! The trials table as Arrow fields, for datasets, exports and imports.
//! PURE. Uses: `store::table`, `simulate::schema`. Never: rows, files.

use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};

use super::definition::{Definition, SplitBy, Task};
use crate::record::ARMS;
use crate::simulate::schema as base;
use crate::store::table::{Column, Kind, Of, TABLE};

/// Number of rows of a batch, and of a row group of a file.
pub const BATCH_ROWS: usize = 1000;
/// Column of the measured frame.
pub const VOLTAGES_V: &str = "voltages_v";
/// Column of the number of frames in the mean.
pub const FRAME_COUNT: &str = "frame_count";
/// Column of a rendered force map.
const FORCE_MAP_N: &str = "force_map_n";
/// Column of the part of the split.
pub const SPLIT: &str = "split";

/// Metadata key of the column of force maps: rows and columns of pixels, as a JSON array.
const SHAPE: &str = "shape";
/// Metadata key of a file that holds the text of its sensor file.
pub const SENSOR_KEY: &str = "palpate.sensor";

/// Number of voltages per frame of the paper's skin, used if a dataset has no frames.
pub const PAPER_CHANNELS: i32 = 784;

fn list(name: &str, items: i32, unit: &str) -> Field {
    let element = base::with_unit(Field::new(base::ELEMENT, DataType::Float32, true), unit);
    base::with_unit(Field::new(name, DataType::FixedSizeList(Arc::new(element), items), true), unit)
}

/// The column of force maps of `pixels` pixels, a square number, N per pixel, row-major, with their shape.
pub fn force_map(pixels: i32) -> Field {
    let side = pixels.isqrt();
    let flat = list(FORCE_MAP_N, pixels, "N");
    let metadata = flat.metadata().clone().with(SHAPE, format!("[{side}, {side}]"));
    flat.with_metadata(metadata)
}

/// All columns of the trials table, for frames of `channels` voltages.
pub fn all(channels: i32) -> Schema {
    columns(channels, |_| true)
}

/// The columns of the trials table for which `has` holds.
fn columns(channels: i32, has: impl Fn(&Column) -> bool) -> Schema {
    let columns = TABLE.iter().filter(|column| has(column));
    Schema::new(columns.map(|column| field(column, channels)).collect::<Vec<_>>())
}

/// The columns of stored trials, with frames of `channels` voltages.
pub fn stored(channels: i32) -> SchemaRef {
    Arc::new(columns(channels, Column::is_of_stored))
}

/// A column as a field, with its unit.
fn field(column: &Column, channels: i32) -> Field {
    let plain = |kind| {
        let field = Field::new(column.name, kind, true);
        if column.unit.is_empty() { field } else { base::with_unit(field, column.unit) }
    };
    match column.of {
        Of::Id(_) => plain(DataType::Int64),
        Of::Count(_) => plain(DataType::UInt32),
        Of::Few(_) => plain(DataType::UInt8),
        Of::Drawn => plain(DataType::UInt64),
        Of::Number(_) => plain(DataType::Float64),
        Of::Single(_) => plain(DataType::Float32),
        Of::Text(_) | Of::Part => plain(DataType::Utf8),
        Of::Time(_) => plain(DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into()))),
        Of::Contacts => plain(DataType::List(Arc::new(contact_element()))),
        Of::Flags => {
            plain(DataType::List(Arc::new(Field::new(base::ELEMENT, DataType::Utf8, false))))
        }
        Of::Forces => list(column.name, ARMS as i32, column.unit),
        Of::Measured(_) | Of::Simulated(_) => {
            base::voltages(column.name, channels).with_nullable(true)
        }
    }
}

/// The columns with scalar values.
pub fn scalars() -> SchemaRef {
    Arc::new(columns(PAPER_CHANNELS, is_scalar))
}

/// Element type of contacts: a struct whose fields are nullable.
pub fn contact_element() -> Field {
    let fields = base::contact_fields();
    let known: Vec<Field> = fields.iter().map(|f| f.as_ref().clone().with_nullable(true)).collect();
    Field::new(base::ELEMENT, DataType::Struct(known.into()), false)
}

/// The columns of a dataset: those that apply to its task and split.
pub fn of_dataset(definition: &Definition, channels: i32) -> SchemaRef {
    let task = definition.task;
    let has = |column: &Column| match (column.of, column.name) {
        (Of::Measured(_), _) => task.has_measured(),
        (Of::Simulated(_), _) | (_, "sim_model" | "rmse_v" | "fvu") => task.has_simulated(),
        // Elsewhere it is the split, or of no use; equal datasets keep their ids.
        (_, "imported_split") => task == Task::Trials,
        (_, "imported_tag") => task == Task::Trials || definition.split.by == SplitBy::Tag,
        (Of::Part, _) => definition.split.by != SplitBy::None,
        (Of::Drawn, _) => task == Task::S2sRecon,
        _ => true,
    };
    Arc::new(columns(channels, has))
}

/// Name of a type for people: `float32[784]`, `list of {x_mm float64, ..}`.
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

/// Names of the scalar columns of a table, which conditions and sorting may use.
pub fn comparable(schema: &Schema) -> Vec<&str> {
    let fields = schema.fields().iter().map(|field| field.name().as_str());
    fields.filter(|name| is_comparable(name)).collect()
}

/// True if the column with this name holds scalar values.
pub fn is_comparable(name: &str) -> bool {
    Column::find(name).is_some_and(is_scalar)
}

fn is_scalar(column: &Column) -> bool {
    column.kind() != Kind::List
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_map_states_its_shape_and_its_unit() {
        let map = force_map(25_600);
        assert_eq!(map.metadata()[SHAPE], "[160, 160]");
        assert_eq!(map.metadata()[base::UNIT], "N");
    }
}
