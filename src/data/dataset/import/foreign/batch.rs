//! Arrow columns of trials from plain values, in types that `rows` reads.
//! PURE. Uses: arrow, `store`'s contact, the names of its fields. Never: a check of a value.

use std::sync::Arc;

use arrow_array::builder::{ListBuilder, StringBuilder};
use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float32Array, Float64Array, ListArray, StringArray,
    StructArray, TimestampMillisecondArray,
};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_schema::{ArrowError, DataType, Field, Fields};
use jiff::Timestamp;

use crate::dataset::import::columns::CONTACT_FIELDS;
use crate::store::Contact;

/// Frames of `channels` voltages, V, one after the other; NaN for a missing channel. With `may_lack` a frame
/// of missing channels alone is an absent frame.
pub(super) fn frames(
    values: Vec<f32>,
    channels: usize,
    may_lack: bool,
) -> Result<ArrayRef, ArrowError> {
    let known = |frame: &[f32]| frame.iter().any(|v| !v.is_nan());
    let nulls = may_lack.then(|| values.chunks(channels.max(1)).map(known).collect::<NullBuffer>());
    let item = Arc::new(Field::new("item", DataType::Float32, true));
    let length = i32::try_from(channels)
        .map_err(|_| ArrowError::InvalidArgumentError("a frame has too many values".into()))?;
    let values = Arc::new(Float32Array::from(values));
    Ok(Arc::new(FixedSizeListArray::try_new(item, length, values, nulls)?))
}

/// Raw frames of each trial, `frames` of `channels` voltages, V, one after the other; NaN for a missing
/// channel. A frame of missing channels alone is absent, and with it, if it has no other, the list of a trial.
pub(super) fn raw_frames(
    values: &[f32],
    frames: usize,
    channels: usize,
) -> Result<ArrayRef, ArrowError> {
    let is_there = |frame: &&[f32]| frame.iter().any(|v| !v.is_nan());
    let mut kept: Vec<f32> = Vec::with_capacity(values.len());
    let mut lengths: Vec<usize> = Vec::new();
    for trial in values.chunks((frames * channels).max(1)) {
        let before = kept.len();
        trial.chunks(channels.max(1)).filter(is_there).for_each(|frame| kept.extend(frame));
        lengths.push((kept.len() - before) / channels.max(1));
    }
    let nulls: NullBuffer = lengths.iter().map(|length| *length > 0).collect();
    let kept = self::frames(kept, channels, false)?;
    let item = Arc::new(Field::new("item", kept.data_type().clone(), true));
    let ends = OffsetBuffer::from_lengths(lengths);
    Ok(Arc::new(ListArray::try_new(item, ends, kept, Some(nulls))?))
}

/// Contacts of each trial.
pub(super) fn contacts(trials: &[Vec<Contact>]) -> Result<ArrayRef, ArrowError> {
    let field = |name| Field::new(name, DataType::Float64, true);
    let fields: Fields = CONTACT_FIELDS.map(field).to_vec().into();
    let column = |of: fn(&Contact) -> Option<f64>| -> ArrayRef {
        Arc::new(trials.iter().flatten().map(of).collect::<Float64Array>())
    };
    let columns = vec![
        column(|c| c.x_mm),
        column(|c| c.y_mm),
        column(|c| c.force_n),
        column(|c| c.diameter_mm),
    ];
    let values = StructArray::try_new(fields.clone(), columns, None)?;
    let item = Arc::new(Field::new("item", DataType::Struct(fields), true));
    let ends = OffsetBuffer::from_lengths(trials.iter().map(Vec::len));
    Ok(Arc::new(ListArray::try_new(item, ends, Arc::new(values), None)?))
}

/// A contact, or `None` if neither position nor force is known. NaN is unknown.
pub(super) fn contact(values: [Option<f64>; 4]) -> Option<Contact> {
    let [x_mm, y_mm, force_n, diameter_mm] = values.map(|v| v.filter(|v| !v.is_nan()));
    let known = x_mm.or(y_mm).or(force_n).is_some();
    known.then_some(Contact { x_mm, y_mm, force_n, diameter_mm })
}

/// Numbers; NaN is unknown.
pub(super) fn numbers(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    Arc::new(values.map(|v| v.filter(|v| !v.is_nan())).collect::<Float64Array>())
}

/// Times, ms since 1970, UTC.
pub(super) fn times(values: Vec<Option<i64>>) -> ArrayRef {
    Arc::new(TimestampMillisecondArray::from(values).with_timezone("UTC"))
}

/// Texts; an empty one is unknown.
pub(super) fn texts<'t>(values: impl Iterator<Item = &'t str>) -> ArrayRef {
    let values = values.map(str::trim).map(|text| (!text.is_empty()).then_some(text));
    Arc::new(values.collect::<StringArray>())
}

/// Lists of words.
pub(super) fn words(values: impl Iterator<Item = Vec<String>>) -> ArrayRef {
    let mut lists = ListBuilder::new(StringBuilder::new());
    for words in values {
        words.into_iter().for_each(|word| lists.values().append_value(word));
        lists.append(true);
    }
    Arc::new(lists.finish())
}

/// Parses a list of words: as JSON, or separated by blanks, commas or semicolons.
///
/// # Errors
/// The limit as text.
pub(super) fn parse_words(text: &str) -> Result<Vec<String>, String> {
    let text = text.trim();
    if text.starts_with('[') {
        return serde_json::from_str(text)
            .map_err(|_| "must be words, or a list of words as JSON".into());
    }
    let words = text.split([' ', ',', ';', '\t']).filter(|word| !word.is_empty());
    Ok(words.map(str::to_owned).collect())
}

/// Parses a time with its offset from UTC; `None` if the text is empty.
///
/// # Errors
/// The limit as text.
pub(super) fn parse_time(text: &str) -> Result<Option<i64>, String> {
    match text.trim() {
        "" | "NaT" => Ok(None),
        text => text
            .parse::<Timestamp>()
            .map(|at| Some(at.as_millisecond()))
            .map_err(|_| "must be a time with its offset, as 2026-11-20T18:00:00Z".into()),
    }
}
