//! Trials as columns: a batch of the trials table from rows of the store, or from Sim-Random.
//! PURE. Uses: `store`'s rows, `dataset::schema`, arrow. Never: files.

use std::sync::Arc;

use arrow_array::builder::{
    FixedSizeListBuilder, Float32Builder, ListBuilder, PrimitiveBuilder, StringBuilder,
};
use arrow_array::types::{ArrowPrimitiveType, Float32Type};
use arrow_array::{
    ArrayRef, Float32Array, Float64Array, Int64Array, ListArray, RecordBatch, StringArray,
    StructArray, TimestampMillisecondArray, UInt8Array, UInt32Array, new_null_array,
};
use arrow_buffer::OffsetBuffer;
use arrow_schema::{ArrowError, DataType, Field, SchemaRef};
use jiff::Timestamp;

use super::schema::{self, ARMS};
use super::split::Part;
use crate::simulate::schema as base;
use crate::store::{Contact, TrialRow};

/// A labelled trial and its part.
#[derive(Debug, Clone)]
pub struct Row {
    /// The trial, with contacts and count as they are labelled.
    pub trial: TrialRow,
    /// Its part, where the rows are divided.
    pub part: Option<Part>,
}

/// Rows as a batch of these columns.
pub fn of_trials(schema: &SchemaRef, rows: &[Row]) -> Result<RecordBatch, ArrowError> {
    let columns = schema.fields().iter().map(|field| column(field, rows));
    RecordBatch::try_new(schema.clone(), columns.collect::<Result<_, _>>()?)
}

/// A batch of Sim-Random shards in these columns; what it does not have is null.
pub fn of_shard(
    schema: &SchemaRef,
    shard: &RecordBatch,
    parts: &[Option<Part>],
) -> Result<RecordBatch, ArrowError> {
    let rows = shard.num_rows();
    let columns = schema.fields().iter().map(|field| {
        let name = field.name().as_str();
        Ok(match shard.column_by_name(name) {
            Some(column) if name == base::CONTACTS => nullable_contacts(column)?,
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

/// The same contacts, in a type that could lack some of their numbers.
fn nullable_contacts(column: &ArrayRef) -> Result<ArrayRef, ArrowError> {
    use arrow_array::cast::AsArray;
    let lists = column.as_list::<i32>();
    let contacts = lists.values().as_struct();
    let element = schema::contact_element();
    let DataType::Struct(fields) = element.data_type() else {
        return Err(ArrowError::SchemaError("a contact is a struct".into()));
    };
    let values = StructArray::try_new(fields.clone(), contacts.columns().to_vec(), None)?;
    let list =
        ListArray::try_new(Arc::new(element), lists.offsets().clone(), Arc::new(values), None)?;
    Ok(Arc::new(list))
}

fn column(field: &Field, rows: &[Row]) -> Result<ArrayRef, ArrowError> {
    let trials = || rows.iter().map(|row| &row.trial);
    let whole = |of: fn(&TrialRow) -> Option<u32>| -> ArrayRef {
        Arc::new(UInt32Array::from_iter(trials().map(of)))
    };
    let number = |of: fn(&TrialRow) -> Option<f64>| -> ArrayRef {
        Arc::new(Float64Array::from_iter(trials().map(of)))
    };
    let small = |of: fn(&TrialRow) -> u8| -> ArrayRef {
        Arc::new(UInt8Array::from_iter_values(trials().map(of)))
    };
    Ok(match field.name().as_str() {
        "trial_id" => Arc::new(Int64Array::from_iter_values(trials().map(|t| t.trial_id.0))),
        "run" => text(trials().map(|t| Some(t.run.to_string()))),
        "scan_id" => Arc::new(Int64Array::from_iter_values(trials().map(|t| t.scan_id))),
        base::EXPERIMENT => text(trials().map(|t| Some(&t.experiment))),
        "label" => text(trials().map(|t| Some(t.label.as_str()))),
        "configuration" => whole(|t| Some(t.configuration)),
        "depth_index" => whole(|t| Some(t.depth_index)),
        "attempt" => whole(|t| Some(t.attempt)),
        "depth_mm" => number(|t| t.depth_mm),
        "tips" => small(|t| t.tips),
        base::CONTACT_COUNT => small(|t| t.contact_count),
        base::MAX_FORCE_N => {
            Arc::new(Float32Array::from_iter(trials().map(|t| t.max_force_n.map(|f| f as f32))))
        }
        base::CONTACTS => contacts(trials())?,
        schema::FORCES_N => forces(trials()),
        schema::VOLTAGES_V => frames(field, trials().map(|t| t.voltages_v.as_deref()))?,
        base::SIM_VOLTAGES_V => frames(field, trials().map(|t| t.sim_voltages_v.as_deref()))?,
        "sim_model" => text(trials().map(|t| t.sim_model.as_ref())),
        "rmse_v" => number(|t| t.rmse_v),
        "fvu" => number(|t| t.fvu),
        "flags" => flags(trials())?,
        "saturated_channels" => whole(|t| t.quality.saturated_channels),
        "stuck_channels" => whole(|t| t.quality.stuck_channels),
        "missing_channels" => whole(|t| t.quality.missing_channels),
        "injection_sum_v" => number(|t| t.quality.injection_sum_v),
        "dropped_packets" => whole(|t| t.quality.dropped_packets),
        "depth_error_mm" => number(|t| Some(t.reached?.z_mm - t.target?.z_mm)),
        "settle_ms" => number(|t| t.settle_ms),
        "overshoot_n" => number(|t| t.overshoot_n),
        "frame_count" => whole(|t| Some(t.frame_count)),
        "started_at" => times(trials().map(|t| t.started_at)),
        "measured_at" => times(trials().map(|t| t.measured_at)),
        schema::SPLIT => text(rows.iter().map(|row| row.part.map(Part::name))),
        // Of Sim-Random alone.
        _ => new_null_array(field.data_type(), rows.len()),
    })
}

fn text<T: AsRef<str>>(values: impl Iterator<Item = Option<T>>) -> ArrayRef {
    Arc::new(values.collect::<StringArray>())
}

fn times(values: impl Iterator<Item = Option<Timestamp>>) -> ArrayRef {
    let times = values.map(|time| time.map(Timestamp::as_millisecond));
    Arc::new(TimestampMillisecondArray::from_iter(times).with_timezone("UTC"))
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
        return Err(ArrowError::SchemaError("a contact is a struct".into()));
    };
    let values = StructArray::try_new(fields.clone(), columns, None)?;
    let ends = OffsetBuffer::from_lengths(trials.map(|t| t.contacts.len()));
    Ok(Arc::new(ListArray::try_new(Arc::new(element), ends, Arc::new(values), None)?))
}

fn forces<'a>(trials: impl Iterator<Item = &'a TrialRow>) -> ArrayRef {
    let field = base::with_unit(Field::new(base::ELEMENT, DataType::Float32, true), "N");
    let mut forces =
        FixedSizeListBuilder::new(Float32Builder::new(), ARMS).with_field(Arc::new(field));
    for trial in trials {
        for force_n in trial.forces_n {
            forces.values().append_option(force_n.map(|f| f as f32));
        }
        // A trial without cells has no forces; one with fewer tips has no value for the others.
        forces.append(!trial.arms.is_empty());
    }
    Arc::new(forces.finish())
}

/// Frames as a column of this field; one of another length is an error.
fn frames<'a>(
    field: &Field,
    frames: impl Iterator<Item = Option<&'a [f32]>>,
) -> Result<ArrayRef, ArrowError> {
    let DataType::FixedSizeList(element, channels) = field.data_type() else {
        return Err(ArrowError::SchemaError(format!("{} is no frame", field.name())));
    };
    let values: PrimitiveBuilder<Float32Type> = PrimitiveBuilder::new();
    let mut column = FixedSizeListBuilder::new(values, *channels).with_field(element.clone());
    for frame in frames {
        match frame {
            Some(frame) if frame.len() == *channels as usize => {
                column.values().append_slice(frame);
                column.append(true);
            }
            Some(frame) => {
                let found = frame.len();
                return Err(ArrowError::InvalidArgumentError(format!(
                    "{}: a frame of {found} voltages among frames of {channels}",
                    field.name()
                )));
            }
            None => {
                column.values().append_value_n(
                    <Float32Type as ArrowPrimitiveType>::Native::NAN,
                    *channels as usize,
                );
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
