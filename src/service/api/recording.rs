//! Recordings: the frames of the stream from the request on, as rows in a format of datasets.
//! Uses: the campaign's frames, `dataset::format`. Never: a file of the service, a frame without its label.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use arrow_array::{
    FixedSizeListArray, Float32Array, RecordBatch, StringArray, TimestampMillisecondArray,
    UInt32Array, UInt64Array,
};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef, TimeUnit};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::Response;
use futures::stream::unfold;
use jiff::Timestamp;
use serde::Deserialize;
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};
use tokio::time::timeout;
use utoipa::IntoParams;

use super::encoder::RowEncoder;
use super::limits::{FRAME_CLIENTS, RECORDED_FRAMES};
use super::problem::{ApiError, ApiResult, Params};
use super::query::for_pages;
use super::send::set;
use super::turns::place;
use super::{App, accept};
use crate::campaign::bench::rig_state::RigState;
use crate::dataset::format::Format;
use crate::dataset::schema::VOLTAGES_V;
use crate::rig::traits::Frame;
use crate::simulate::schema::{voltage_element, voltages, with_unit};

/// Longest time without a frame; the recording then ends.
const SILENT: Duration = Duration::from_secs(10);
/// Frames of a batch: about one second of them.
const BATCH_FRAMES: usize = 30;

/// Media type that clients made from the description of the API ask for: of any format, NDJSON unless one is named.
const STREAM_TYPE: &str = "application/octet-stream";

/// What is recorded, and how it is written.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct RecordingParams {
    /// Number of frames, 1 to 9000.
    #[param(minimum = 1, maximum = 9000)]
    pub frames: usize,
    /// Format of the rows: one of the vocabulary that streams; absent: that of the `Accept` header, or ndjson.
    pub format: Option<String>,
}

/// Records frames of the stream: the response has a row per frame, and ends with the last one.
///
/// Columns: wall time `at`, `label` (`virtual` or `measured`), `sequence` and `device_time_us` of the device, and
/// `voltages_v`. Gaps of `sequence` are frames that were not received. After 10 s without a frame, and when the
/// service ends, the response ends with an error; rows of a text that came before are whole. The service keeps nothing.
#[utoipa::path(get, operation_id = "record_frames", path = "/api/v1/frames/recording",
    tag = "frames", params(RecordingParams),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 400, description = "`frames` is not 1 to 9000, or the format is not one of rows"),
        (status = 409, description = "the rig is disconnected: no frames come"),
        (status = 503, description = "too many clients are connected")))]
pub async fn record(
    app: App,
    headers: HeaderMap,
    Params(asked): Params<RecordingParams>,
) -> ApiResult<Response> {
    let frames = asked.frames;
    if !(1..=RECORDED_FRAMES).contains(&frames) {
        let limit = format!("must be 1 to {RECORDED_FRAMES}");
        return Err(ApiError::query("frames", frames, &limit));
    }
    let format = match asked.format.as_deref() {
        None => accept::accepted(&headers, STREAM_TYPE)?.unwrap_or(Format::Ndjson),
        Some(name) => name
            .parse::<Format>()
            .map_err(|error| ApiError::query("format", name, &error.to_string()))?,
    };
    for_pages(format).map_err(ApiError::bad_query)?;
    if app.campaign.status().rig.state == RigState::Disconnected {
        let words =
            "no frames come: the rig is disconnected; connect it first (palpate rig connect)";
        return Err(ApiError::new(StatusCode::CONFLICT, words));
    }
    let place = place(&app.turns.frames, (FRAME_CLIENTS, "live frames"))?;
    let label = app.facts.rig.config.label().as_str();
    let schema = schema(app.serving.sensor().channels() as i32);
    let encoder = RowEncoder::new(format, &schema)?;
    let source = app.campaign.follow_frames();
    let ending = app.facts.ending.clone();
    let recording =
        Recording { source, ending, label, schema, left: frames, is_cut: false, _place: place };
    let batches = unfold(recording, Recording::next_batch);
    let mut response = encoder.response(batches, "a recording is incomplete");
    let at = Timestamp::now().strftime("%Y-%m-%dT%H%M%S");
    let name = format!("attachment; filename=\"frames-{label}-{at}.{}\"", format.extension());
    set(&mut response, header::CONTENT_DISPOSITION, &name);
    Ok(response)
}

/// A frame, and the wall time at which it arrived.
type Taken = (Timestamp, Arc<Frame>);

/// A recording in progress.
struct Recording {
    source: broadcast::Receiver<Arc<Frame>>,
    ending: watch::Receiver<bool>,
    label: &'static str,
    schema: SchemaRef,
    /// Number of frames that are still to be recorded.
    left: usize,
    /// No more frames come, although some are left.
    is_cut: bool,
    _place: OwnedSemaphorePermit,
}

impl Recording {
    /// The next batch, and the recording; none if it is complete. One that is cut ends with an error, so that nobody
    /// takes it for complete.
    async fn next_batch(mut self) -> Option<(io::Result<RecordBatch>, Self)> {
        let most = self.left.min(BATCH_FRAMES);
        let mut taken = Vec::with_capacity(most);
        while !self.is_cut && taken.len() < most {
            match self.next_frame().await {
                Some(frame) => taken.push(frame),
                None => self.is_cut = true,
            }
        }
        self.left -= taken.len();
        let next = if !taken.is_empty() {
            batch(&self.schema, self.label, &taken).map_err(io::Error::other)
        } else if self.is_cut {
            let words = format!("no more frames: {} of the recording are missing", self.left);
            Err(io::Error::other(words))
        } else {
            return None;
        };
        Some((next, self))
    }

    /// Waits for the next frame; none if none comes, or if the service ends.
    async fn next_frame(&mut self) -> Option<Taken> {
        loop {
            let frame = tokio::select! {
                frame = timeout(SILENT, self.source.recv()) => frame.ok()?,
                _ = self.ending.wait_for(|ends| *ends) => return None,
            };
            match frame {
                Ok(frame) => {
                    let at = Timestamp::now();
                    return Some((at.checked_sub(frame.received.elapsed()).unwrap_or(at), frame));
                }
                // Its gap is found in the sequences.
                Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => return None,
            }
        }
    }
}

fn schema(channels: i32) -> SchemaRef {
    let at = DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into()));
    Arc::new(Schema::new(vec![
        Field::new("at", at, false),
        Field::new("label", DataType::Utf8, false),
        Field::new("sequence", DataType::UInt32, false),
        with_unit(Field::new("device_time_us", DataType::UInt64, false), "us"),
        voltages(VOLTAGES_V, channels),
    ]))
}

/// Frames as a batch of `schema`.
///
/// # Errors
/// `ArrowError` if a frame has another number of channels than the sensor.
fn batch(schema: &SchemaRef, label: &str, taken: &[Taken]) -> Result<RecordBatch, ArrowError> {
    let frames = || taken.iter().map(|(_, frame)| frame);
    let at = taken.iter().map(|(at, _)| at.as_millisecond());
    let DataType::FixedSizeList(_, channels) = schema.field(schema.fields().len() - 1).data_type()
    else {
        return Err(ArrowError::SchemaError(format!("{VOLTAGES_V} holds no frames")));
    };
    let wanted = *channels as usize;
    if let Some(other) = frames().find(|frame| frame.counts.len() != wanted) {
        let found = other.counts.len();
        let words = format!("a frame has {found} voltages, expected {wanted}");
        return Err(ArrowError::InvalidArgumentError(words));
    }
    let volts = Float32Array::from_iter_values(frames().flat_map(|frame| frame.voltages_v()));
    let element = Arc::new(voltage_element());
    let rows = taken.len();
    RecordBatch::try_new(
        schema.clone(),
        vec![
            Arc::new(TimestampMillisecondArray::from_iter_values(at).with_timezone("UTC")),
            Arc::new(StringArray::from_iter_values(std::iter::repeat_n(label, rows))),
            Arc::new(UInt32Array::from_iter_values(frames().map(|frame| frame.sequence))),
            Arc::new(UInt64Array::from_iter_values(frames().map(|frame| frame.device_time_us))),
            Arc::new(FixedSizeListArray::try_new(element, *channels, Arc::new(volts), None)?),
        ],
    )
}

#[cfg(test)]
mod tests {
    use futures::StreamExt;
    use tokio::time::Instant;

    use super::*;

    fn taken(sequence: u32, counts: Vec<i16>) -> Taken {
        let frame = Frame {
            sequence,
            device_time_us: 40 * u64::from(sequence),
            volts_per_count: 0.5,
            counts,
            received: Instant::now(),
        };
        (Timestamp::from_millisecond(1_795_000_000_250).unwrap(), Arc::new(frame))
    }

    #[test]
    fn a_row_has_the_label_the_counters_and_the_voltages_of_its_frame() {
        let schema = schema(4);
        let frames = [taken(7, vec![2, -2, 4, 0]), taken(9, vec![1, 1, 1, 1])];
        let mut lines = RowEncoder::new(Format::Ndjson, &schema).unwrap();
        lines.push(&batch(&schema, "virtual", &frames).unwrap()).unwrap();
        let text = String::from_utf8(lines.finish().unwrap()).unwrap();
        let rows: Vec<serde_json::Value> =
            text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[1]["sequence"], 9);
        assert_eq!(rows[1]["device_time_us"], 360);
        assert_eq!(rows[0]["label"], "virtual");
        assert_eq!(rows[0]["voltages_v"], serde_json::json!([1.0, -1.0, 2.0, 0.0]));
        assert!(rows[0]["at"].as_str().unwrap().starts_with("2026-11-18T11:06:40.25"), "{text}");
    }

    #[test]
    fn a_frame_of_another_size_is_refused() {
        let refused = batch(&schema(4), "virtual", &[taken(1, vec![1, 2, 3])]).unwrap_err();
        assert!(refused.to_string().contains("3 voltages, expected 4"), "{refused}");
    }

    #[tokio::test]
    async fn a_recording_whose_frames_stop_ends_with_an_error() {
        let (frames, source) = broadcast::channel(1);
        let (_ending, ending) = watch::channel(false);
        let encoder = RowEncoder::new(Format::Ndjson, &schema(1)).unwrap();
        let recording = Recording {
            source,
            ending,
            label: "virtual",
            schema: schema(1),
            left: 3,
            is_cut: false,
            _place: Arc::new(tokio::sync::Semaphore::new(1)).try_acquire_owned().unwrap(),
        };
        frames.send(taken(1, vec![1]).1).unwrap();
        drop(frames);
        let response = encoder.response(unfold(recording, Recording::next_batch), "cut");
        let mut pieces = response.into_body().into_data_stream();
        let first = pieces.next().await.unwrap().unwrap();
        assert!(String::from_utf8(first.to_vec()).unwrap().contains("\"sequence\":1"));
        let end = pieces.next().await.unwrap().unwrap_err();
        assert_eq!(end.to_string(), "no more frames: 2 of the recording are missing");
        assert!(pieces.next().await.is_none());
    }
}
