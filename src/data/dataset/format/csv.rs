//! CSV: scalars as text, lists of fixed length as a column per item, other lists as JSON.
//! Uses: `dataset::format`, arrow, csv. Never: names of time zones (see `zone`).
//!
//! A number is the shortest text that parses to the same number of its width. A missing value and
//! an empty text are both an empty cell. Numbers that are not finite are `NaN`, `inf` or `-inf`.
//!
//! A spreadsheet evaluates a text that begins like a formula. Such a text is written with an apostrophe
//! before it (OWASP, "CSV Injection"); numbers are not.

use std::io::Write;

use arrow_array::cast::AsArray;
use arrow_array::{Array, FixedSizeListArray, RecordBatch};
use arrow_cast::display::{ArrayFormatter, FormatOptions};
use arrow_json::EncoderOptions;
use arrow_json::writer::{NullableEncoder, make_encoder};
use arrow_schema::{ArrowError, DataType, FieldRef, Schema};
use csv::{ByteRecord, Terminator};

use super::FormatError;

/// A CSV file being written.
pub(super) struct Writer<W: Write> {
    lines: csv::Writer<W>,
}

impl<W: Write> Writer<W> {
    /// Writes the header line.
    pub(super) fn new(schema: &Schema, out: W) -> Result<Self, FormatError> {
        let mut header = ByteRecord::new();
        for field in schema.fields() {
            match field.data_type() {
                DataType::FixedSizeList(_, length) => {
                    for item in 0..*length {
                        header.push_field(format!("{}_{item}", field.name()).as_bytes());
                    }
                }
                _ => header.push_field(field.name().as_bytes()),
            }
        }
        let mut lines = csv::WriterBuilder::new().terminator(Terminator::CRLF).from_writer(out);
        lines.write_byte_record(&header)?;
        Ok(Self { lines })
    }

    /// Writes one line per row.
    pub(super) fn push(&mut self, batch: &RecordBatch) -> Result<(), FormatError> {
        let schema = batch.schema();
        let texts = FormatOptions::new().with_display_error(false);
        let json = EncoderOptions::default();
        let mut columns = Vec::with_capacity(batch.num_columns());
        for (field, column) in schema.fields().iter().zip(batch.columns()) {
            columns.push(Column::new(field, column.as_ref(), &texts, &json)?);
        }
        let mut line = Line::default();
        for row in 0..batch.num_rows() {
            line.cells.clear();
            for column in &mut columns {
                column.write(row, &mut line)?;
            }
            self.lines.write_byte_record(&line.cells)?;
        }
        Ok(())
    }

    /// Writes the buffered lines and returns the output.
    pub(super) fn finish(self) -> Result<W, FormatError> {
        self.lines.into_inner().map_err(|error| FormatError::Io(error.into_error()))
    }
}

/// Characters with which a spreadsheet's formula may begin.
const FORMULA: [char; 6] = ['=', '+', '-', '@', '\t', '\r'];

/// The cells of a row, with reused buffers for their texts.
#[derive(Default)]
struct Line {
    cells: ByteRecord,
    text: String,
    json: Vec<u8>,
}

impl Line {
    fn cell(&mut self, of: &Scalars<'_>, at: usize) -> Result<(), ArrowError> {
        self.text.clear();
        of.shown.value(at).write(&mut self.text)?;
        if of.is_text && self.text.starts_with(FORMULA) {
            self.text.insert(0, '\'');
        }
        self.cells.push_field(self.text.as_bytes());
        Ok(())
    }
}

/// A column of a batch as cells.
enum Column<'a> {
    /// Scalars: one cell.
    One(Scalars<'a>),
    /// Lists of fixed length: one cell per item.
    Each(&'a FixedSizeListArray, Scalars<'a>),
    /// Other lists: one cell of JSON.
    Json(NullableEncoder<'a>),
}

/// Scalars as texts of cells.
struct Scalars<'a> {
    shown: ArrayFormatter<'a>,
    is_text: bool,
}

impl<'a> Scalars<'a> {
    fn new(column: &'a dyn Array, texts: &FormatOptions<'a>) -> Result<Self, ArrowError> {
        let is_text = column.data_type().is_string();
        Ok(Self { shown: ArrayFormatter::try_new(column, texts)?, is_text })
    }
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
                Self::Each(lists, Scalars::new(lists.values().as_ref(), texts)?)
            }
            DataType::List(_) => Self::Json(make_encoder(field, column, json)?),
            _ => Self::One(Scalars::new(column, texts)?),
        })
    }

    fn write(&mut self, row: usize, line: &mut Line) -> Result<(), ArrowError> {
        match self {
            Self::One(scalars) => line.cell(scalars, row)?,
            Self::Each(lists, scalars) => {
                let length = lists.value_length() as usize;
                for item in row * length..(row + 1) * length {
                    if lists.is_null(row) {
                        line.cells.push_field(b"");
                    } else {
                        line.cell(scalars, item)?;
                    }
                }
            }
            Self::Json(values) => {
                line.json.clear();
                if !values.is_null(row) {
                    values.encode(row, &mut line.json);
                }
                line.cells.push_field(&line.json);
            }
        }
        Ok(())
    }
}
