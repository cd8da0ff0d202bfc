//! Which rows and columns of a table are wanted, and what is worked out for them.
//! PURE. Uses: `dataset::{filter, force_map, schema}`, arrow. Never: files.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, FixedSizeListArray, Float32Array, RecordBatch,
    RecordBatchOptions,
};
use arrow_buffer::NullBuffer;
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::filter;
use super::force_map::{ForceMap, ForceMapSpec};
use super::schema;
use crate::problem::Problem;
use crate::simulate::schema as base;
use crate::store::Condition;

/// What is wanted of a table, as it is asked for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Wanted {
    /// Columns, in this order; empty: all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<String>,
    /// Conditions that all hold, each `COLUMN__gt=VALUE`.
    #[serde(rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// A force map for each row, as pixel and diameter in mm: `4x20`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Only these values of each frame: `0:28`, the end left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slice: Option<String>,
}

/// Extent of a skin, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skin {
    /// Along x.
    pub width_mm: f64,
    /// Along y.
    pub height_mm: f64,
}

/// What is wanted, checked against a table.
#[derive(Debug)]
pub struct Selection {
    table: SchemaRef,
    columns: Vec<usize>,
    filters: Vec<Condition>,
    map: Option<ForceMap>,
    slice: Option<(usize, usize)>,
    schema: SchemaRef,
}

impl Selection {
    /// Checks what is wanted of a table of these columns. Force maps need the skin's extent.
    ///
    /// # Errors
    /// All that is wrong, by key.
    pub fn new(
        wanted: &Wanted,
        table: &SchemaRef,
        skin: Option<Skin>,
    ) -> Result<Self, Vec<Problem>> {
        let mut problems = Vec::new();
        let mut wrong = |key: &str, value: &str, limit: String| {
            problems.push(Problem::new("request", key, value, limit));
        };
        let mut columns = Vec::new();
        for name in &wanted.columns {
            match table.index_of(name) {
                Ok(at) if columns.contains(&at) => {
                    wrong("columns", name, "is given twice".into());
                }
                Ok(at) => columns.push(at),
                Err(_) => {
                    let names: Vec<&str> =
                        table.fields().iter().map(|f| f.name().as_str()).collect();
                    wrong(
                        "columns",
                        name,
                        format!("there is no such column; there are {}", names.join(", ")),
                    );
                }
            }
        }
        if wanted.columns.is_empty() {
            columns = (0..table.fields().len()).collect();
        }
        let mut filters = Vec::new();
        for condition in &wanted.conditions {
            let parsed =
                Condition::parse(condition).and_then(|c| filter::fits(&c, table).map(|()| c));
            match parsed {
                Ok(filter) => filters.push(filter),
                Err(limit) => wrong("where", condition, limit),
            }
        }
        let map = wanted.map.as_ref().and_then(|text| {
            let Some(skin) = skin else {
                wrong("map", text, "these rows are of several skins: build a dataset".into());
                return None;
            };
            let spec = text.parse::<ForceMapSpec>();
            let map = spec.and_then(|spec| ForceMap::new(spec, skin.width_mm, skin.height_mm));
            map.map_err(|error| wrong("map", text, error.to_string())).ok()
        });
        let slice = wanted
            .slice
            .as_ref()
            .and_then(|text| slice(text, table).map_err(|limit| wrong("slice", text, limit)).ok());
        if !problems.is_empty() {
            return Err(problems);
        }
        let mut fields: Vec<Field> =
            columns.iter().map(|&at| sliced(table.field(at), slice)).collect();
        if let Some(map) = &map {
            fields.push(schema::force_map((map.pixels() * map.pixels()) as i32));
        }
        let schema = Arc::new(Schema::new(fields));
        Ok(Self { table: table.clone(), columns, filters, map, slice, schema })
    }

    /// The columns that come out.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// The wanted values of a frame.
    pub fn slice_of<'f>(&self, frame: &'f [f32]) -> &'f [f32] {
        self.slice.and_then(|(first, end)| frame.get(first..end)).unwrap_or(frame)
    }

    /// True when the rows come out as they are in the table.
    pub fn is_whole(&self) -> bool {
        self.filters.is_empty()
            && self.map.is_none()
            && self.slice.is_none()
            && self.columns.len() == self.table.fields().len()
            && self.columns.windows(2).all(|pair| pair[0] < pair[1])
    }

    /// True when every row comes out.
    pub fn keeps_all_rows(&self) -> bool {
        self.filters.is_empty()
    }

    /// Columns of the table that are read for these that come out.
    pub fn needed(&self, out: Option<&[usize]>) -> Vec<usize> {
        let all: Vec<usize> = (0..self.schema.fields().len()).collect();
        let mut needed: Vec<usize> = out
            .unwrap_or(&all)
            .iter()
            .filter_map(|&at| match self.columns.get(at) {
                Some(&column) => Some(column),
                None => self.table.index_of(base::CONTACTS).ok(),
            })
            .chain(self.filters.iter().filter_map(|f| self.table.index_of(f.column().name).ok()))
            .collect();
        needed.sort_unstable();
        needed.dedup();
        needed
    }

    /// Which rows of a batch stay; `None` for all.
    pub fn mask(&self, batch: &RecordBatch) -> Option<BooleanArray> {
        let mut masks = self.filters.iter().map(|condition| filter::mask(condition, batch));
        let first = masks.next()?;
        Some(masks.fold(first, |all, mask| {
            all.iter().zip(mask.iter()).map(|(a, b)| Some(a? && b?)).collect()
        }))
    }

    /// What comes out of rows that stay.
    pub fn apply(
        &self,
        batch: &RecordBatch,
        out: Option<&[usize]>,
    ) -> Result<RecordBatch, ArrowError> {
        let all: Vec<usize> = (0..self.schema.fields().len()).collect();
        let out = out.unwrap_or(&all);
        let schema = Arc::new(self.schema.project(out)?);
        let mut columns = Vec::with_capacity(out.len());
        for &at in out {
            columns.push(match self.columns.get(at) {
                Some(&column) => {
                    let name = self.table.field(column).name();
                    let found = batch.column_by_name(name).ok_or_else(|| {
                        ArrowError::SchemaError(format!("there is no column {name}"))
                    })?;
                    cut(found, self.table.field(column), self.slice)?
                }
                None => self.maps(batch)?,
            });
        }
        let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        RecordBatch::try_new_with_options(schema, columns, &options)
    }

    /// The force maps of rows; none where a contact has no place or no force.
    fn maps(&self, batch: &RecordBatch) -> Result<ArrayRef, ArrowError> {
        let (Some(map), Some(contacts)) = (&self.map, batch.column_by_name(base::CONTACTS)) else {
            return Err(ArrowError::SchemaError("a force map needs contacts".into()));
        };
        let pixels = map.pixels() * map.pixels();
        let mut values = vec![0.0_f32; pixels * batch.num_rows()];
        let mut known = Vec::with_capacity(batch.num_rows());
        for (row, out) in values.chunks_exact_mut(pixels).enumerate() {
            let pressed = pressed(contacts.as_list::<i32>().value(row).as_struct())?;
            known.push(pressed.is_some());
            if let Some(pressed) = pressed {
                map.render(&pressed, out)
                    .map_err(|error| ArrowError::InvalidArgumentError(error.to_string()))?;
            }
        }
        let field = schema::force_map(pixels as i32);
        let DataType::FixedSizeList(element, size) = field.data_type() else {
            return Err(ArrowError::SchemaError("a force map is a list".into()));
        };
        let nulls = NullBuffer::from(known);
        let values = Arc::new(Float32Array::from(values));
        let list = FixedSizeListArray::try_new(element.clone(), *size, values, Some(nulls))?;
        Ok(Arc::new(list))
    }
}

/// Place (mm, mm) and force (N) of a contact.
type Pressed = (f64, f64, f64);

/// Place and force of contacts, or `None` where one of them is not known.
fn pressed(contacts: &arrow_array::StructArray) -> Result<Option<Vec<Pressed>>, ArrowError> {
    let column = |name: &str| {
        let missing = || ArrowError::SchemaError(format!("a contact has no {name}"));
        contacts.column_by_name(name).ok_or_else(missing)
    };
    let x = column("x_mm")?.as_primitive::<Float64Type>();
    let y = column("y_mm")?.as_primitive::<Float64Type>();
    let force = column("force_n")?.as_primitive::<Float32Type>();
    let unknown = x.null_count() + y.null_count() + force.null_count() > 0;
    let of = |at| (x.value(at), y.value(at), f64::from(force.value(at)));
    Ok((!unknown).then(|| (0..contacts.len()).map(of).collect()))
}

fn slice(text: &str, table: &Schema) -> Result<(usize, usize), String> {
    let channels = table.fields().iter().find_map(|f| is_frame(f)).unwrap_or_default();
    let limit = || format!("must be FIRST:END within 0:{channels}, the end left out");
    let (first, end) = text.split_once(':').ok_or_else(limit)?;
    let (first, end): (usize, usize) =
        (first.parse().map_err(|_| limit())?, end.parse().map_err(|_| limit())?);
    if first < end && end <= channels { Ok((first, end)) } else { Err(limit()) }
}

/// The number of voltages, where a column holds frames.
fn is_frame(field: &Field) -> Option<usize> {
    match (field.name().as_str(), field.data_type()) {
        (schema::VOLTAGES_V | base::SIM_VOLTAGES_V, DataType::FixedSizeList(_, size)) => {
            Some(*size as usize)
        }
        _ => None,
    }
}

fn sliced(field: &Field, slice: Option<(usize, usize)>) -> Field {
    match (slice, is_frame(field)) {
        (Some((first, end)), Some(_)) => {
            base::voltages(field.name(), (end - first) as i32, field.is_nullable())
        }
        _ => field.clone(),
    }
}

/// A column, its frames cut where a slice is wanted.
fn cut(
    column: &ArrayRef,
    field: &Field,
    slice: Option<(usize, usize)>,
) -> Result<ArrayRef, ArrowError> {
    let (Some((first, end)), Some(channels)) = (slice, is_frame(field)) else {
        return Ok(column.clone());
    };
    let frames = column.as_fixed_size_list();
    let values = frames.values().as_primitive::<Float32Type>().values();
    let cut: Vec<f32> = (0..frames.len())
        .flat_map(|row| {
            let start = (frames.offset() + row) * channels;
            values[start + first..start + end].iter().copied()
        })
        .collect();
    let values = Arc::new(Float32Array::from(cut));
    let element = Arc::new(base::voltage_element());
    let nulls = frames.nulls().cloned();
    let list = FixedSizeListArray::try_new(element, (end - first) as i32, values, nulls)?;
    Ok(Arc::new(list))
}
