//! CSV: single values as text, lists of one length as a column for each item, other lists as JSON.
//! Uses: `dataset::format`, arrow, csv. Never: names of time zones (see `zone`).
//!
//! Numbers are the shortest text that reads back as the same number of their width; a missing
//! value is an empty cell, as an empty text is; what is not a number is `NaN`, `inf` or `-inf`.

use std::io::Write as Output;

use arrow_array::cast::AsArray;
use arrow_array::{Array, FixedSizeListArray, RecordBatch};
use arrow_cast::display::{ArrayFormatter, FormatOptions};
use arrow_json::EncoderOptions;
use arrow_json::writer::{NullableEncoder, make_encoder};
use arrow_schema::{ArrowError, DataType, FieldRef, Schema};
use csv::Terminator;

use super::FormatError;

/// A CSV file being written.
pub(super) struct Writer<W: Output> {
    lines: csv::Writer<W>,
}

impl<W: Output> Writer<W> {
    /// Writes the header line.
    pub(super) fn new(schema: &Schema, out: W) -> Result<Self, FormatError> {
        let mut lines = csv::WriterBuilder::new().terminator(Terminator::CRLF).from_writer(out);
        for field in schema.fields() {
            match field.data_type() {
                DataType::FixedSizeList(_, length) => {
                    for item in 0..*length {
                        lines.write_field(format!("{}_{item}", field.name()))?;
                    }
                }
                _ => lines.write_field(field.name())?,
            }
        }
        lines.write_record(None::<&[u8]>)?;
        Ok(Self { lines })
    }

    /// Writes a line for each row.
    pub(super) fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        let schema = batch.schema();
        let texts = FormatOptions::new().with_display_error(false);
        let json = EncoderOptions::default();
        let mut columns = Vec::with_capacity(batch.num_columns());
        for (field, column) in schema.fields().iter().zip(batch.columns()) {
            columns.push(Column::new(field, column.as_ref(), &texts, &json)?);
        }
        let mut cell = Cell::default();
        for row in 0..batch.num_rows() {
            for column in &mut columns {
                column.write(row, &mut cell, &mut self.lines)?;
            }
            self.lines.write_record(None::<&[u8]>)?;
        }
        Ok(())
    }

    /// Writes what is still held back.
    pub(super) fn finish(self) -> Result<W, FormatError> {
        self.lines.into_inner().map_err(|error| FormatError::Io(error.into_error()))
    }
}

/// Room for a cell's text, used again and again.
#[derive(Default)]
struct Cell {
    text: String,
    json: Vec<u8>,
}

/// A column of a batch as cells.
enum Column<'a> {
    One(ArrayFormatter<'a>),
    Each(&'a FixedSizeListArray, ArrayFormatter<'a>),
    Json(NullableEncoder<'a>),
}

impl<'a> Column<'a> {
    fn new(
        field: &'a FieldRef,
        column: &'a dyn Array,
        texts: &FormatOptions<'a>,
        json: &'a EncoderOptions,
    ) -> Result<Self, ArrowError> {
        Ok(match field.data_type() {
            DataType::FixedSizeList(..) => {
                let lists = column.as_fixed_size_list();
                Self::Each(lists, ArrayFormatter::try_new(lists.values().as_ref(), texts)?)
            }
            DataType::List(_) => Self::Json(make_encoder(field, column, json)?),
            _ => Self::One(ArrayFormatter::try_new(column, texts)?),
        })
    }

    fn write<W: Output>(
        &mut self,
        row: usize,
        cell: &mut Cell,
        lines: &mut csv::Writer<W>,
    ) -> Result<(), FormatError> {
        match self {
            Self::One(texts) => text(texts, row, cell, lines),
            Self::Each(lists, texts) => {
                let length = lists.value_length() as usize;
                for item in row * length..(row + 1) * length {
                    if lists.is_null(row) {
                        lines.write_field("")?;
                    } else {
                        text(texts, item, cell, lines)?;
                    }
                }
                Ok(())
            }
            Self::Json(values) => {
                cell.json.clear();
                if !values.is_null(row) {
                    values.encode(row, &mut cell.json);
                }
                Ok(lines.write_field(&cell.json)?)
            }
        }
    }
}

fn text<W: Output>(
    texts: &ArrayFormatter<'_>,
    at: usize,
    cell: &mut Cell,
    lines: &mut csv::Writer<W>,
) -> Result<(), FormatError> {
    cell.text.clear();
    texts.value(at).write(&mut cell.text)?;
    Ok(lines.write_field(&cell.text)?)
}
