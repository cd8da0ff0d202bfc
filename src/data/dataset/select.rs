//! Selection of rows and columns of a table, with slices of frames and rendered force maps.
//! PURE. Uses: `dataset::{filter, force_map, schema}`, arrow. Never: files.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float32Array, RecordBatch, RecordBatchOptions,
};
use arrow_buffer::NullBuffer;
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use serde::{Deserialize, Serialize};
use sim_core::forward::Contact;
use utoipa::ToSchema;

use super::filter;
use super::force_map::{ForceMap, ForceMapSpec};
use super::schema;
use crate::problem::Problem;
use crate::simulate::schema as base;
use crate::store::Condition;

/// Requested rows and columns of a table, unchecked.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Wanted {
    /// Columns, in this order; empty: all columns.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<String>,
    /// Conditions, each `COLUMN__gt=VALUE`; all must hold.
    #[serde(rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Adds a force map per row, N per pixel: pixel and map diameter in mm, as in `4x20`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Only these values of each frame, as `FIRST:END`, end excluded: `0:28`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slice: Option<String>,
}

/// Extent of a skin, mm, as its sensor file states it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Skin {
    /// Extent along x, mm.
    pub width_mm: f64,
    /// Extent along y, mm.
    pub height_mm: f64,
}

/// Requested rows and columns, checked against a table.
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
    /// Checks a request against the columns of a table. Force maps need `skin`, the extent of the
    /// skin.
    ///
    /// # Errors
    /// All invalid values: unknown or repeated columns, conditions that do not fit the table, a
    /// force map without a skin or with an invalid resolution, a slice outside the frame.
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
                    wrong("columns", name, "must be given once".into());
                }
                Ok(at) => columns.push(at),
                Err(_) => {
                    let names: Vec<&str> =
                        table.fields().iter().map(|f| f.name().as_str()).collect();
                    wrong("columns", name, format!("must be a column: {}", names.join(", ")));
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
                let limit = "must be absent: these rows may be of several skins; make a dataset";
                wrong("map", text, limit.into());
                return None;
            };
            let spec = text.parse::<ForceMapSpec>();
            let map = spec.and_then(|spec| ForceMap::new(spec, [skin.width_mm, skin.height_mm]));
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

    /// Columns of the result.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// True if the result is the whole table, unchanged.
    pub fn is_whole(&self) -> bool {
        self.filters.is_empty()
            && self.map.is_none()
            && self.slice.is_none()
            && self.columns.len() == self.table.fields().len()
            && self.columns.windows(2).all(|pair| pair[0] < pair[1])
    }

    /// The conditions, all of which hold for the selected rows.
    pub fn filters(&self) -> &[Condition] {
        &self.filters
    }

    /// Indices of the table's columns that must be read for the columns `out` of the result
    /// (`None`: all), including those of the conditions. Sorted, without repetition.
    pub fn needed(&self, out: Option<&[usize]>) -> Vec<usize> {
        let all: Vec<usize> = (0..self.schema.fields().len()).collect();
        let mut needed: Vec<usize> = out
            .unwrap_or(&all)
            .iter()
            .filter_map(|&at| match self.columns.get(at) {
                Some(&column) => Some(column),
                None => self.table.index_of(base::CONTACTS).ok(),
            })
            .chain(
                self.filters
                    .iter()
                    .flat_map(Condition::columns)
                    .filter_map(|column| self.table.index_of(column.name).ok()),
            )
            .collect();
        needed.sort_unstable();
        needed.dedup();
        needed
    }

    /// Converts a batch of selected rows to the columns `out` of the result (`None`: all).
    ///
    /// # Errors
    /// `ArrowError` if the batch lacks a needed column, or a contact is outside the map's square.
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
                        ArrowError::SchemaError(format!("a batch lacks column {name}"))
                    })?;
                    cut(found, self.table.field(column), self.slice)?
                }
                None => self.maps(batch)?,
            });
        }
        let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        RecordBatch::try_new_with_options(schema, columns, &options)
    }

    /// Force maps of the rows; null if the position or force of a contact is unknown.
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
            return Err(ArrowError::SchemaError("a force map must be a list".into()));
        };
        let nulls = NullBuffer::from(known);
        let values = Arc::new(Float32Array::from(values));
        let list = FixedSizeListArray::try_new(element.clone(), *size, values, Some(nulls))?;
        Ok(Arc::new(list))
    }
}

/// Positions and forces of contacts; `None` if one of these values is unknown.
fn pressed(contacts: &arrow_array::StructArray) -> Result<Option<Vec<Contact>>, ArrowError> {
    let column = |name: &str| {
        let missing = || ArrowError::SchemaError(format!("contacts have no field {name}"));
        contacts.column_by_name(name).ok_or_else(missing)
    };
    let x = column("x_mm")?.as_primitive::<Float64Type>();
    let y = column("y_mm")?.as_primitive::<Float64Type>();
    let force = column("force_n")?.as_primitive::<Float32Type>();
    let unknown = x.null_count() + y.null_count() + force.null_count() > 0;
    let of =
        |at| Contact { x_mm: x.value(at), y_mm: y.value(at), force_n: f64::from(force.value(at)) };
    Ok((!unknown).then(|| (0..contacts.len()).map(of).collect()))
}

/// Parses `FIRST:END` and checks it against the frames of a table.
fn slice(text: &str, table: &Schema) -> Result<(usize, usize), String> {
    let channels = table.fields().iter().find_map(|f| self::channels(f)).unwrap_or_default();
    let limit = || format!("must be FIRST:END within 0:{channels}, end excluded");
    let (first, end) = text.split_once(':').ok_or_else(limit)?;
    let (first, end): (usize, usize) =
        (first.parse().map_err(|_| limit())?, end.parse().map_err(|_| limit())?);
    if first < end && end <= channels { Ok((first, end)) } else { Err(limit()) }
}

/// Number of voltages per frame; `None` if the column holds no frames.
fn channels(field: &Field) -> Option<usize> {
    match (field.name().as_str(), field.data_type()) {
        (schema::VOLTAGES_V | base::SIM_VOLTAGES_V, DataType::FixedSizeList(_, size)) => {
            Some(*size as usize)
        }
        _ => None,
    }
}

fn sliced(field: &Field, slice: Option<(usize, usize)>) -> Field {
    match (slice, channels(field)) {
        (Some((first, end)), Some(_)) => {
            base::voltages(field.name(), (end - first) as i32).with_nullable(field.is_nullable())
        }
        _ => field.clone(),
    }
}

/// A column of the result: frames are cut to the slice.
fn cut(
    column: &ArrayRef,
    field: &Field,
    slice: Option<(usize, usize)>,
) -> Result<ArrayRef, ArrowError> {
    let (Some((first, end)), Some(channels)) = (slice, channels(field)) else {
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
