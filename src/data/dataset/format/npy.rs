//! Columns as NumPy arrays: header and bytes of the values.
//! PURE. Uses: arrow. Never: the container.
//!
//! Source: numpy.lib.format, version 1.0. All values are little-endian, row-major.

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int64Type, TimestampMillisecondType, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, Float64Array};
use arrow_cast::cast;
use arrow_json::EncoderOptions;
use arrow_json::writer::make_encoder;
use arrow_schema::{ArrowError, DataType, Field, FieldRef, TimeUnit};

/// Length of the header, bytes: enough for all layouts, and a multiple of the alignment.
const HEADER_BYTES: usize = 128;
/// NumPy's NaT.
pub(crate) const NOT_A_TIME: i64 = i64::MIN;

/// Properties of a column's values that determine its layout.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Survey {
    /// Number of missing values.
    nulls: usize,
    /// Number of characters of the longest text, or of items of the longest list.
    longest: usize,
}

impl Survey {
    /// True if the layout of a column depends on its values.
    pub(super) fn is_needed(field: &Field) -> bool {
        match field.data_type() {
            DataType::Utf8 | DataType::List(_) => true,
            kind => field.is_nullable() && (kind.is_integer() || kind == &DataType::Boolean),
        }
    }

    /// Adds a batch of the column.
    pub(super) fn add(&mut self, field: &FieldRef, values: &ArrayRef) -> Result<(), ArrowError> {
        self.nulls += values.null_count();
        let longest = match field.data_type() {
            DataType::Utf8 => {
                values.as_string::<i32>().iter().flatten().map(|text| text.chars().count()).max()
            }
            DataType::List(item) if matches!(item.data_type(), DataType::Struct(_)) => {
                let lists = values.as_list::<i32>();
                lists.offsets().windows(2).map(|ends| (ends[1] - ends[0]) as usize).max()
            }
            DataType::List(_) => json(field, values)?.iter().map(|text| text.chars().count()).max(),
            _ => None,
        };
        self.longest = self.longest.max(longest.unwrap_or(0));
        Ok(())
    }
}

/// Array layout of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// Numbers of the column's type.
    Numbers {
        /// Type name of NumPy.
        kind: &'static str,
        /// Length of a number, bytes.
        bytes: usize,
    },
    /// Whole numbers or booleans with missing values: f64, NaN if missing.
    Gaps,
    /// Booleans, one byte each.
    Booleans,
    /// Milliseconds since 1970, UTC; NaT if missing.
    Times,
    /// Texts padded to `chars` characters; empty if missing.
    Texts {
        /// Number of characters of the longest text.
        chars: usize,
    },
    /// Lists of texts as JSON; empty if missing.
    Json {
        /// Number of characters of the longest JSON text.
        chars: usize,
    },
    /// Lists of f32 of fixed length, NaN if missing.
    Frames {
        /// Number of items of each list.
        length: usize,
    },
    /// Lists of records of numbers: `items x fields` f64 per row, NaN beyond a list's end.
    Records {
        /// Number of items of the longest list.
        items: usize,
        /// Number of fields of a record.
        fields: usize,
    },
}

impl Layout {
    /// Layout of a column; `None` if its type has no layout.
    pub(super) fn of(field: &Field, survey: Survey) -> Option<Self> {
        let numbers = |kind, bytes| Some(Self::Numbers { kind, bytes });
        let chars = survey.longest.max(1);
        match field.data_type() {
            DataType::Float32 => numbers("<f4", 4),
            DataType::Float64 => numbers("<f8", 8),
            DataType::Boolean | DataType::Int64 if survey.nulls > 0 => Some(Self::Gaps),
            kind if kind.is_unsigned_integer() && survey.nulls > 0 => Some(Self::Gaps),
            DataType::Int64 => numbers("<i8", 8),
            DataType::UInt64 => numbers("<u8", 8),
            DataType::UInt32 => numbers("<u4", 4),
            DataType::UInt16 => numbers("<u2", 2),
            DataType::UInt8 => numbers("|u1", 1),
            DataType::Boolean => Some(Self::Booleans),
            DataType::Timestamp(TimeUnit::Millisecond, _) => Some(Self::Times),
            DataType::Utf8 => Some(Self::Texts { chars }),
            DataType::FixedSizeList(item, length) if item.data_type() == &DataType::Float32 => {
                Some(Self::Frames { length: usize::try_from(*length).ok()? })
            }
            DataType::List(item) => match item.data_type() {
                DataType::Utf8 => Some(Self::Json { chars }),
                DataType::Struct(fields) if fields.iter().all(|f| f.data_type().is_floating()) => {
                    Some(Self::Records { items: survey.longest, fields: fields.len() })
                }
                _ => None,
            },
            _ => None,
        }
    }

    /// Length of a row, bytes.
    pub(super) fn row_bytes(self) -> usize {
        match self {
            Self::Numbers { bytes, .. } => bytes,
            Self::Booleans => 1,
            Self::Gaps | Self::Times => 8,
            Self::Texts { chars } | Self::Json { chars } => 4 * chars,
            Self::Frames { length } => 4 * length,
            Self::Records { items, fields } => 8 * items * fields,
        }
    }

    /// Header of an array of `rows` rows.
    pub(super) fn header(self, rows: u64) -> Vec<u8> {
        let (kind, shape) = match self {
            Self::Numbers { kind, .. } => (kind.to_owned(), format!("({rows},)")),
            Self::Gaps => ("<f8".to_owned(), format!("({rows},)")),
            Self::Booleans => ("|b1".to_owned(), format!("({rows},)")),
            Self::Times => ("<M8[ms]".to_owned(), format!("({rows},)")),
            Self::Texts { chars } | Self::Json { chars } => {
                (format!("<U{chars}"), format!("({rows},)"))
            }
            Self::Frames { length } => ("<f4".to_owned(), format!("({rows}, {length})")),
            Self::Records { items, fields } => {
                ("<f8".to_owned(), format!("({rows}, {items}, {fields})"))
            }
        };
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&((HEADER_BYTES - 10) as u16).to_le_bytes());
        let words = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        bytes.extend_from_slice(words.as_bytes());
        bytes.resize(HEADER_BYTES - 1, b' ');
        bytes.push(b'\n');
        bytes
    }

    /// Appends the bytes of a batch of the column.
    pub(super) fn append(
        self,
        field: &FieldRef,
        values: &ArrayRef,
        out: &mut Vec<u8>,
    ) -> Result<(), ArrowError> {
        match self {
            Self::Numbers { .. } => numbers(values, out),
            Self::Gaps => f64s(&as_f64(values)?, out),
            Self::Booleans => {
                out.extend(values.as_boolean().iter().map(|truth| u8::from(truth == Some(true))));
            }
            Self::Times => {
                for time in values.as_primitive::<TimestampMillisecondType>() {
                    out.extend_from_slice(&time.unwrap_or(NOT_A_TIME).to_le_bytes());
                }
            }
            Self::Texts { chars } => {
                for text in values.as_string::<i32>() {
                    put_text(text.unwrap_or_default(), chars, out);
                }
            }
            Self::Json { chars } => {
                for text in json(field, values)? {
                    put_text(&text, chars, out);
                }
            }
            Self::Frames { length } => frames(values, length, out),
            Self::Records { items, .. } => records(values, items, out)?,
        }
        Ok(())
    }
}

fn numbers(values: &ArrayRef, out: &mut Vec<u8>) {
    match values.data_type() {
        DataType::Float32 => f32s(values, out),
        DataType::Float64 => f64s(values.as_primitive::<Float64Type>(), out),
        DataType::UInt64 => plain::<UInt64Type, 8>(values, u64::to_le_bytes, out),
        DataType::UInt32 => plain::<UInt32Type, 4>(values, u32::to_le_bytes, out),
        DataType::UInt16 => plain::<UInt16Type, 2>(values, u16::to_le_bytes, out),
        DataType::UInt8 => plain::<UInt8Type, 1>(values, u8::to_le_bytes, out),
        _ => plain::<Int64Type, 8>(values, i64::to_le_bytes, out),
    }
}

/// Appends numbers without missing values.
fn plain<T: ArrowPrimitiveType, const BYTES: usize>(
    values: &ArrayRef,
    bytes: impl Fn(T::Native) -> [u8; BYTES],
    out: &mut Vec<u8>,
) {
    out.extend(values.as_primitive::<T>().values().iter().flat_map(|&value| bytes(value)));
}

fn f32s(values: &dyn Array, out: &mut Vec<u8>) {
    let values = values.as_primitive::<Float32Type>();
    out.reserve(4 * values.len());
    if values.null_count() == 0 {
        out.extend(values.values().iter().flat_map(|value| value.to_le_bytes()));
    } else {
        out.extend(values.iter().flat_map(|value| value.unwrap_or(f32::NAN).to_le_bytes()));
    }
}

fn put_f64(value: Option<f64>, out: &mut Vec<u8>) {
    out.extend_from_slice(&value.unwrap_or(f64::NAN).to_le_bytes());
}

fn f64s(values: &Float64Array, out: &mut Vec<u8>) {
    values.iter().for_each(|value| put_f64(value, out));
}

/// Numbers or booleans as f64.
fn as_f64(values: &ArrayRef) -> Result<Float64Array, ArrowError> {
    Ok(cast(values, &DataType::Float64)?.as_primitive::<Float64Type>().clone())
}

fn put_text(text: &str, chars: usize, out: &mut Vec<u8>) {
    let end = out.len() + 4 * chars;
    out.extend(text.chars().flat_map(|letter| u32::from(letter).to_le_bytes()));
    out.resize(end, 0);
}

/// Each value as JSON; empty if missing.
fn json(field: &FieldRef, values: &ArrayRef) -> Result<Vec<String>, ArrowError> {
    let options = EncoderOptions::default();
    let mut encoder = make_encoder(field, values.as_ref(), &options)?;
    let text = |row| {
        let mut bytes = Vec::new();
        if !encoder.is_null(row) {
            encoder.encode(row, &mut bytes);
        }
        String::from_utf8(bytes).map_err(|error| ArrowError::JsonError(error.to_string()))
    };
    (0..values.len()).map(text).collect()
}

fn frames(values: &ArrayRef, length: usize, out: &mut Vec<u8>) {
    let lists = values.as_fixed_size_list();
    if lists.null_count() == 0 {
        return f32s(lists.values().as_ref(), out);
    }
    for row in 0..lists.len() {
        if lists.is_null(row) {
            out.extend(std::iter::repeat_n(f32::NAN.to_le_bytes(), length).flatten());
        } else {
            f32s(lists.value(row).as_ref(), out);
        }
    }
}

fn records(values: &ArrayRef, items: usize, out: &mut Vec<u8>) -> Result<(), ArrowError> {
    let lists = values.as_list::<i32>();
    let records = lists.values().as_struct();
    let columns = records.columns().iter().map(as_f64).collect::<Result<Vec<_>, _>>()?;
    for (row, ends) in lists.offsets().windows(2).enumerate() {
        for at in (ends[0] as usize..).take(items) {
            let is_there = at < ends[1] as usize && lists.is_valid(row) && records.is_valid(at);
            for column in &columns {
                put_f64((is_there && column.is_valid(at)).then(|| column.value(at)), out);
            }
        }
    }
    Ok(())
}
