//! Columns of a foreign file in the types that `rows` reads.
//! PURE. Uses: arrow. Never: files; a check of a value.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_cast::{CastOptions, cast, cast_with_options};
use arrow_schema::{DataType, Field, TimeUnit};

use crate::dataset::schema::{FRAME_COUNT, SPLIT, VOLTAGES_V};
use crate::problem::Problem;
use crate::simulate::schema::{CONTACTS, SIM_VOLTAGES_V};

/// Column of the raw frames of a trial, V; its mean frame is computed.
pub(super) const FRAMES_V: &str = "frames_v";
/// Column of the text by which rows are selected and split, such as a tip or a place.
pub(super) const TAG: &str = "tag";
/// Fields of a contact, in their order in an array.
pub(super) const CONTACT_FIELDS: [&str; 4] = ["x_mm", "y_mm", "force_n", "diameter_mm"];

/// Type of the values of a column with one value per trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    /// Real numbers in double precision.
    Number,
    /// Times, ms since 1970, UTC.
    Time,
    /// One text per trial.
    Text,
    /// Lists of words per trial, such as flags.
    Words,
}

/// Columns with one value per trial.
pub(super) const SCALARS: [(&str, Scalar); 9] = [
    ("configuration", Scalar::Number),
    ("depth_index", Scalar::Number),
    ("depth_mm", Scalar::Number),
    ("tips", Scalar::Number),
    ("flags", Scalar::Words),
    ("started_at", Scalar::Time),
    (FRAME_COUNT, Scalar::Number),
    (SPLIT, Scalar::Text),
    (TAG, Scalar::Text),
];

/// The column with one value per trial that has this name.
pub(super) fn scalar(name: &str) -> Option<(&'static str, Scalar)> {
    SCALARS.into_iter().find(|(known, _)| *known == name)
}

/// Whether an import reads the column with this name.
pub(super) fn is_read(name: &str) -> bool {
    [VOLTAGES_V, FRAMES_V, SIM_VOLTAGES_V, CONTACTS].contains(&name) || scalar(name).is_some()
}

/// A value as f64; `None` if it is null or NaN.
pub(super) fn known(column: &ArrayRef, at: usize) -> Option<f64> {
    let column = cast(column, &DataType::Float64).ok()?;
    let numbers = column.as_primitive::<Float64Type>();
    (!numbers.is_null(at)).then(|| numbers.value(at)).filter(|number| !number.is_nan())
}

/// The columns of a batch, converted to the types that the reader uses.
pub(super) struct Columns {
    pub voltages_v: Option<ArrayRef>,
    /// Lists of raw frames.
    pub frames_v: Option<ArrayRef>,
    pub sim_voltages_v: Option<ArrayRef>,
    pub contacts: Option<ArrayRef>,
    pub configuration: Option<ArrayRef>,
    pub depth_index: Option<ArrayRef>,
    pub depth_mm: Option<ArrayRef>,
    pub tips: Option<ArrayRef>,
    pub flags: Option<ArrayRef>,
    pub started_at: Option<ArrayRef>,
    pub frame_count: Option<ArrayRef>,
    pub split: Option<ArrayRef>,
    pub tag: Option<ArrayRef>,
}

impl Columns {
    /// Converts the columns of a batch; `file` is the name of the file in messages.
    ///
    /// # Errors
    /// A problem if a column has values of another type.
    pub fn of(file: &str, batch: &RecordBatch) -> Result<Self, Problem> {
        let list = |item: DataType| DataType::new_large_list(item, true);
        let time = DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into()));
        let column = |name: &str, wanted: DataType, words: &str| {
            let Some(found) = batch.column_by_name(name) else { return Ok(None) };
            let wrong = |value: String| {
                Problem::new(file, name, value, format!("must be a column of {words}"))
            };
            if !resembles(found.data_type(), &wanted) {
                return Err(wrong(found.data_type().to_string()));
            }
            if let Some(fraction) = fraction(found, &wanted) {
                return Err(wrong(fraction.to_string()));
            }
            // A value that does not fit is an error, not a null.
            let options = CastOptions { safe: false, ..CastOptions::default() };
            let cast = cast_with_options(found, &wanted, &options);
            cast.map(Some).map_err(|error| wrong(error.to_string()))
        };
        Ok(Self {
            voltages_v: column(VOLTAGES_V, list(DataType::Float32), "lists of numbers")?,
            frames_v: column(
                FRAMES_V,
                list(list(DataType::Float32)),
                "lists of frames, each a list of numbers",
            )?,
            sim_voltages_v: column(SIM_VOLTAGES_V, list(DataType::Float32), "lists of numbers")?,
            contacts: contacts(file, batch)?,
            configuration: column("configuration", DataType::Int64, "whole numbers")?,
            depth_index: column("depth_index", DataType::Int64, "whole numbers")?,
            depth_mm: column("depth_mm", DataType::Float64, "numbers")?,
            tips: column("tips", DataType::Int64, "whole numbers")?,
            flags: column("flags", list(DataType::Utf8), "lists of words")?,
            started_at: column("started_at", time, "times")?,
            frame_count: column(FRAME_COUNT, DataType::Int64, "whole numbers")?,
            split: column(SPLIT, DataType::Utf8, "words")?,
            tag: column(TAG, DataType::Utf8, "words")?,
        })
    }
}

/// True if a type may be converted to the wanted one: numbers are not read from text, nor lists
/// from scalars.
fn resembles(found: &DataType, wanted: &DataType) -> bool {
    use DataType::{FixedSizeList, LargeList, List, Null};
    match (found, wanted) {
        (Null, _) => true,
        (DataType::Dictionary(_, value), wanted) => resembles(value, wanted),
        (List(item) | LargeList(item) | FixedSizeList(item, _), LargeList(wanted)) => {
            resembles(item.data_type(), wanted.data_type())
        }
        (found, DataType::Utf8) => {
            matches!(found, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
        }
        (found, DataType::Timestamp(..)) => matches!(found, DataType::Timestamp(..)),
        (found, wanted) => found.is_numeric() && wanted.is_numeric(),
    }
}

/// First number with a fraction in a column that must hold whole numbers. (pandas stores whole
/// numbers with gaps as floats.)
fn fraction(found: &ArrayRef, wanted: &DataType) -> Option<f64> {
    if *wanted != DataType::Int64 || !found.data_type().is_floating() {
        return None;
    }
    let numbers = cast(found, &DataType::Float64).ok()?;
    numbers.as_primitive::<Float64Type>().iter().flatten().find(|number| number.fract() != 0.0)
}

/// The column of contacts: lists of structs with any of four fields of any numeric type.
fn contacts(file: &str, batch: &RecordBatch) -> Result<Option<ArrayRef>, Problem> {
    let Some(found) = batch.column_by_name(CONTACTS) else { return Ok(None) };
    let is_known = |field: &Arc<Field>| {
        let kind = field.data_type();
        CONTACT_FIELDS.contains(&field.name().as_str())
            && (kind.is_numeric() || *kind == DataType::Null)
    };
    let wanted = match found.data_type() {
        DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) => {
            match item.data_type() {
                // A file whose trials are all untouched: contacts without fields.
                DataType::Null => {
                    let contact = DataType::Struct(Vec::<Field>::new().into());
                    Some(Arc::new(Field::new("item", contact, true)))
                }
                DataType::Struct(fields) if fields.iter().all(is_known) => Some(item.clone()),
                _ => None,
            }
        }
        _ => None,
    };
    let read = wanted.and_then(|item| cast(found, &DataType::LargeList(item)).ok());
    read.map(Some).ok_or_else(|| {
        let limit = "must be lists of {x_mm, y_mm, force_n, diameter_mm}, all numbers, each of which may \
                     be null or absent";
        Problem::new(file, CONTACTS, found.data_type(), limit)
    })
}
