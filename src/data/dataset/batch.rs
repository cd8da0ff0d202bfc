//! Trials as Arrow columns: a batch of the trials table from rows of the store, or from Sim-Random.
//! PURE. Uses: `store`'s rows, `dataset::schema`, arrow. Never: files.

use std::sync::Arc;

use arrow_array::builder::{FixedSizeListBuilder, Float32Builder, ListBuilder, StringBuilder};
use arrow_array::{
    ArrayRef, Float32Array, Float64Array, Int64Array, ListArray, RecordBatch, StringArray,
    StructArray, TimestampMillisecondArray, UInt8Array, UInt32Array, new_null_array,
};
use arrow_buffer::OffsetBuffer;
use arrow_cast::cast;
use arrow_schema::{ArrowError, DataType, Field, SchemaRef};
use jiff::Timestamp;

use super::schema;
use super::split::Part;
use crate::record::ARMS;
use crate::simulate::schema as base;
use crate::store::table::{Column, Of};
use crate::store::{Contact, TrialRow};

/// A labelled trial and its part of the split.
#[derive(Debug, Clone)]
pub struct Row {
    /// The trial. Contacts and contact count are the labels of the definition.
    pub trial: TrialRow,
    /// Part of the split; `None` if the dataset has no split.
    pub part: Option<Part>,
}

/// Converts rows of the store to a batch with the columns of `schema`.
///
/// # Errors
/// `ArrowError` if `schema` has a column that trials do not have, or if a frame has another length
/// than its column.
pub fn of_trials(schema: &SchemaRef, rows: &[Row]) -> Result<RecordBatch, ArrowError> {
    let columns = schema.fields().iter().map(|field| column(field, rows));
    RecordBatch::try_new(schema.clone(), columns.collect::<Result<_, _>>()?)
}

/// Converts a batch of a Sim-Random shard to the columns of `schema`; columns that shards do not
/// have are null. `parts` holds the part of each row.
///
/// # Errors
/// `ArrowError` if a column of the shard does not have the type of `schema`.
pub fn of_shard(
    schema: &SchemaRef,
    shard: &RecordBatch,
    parts: &[Option<Part>],
) -> Result<RecordBatch, ArrowError> {
    let rows = shard.num_rows();
    let columns = schema.fields().iter().map(|field| {
        let name = field.name().as_str();
        Ok(match shard.column_by_name(name) {
            // Its fields are nullable in the trials table.
            Some(column) if name == base::CONTACTS => cast(column, field.data_type())?,
            Some(column) => column.clone(),
            None => match name {
                schema::SPLIT => {
                    Arc::new(StringArray::from_iter(parts.iter().map(|p| p.map(Part::name))))
                }
                "label" => Arc::new(StringArray::from_iter_values(vec!["simulated"; rows])),
                _ => new_null_array(field.data_type(), rows),
            },
        })
    });
    RecordBatch::try_new(schema.clone(), columns.collect::<Result<_, ArrowError>>()?)
}

fn column(field: &Field, rows: &[Row]) -> Result<ArrayRef, ArrowError> {
    let trials = || rows.iter().map(|row| &row.trial);
    let Some(column) = Column::find(field.name()) else {
        return Err(ArrowError::SchemaError(format!("trials have no column {}", field.name())));
    };
    Ok(match column.of {
        Of::Id(of) => Arc::new(Int64Array::from_iter_values(trials().map(of))),
        Of::Count(of) => Arc::new(UInt32Array::from_iter(trials().map(of))),
        Of::Few(of) => Arc::new(UInt8Array::from_iter_values(trials().map(of))),
        Of::Number(of) => Arc::new(Float64Array::from_iter(trials().map(of))),
        Of::Single(of) => {
            Arc::new(Float32Array::from_iter(trials().map(|t| of(t).map(|v| v as f32))))
        }
        Of::Text(of) => Arc::new(trials().map(of).collect::<StringArray>()),
        Of::Time(of) => {
            let times = trials().map(|t| of(t).map(Timestamp::as_millisecond));
            Arc::new(TimestampMillisecondArray::from_iter(times).with_timezone("UTC"))
        }
        Of::Contacts => contacts(trials())?,
        Of::Forces => forces(trials()),
        Of::Flags => flags(trials())?,
        Of::Measured(of) | Of::Simulated(of) => frames(field, trials().map(of))?,
        Of::Part => {
            Arc::new(rows.iter().map(|row| row.part.map(Part::name)).collect::<StringArray>())
        }
        Of::Drawn => new_null_array(field.data_type(), rows.len()),
    })
}

fn contacts<'a>(
    trials: impl Iterator<Item = &'a TrialRow> + Clone,
) -> Result<ArrayRef, ArrowError> {
    let all = || trials.clone().flat_map(|t| &t.contacts);
    let single = |of: fn(&Contact) -> Option<f64>| -> ArrayRef {
        Arc::new(Float32Array::from_iter(all().map(|c| of(c).map(|v| v as f32))))
    };
    let columns: Vec<ArrayRef> = vec![
        Arc::new(Float64Array::from_iter(all().map(|c| c.x_mm))),
        Arc::new(Float64Array::from_iter(all().map(|c| c.y_mm))),
        single(|c| c.force_n),
        single(|c| c.diameter_mm),
    ];
    let element = schema::contact_element();
    let DataType::Struct(fields) = element.data_type() else {
        return Err(ArrowError::SchemaError("contacts must be a list of structs".into()));
    };
    let values = StructArray::try_new(fields.clone(), columns, None)?;
    let ends = OffsetBuffer::from_lengths(trials.map(|t| t.contacts.len()));
    Ok(Arc::new(ListArray::try_new(Arc::new(element), ends, Arc::new(values), None)?))
}

fn forces<'a>(trials: impl Iterator<Item = &'a TrialRow>) -> ArrayRef {
    let field = base::with_unit(Field::new(base::ELEMENT, DataType::Float32, true), "N");
    let mut forces =
        FixedSizeListBuilder::new(Float32Builder::new(), ARMS as i32).with_field(Arc::new(field));
    for trial in trials {
        for force_n in trial.forces_n {
            forces.values().append_option(force_n.map(|f| f as f32));
        }
        // A trial without load cells has no forces; arms without a tip have no value.
        forces.append(!trial.arms.is_empty());
    }
    Arc::new(forces.finish())
}

/// Converts frames to the column of `field`; a frame of another length is an error.
fn frames<'a>(
    field: &Field,
    frames: impl ExactSizeIterator<Item = Option<&'a [f32]>>,
) -> Result<ArrayRef, ArrowError> {
    let DataType::FixedSizeList(element, channels) = field.data_type() else {
        return Err(ArrowError::SchemaError(format!("column {} holds no frames", field.name())));
    };
    let values = Float32Builder::with_capacity(frames.len() * *channels as usize);
    let mut column = FixedSizeListBuilder::with_capacity(values, *channels, frames.len())
        .with_field(element.clone());
    for frame in frames {
        match frame {
            Some(frame) if frame.len() == *channels as usize => {
                column.values().append_slice(frame);
                column.append(true);
            }
            Some(frame) => {
                let found = frame.len();
                return Err(ArrowError::InvalidArgumentError(format!(
                    "{}: a frame has {found} voltages, expected {channels}",
                    field.name()
                )));
            }
            None => {
                column.values().append_value_n(f32::NAN, *channels as usize);
                column.append(false);
            }
        }
    }
    Ok(Arc::new(column.finish()))
}

fn flags<'a>(trials: impl Iterator<Item = &'a TrialRow>) -> Result<ArrayRef, ArrowError> {
    let element = Field::new(base::ELEMENT, DataType::Utf8, false);
    let mut flags = ListBuilder::new(StringBuilder::new()).with_field(Arc::new(element));
    for trial in trials {
        for flag in &trial.flags {
            flags.values().append_value(flag.as_str());
        }
        flags.append(true);
    }
    Ok(Arc::new(flags.finish()))
}
