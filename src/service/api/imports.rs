//! Imports of trials measured elsewhere, uploaded as a file.
//! Uses: `dataset::import`. Never: a whole file in memory, an upload that is kept.

use std::io::Write;

use axum::http::{HeaderMap, StatusCode};
use serde::Serialize;
use tracing::Instrument;
use utoipa::ToSchema;

use super::App;
use super::audit::{Act, cut};
use super::body::announced_bytes;
use super::form::{Form, invalid, missing};
use super::limits::WHO_MAX_CHARS;
use super::problem::{ApiError, ApiResult};
use super::send::Created;
use crate::dataset::error::DatasetError;
use crate::dataset::import::coordinates::Coordinates;
use crate::dataset::import::{Import, import};
use crate::dataset::making::MakingKind;
use crate::new_file::NewFile;
use crate::plain::violated;
use crate::store::{Label, RunRow};

/// Number of uploaded bytes between two checks of the free space.
const CHECKED_EVERY_BYTES: usize = 64 << 20;

/// Result of an import.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImportOut {
    /// The run that holds the trials.
    pub run: RunRow,
    /// Number of imported trials.
    pub trials: u64,
    /// Columns of the file that were ignored.
    pub columns_left_out: Vec<String>,
    /// Name of the dataset of all trials of the run.
    pub dataset: String,
}

/// Form of an import.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes the request for openapi.yaml")]
pub struct ImportForm {
    /// Trials: Parquet with columns of the trials table, CSV, NPZ, or MAT of version 5 to 7.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// Sensor file (TOML), at most 1 MiB.
    sensor: String,
    /// Name of the experiment, 1 to 100 characters.
    name: String,
    /// Origin of the data: `measured`, `virtual` or `simulated`.
    label: String,
    /// Map from the coordinates of the file to those of the skin: TOML with any of `rotate_deg`, `mirror_x`,
    /// `offset_mm` and `scale`; absent: the file has skin coordinates, mm.
    coordinates: Option<String>,
    /// Name of the person, for the log of actions.
    who: Option<String>,
}

#[derive(Default)]
struct Parts {
    file: Option<(String, NewFile)>,
    sensor: Option<(String, String)>,
    name: Option<String>,
    label: Option<Label>,
    coordinates: Coordinates,
    who: Option<String>,
}

/// Imports trials measured elsewhere as a new run.
#[utoipa::path(post, operation_id = "import_trials", path = "/api/v1/imports", tag = "datasets",
    request_body(content = ImportForm, content_type = "multipart/form-data"),
    responses((status = 201, body = ImportOut, headers(("Location", description = "the run"))),
        (status = 400,
            description = "a part of the form, the sensor file or a value of the file is invalid"),
        (status = 409,
            description = "the file was imported before with the same name, label and sensor, or another \
                           person holds the operator lock"),
        (status = 507, description = "the disk has no room for the trials")))]
pub async fn add(
    app: App,
    act: Act,
    headers: HeaderMap,
    form: Form,
) -> ApiResult<Created<ImportOut>> {
    app.datasets.check_upload(announced_bytes(&headers).unwrap_or(0)).await?;
    let parts = receive(&app, form).await?;
    act.stated(parts.who.as_deref(), None);
    app.still_allowed(&act).await?;
    let (file, upload) = parts.file.ok_or_else(|| missing("file"))?;
    let (sensor_file, sensor) = parts.sensor.ok_or_else(|| missing("sensor"))?;
    let request = Import {
        name: parts.name.ok_or_else(|| missing("name"))?,
        label: parts.label.ok_or_else(|| missing("label"))?,
        file,
        sensor_file,
        sensor,
        coordinates: parts.coordinates,
        submitted_by: act.name(),
    };
    let free = app.store.free_bytes().await?;
    let store = app.store.clone();
    let progress = app.datasets.making().begin(MakingKind::Import, &request.name);
    let importing = async move { import(&store, upload.path(), request, free, &progress).await };
    // It runs to its end even if its client disconnects: else a part of the trials would stay until the next start.
    let done = tokio::spawn(importing.in_current_span()).await;
    let done = done.map_err(|_| DatasetError::Worker)??;
    act.on(done.run.uid);
    let out = ImportOut {
        dataset: format!("run-{}", done.run.scan_id),
        run: done.run,
        trials: done.trials,
        columns_left_out: done.columns_left_out,
    };
    Ok(Created::at(format!("/api/v1/runs/{}", out.run.uid), out))
}

/// Receives the parts. The file is written to the disk as it arrives, and removed with the value.
async fn receive(app: &App, mut form: Form) -> ApiResult<Parts> {
    let mut parts = Parts::default();
    while let Some(mut part) = form.next().await? {
        let file = cut(&part.file_name(), WHO_MAX_CHARS);
        if part.name == "file" {
            let folder = app.datasets.uploads();
            let failed = |error: std::io::Error| {
                let words = format!("writing an upload in {}: {error}", folder.display());
                let status = match error.kind() {
                    std::io::ErrorKind::StorageFull => StatusCode::INSUFFICIENT_STORAGE,
                    _ => StatusCode::INTERNAL_SERVER_ERROR,
                };
                ApiError::new(status, words)
            };
            let mut upload = NewFile::create(&folder).map_err(failed)?;
            let mut unchecked = 0;
            while let Some(piece) = part.chunk().await? {
                upload.write_all(&piece).map_err(failed)?;
                unchecked += piece.len();
                // A body without a length, or a disk that something else fills meanwhile.
                if unchecked >= CHECKED_EVERY_BYTES {
                    unchecked = 0;
                    app.datasets.check_upload(0).await?;
                }
            }
            parts.file = Some((file, upload));
            continue;
        }
        let name = cut(&part.name, WHO_MAX_CHARS);
        let text = part.text().await?;
        let wrong = |limit: &str| invalid(&name, &cut(&text, WHO_MAX_CHARS), limit);
        match name.as_str() {
            "sensor" => parts.sensor = Some((file, text)),
            "name" => {
                let limit = match text.trim() {
                    "" => Some("must not be empty".into()),
                    name => violated(name, WHO_MAX_CHARS),
                };
                if let Some(limit) = limit {
                    return Err(wrong(&limit));
                }
                parts.name = Some(text.trim().into());
            }
            "coordinates" => {
                parts.coordinates =
                    Coordinates::from_toml(&file, &text).map_err(ApiError::bad_query)?;
            }
            "who" => parts.who = Some(text),
            "label" => match serde_json::from_value(text.clone().into()) {
                Ok(label) => parts.label = Some(label),
                Err(_) => return Err(wrong("must be measured, virtual or simulated")),
            },
            _ => {
                return Err(wrong(
                    "unknown part: must be file, sensor, name, label, coordinates or who",
                ));
            }
        }
    }
    Ok(parts)
}
