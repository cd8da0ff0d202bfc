//! Columns of the trials table as Arrow fields and Parquet settings, the same in every file.
//! PURE. Uses: arrow, parquet. Never: files, rows.
//!
//! The unit is the last word of a name and the `unit` of the field's metadata. A column that may be
//! unknown is nullable; an unknown number is null, never zero.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Fields, Schema};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;

/// Key of a field's metadata with its unit.
pub const UNIT: &str = "unit";
/// Column of the seed of a simulated trial.
pub const SEED: &str = "seed";
/// Column of the number of a simulated trial under its seed.
pub const INDEX: &str = "index";
/// Column of the experiment's name.
pub const EXPERIMENT: &str = "experiment";
/// Column of the number of contacts.
pub const CONTACT_COUNT: &str = "contact_count";
/// Column of the largest contact's force.
pub const MAX_FORCE_N: &str = "max_force_n";
/// Column of the contacts.
pub const CONTACTS: &str = "contacts";
/// Column of the simulated frame.
pub const SIM_VOLTAGES_V: &str = "sim_voltages_v";
/// Name of a list's items in the Parquet format.
pub const ELEMENT: &str = "element";

/// Fields of a contact: position (mm, as f64: a point's coordinates are those of the sensor file),
/// force (N) and diameter (mm).
pub fn contact_fields() -> Fields {
    Fields::from(vec![
        with_unit(Field::new("x_mm", DataType::Float64, false), "mm"),
        with_unit(Field::new("y_mm", DataType::Float64, false), "mm"),
        with_unit(Field::new("force_n", DataType::Float32, false), "N"),
        with_unit(Field::new("diameter_mm", DataType::Float32, false), "mm"),
    ])
}

/// A contact as the item of a list.
pub fn contact_element() -> Field {
    Field::new(ELEMENT, DataType::Struct(contact_fields()), false)
}

/// Contacts of a trial; an empty list is an untouched skin.
pub fn contacts() -> Field {
    Field::new(CONTACTS, DataType::List(Arc::new(contact_element())), false)
}

/// A voltage as the item of a frame.
pub fn voltage_element() -> Field {
    with_unit(Field::new(ELEMENT, DataType::Float32, false), "V")
}

/// A frame of voltages (V after gain), injection-major, in every row.
///
/// `channels` is the number of voltages in a frame: 784 for 28 electrodes.
pub fn voltages(name: &str, channels: i32) -> Field {
    let frame = DataType::FixedSizeList(Arc::new(voltage_element()), channels);
    with_unit(Field::new(name, frame, false), "V")
}

/// The trials table of Sim-Random: `seed` and `index` instead of run and configuration. Quantities
/// of a rig (depths, tips, cells, measured voltages, times) have no column.
pub fn sim_random(channels: i32) -> Schema {
    Schema::new(vec![
        Field::new(SEED, DataType::UInt64, false),
        Field::new(INDEX, DataType::UInt64, false),
        Field::new(EXPERIMENT, DataType::Utf8, false),
        Field::new(CONTACT_COUNT, DataType::UInt8, false),
        with_unit(Field::new(MAX_FORCE_N, DataType::Float32, true), "N"),
        contacts(),
        voltages(SIM_VOLTAGES_V, channels),
    ])
}

/// Returns the field with its unit in its metadata.
pub fn with_unit(field: Field, unit: &str) -> Field {
    field.with_metadata(HashMap::from([(UNIT.to_owned(), unit.to_owned())]))
}

/// Encoding of numbers in a Parquet file. The default was chosen by measurement
/// (`docs/decisions/0007-parquet-encoding.md`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Packing {
    /// Compression of every column.
    pub compression: Compression,
    /// Byte stream split of voltages and forces: their upper bytes repeat, their lower ones do not.
    pub split_bytes: bool,
}

impl Default for Packing {
    fn default() -> Self {
        Self { compression: Compression::ZSTD(ZstdLevel::default()), split_bytes: true }
    }
}

/// Settings of Parquet files of trials. `footer` is stored as key-value metadata of the file, in
/// its order.
pub fn parquet_properties(packing: Packing, footer: Vec<KeyValue>) -> WriterProperties {
    let volts = ColumnPath::from(vec![SIM_VOLTAGES_V.into(), "list".into(), ELEMENT.into()]);
    let force = [CONTACTS, "list", ELEMENT, "force_n"].map(str::to_owned).to_vec();
    let mut properties = WriterProperties::builder()
        .set_compression(packing.compression)
        .set_key_value_metadata(Some(footer))
        .set_column_statistics_enabled(volts.clone(), EnabledStatistics::None);
    let split = if packing.split_bytes { Encoding::BYTE_STREAM_SPLIT } else { Encoding::PLAIN };
    for (column, encoding) in [
        (volts, split),
        (ColumnPath::from(force), split),
        (ColumnPath::from(MAX_FORCE_N), split),
        (ColumnPath::from(INDEX), Encoding::DELTA_BINARY_PACKED),
    ] {
        properties = properties
            .set_column_dictionary_enabled(column.clone(), false)
            .set_column_encoding(column, encoding);
    }
    properties.build()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Last words of names, and the unit in the metadata.
    const COLUMN_UNITS: [(&str, &str); 3] = [("_n", "N"), ("_mm", "mm"), ("_v", "V")];

    #[test]
    fn units_in_names_and_metadata_agree() {
        let schema = sim_random(784);
        let contact = contact_fields();
        let mut with_units = 0;
        for field in schema.fields().iter().chain(contact.iter()) {
            let by_name = COLUMN_UNITS.iter().find(|(end, _)| field.name().ends_with(end));
            let stated = field.metadata().get(UNIT).map(|unit| unit.as_str());
            assert_eq!(by_name.map(|(_, unit)| *unit), stated, "{}", field.name());
            with_units += usize::from(stated.is_some());
        }
        assert_eq!(with_units, 6);
    }
}
