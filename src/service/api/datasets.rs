//! Datasets: lists, lineage, cards, rows by pages and as files.
//! Uses: `dataset::catalog`. Never: SQL, a row that is not in a dataset's file.

use axum::Json;
use axum::extract::{Query, Request, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::audit::Act;
use super::params::{FileParams, RowsParams};
use super::problem::{ApiError, Body, Path, ProblemBody};
use super::query::{file_query, for_pages, rows_query};
use super::send::{self, Download};
use crate::dataset::definition::Definition;
use crate::dataset::error::DatasetError;
use crate::dataset::format::{Format, Rows, UnknownFormat};
use crate::ids::DatasetId;
use crate::store::DatasetRow;

/// A dataset.
#[derive(Debug, Serialize, ToSchema)]
pub struct DatasetOut {
    /// `ds-` and the start of a sha256 over its definition, its rows and its columns.
    pub id: DatasetId,
    /// Name of the definition.
    pub name: String,
    /// The definition.
    #[schema(value_type = Definition)]
    pub definition: Value,
    /// Number of rows.
    pub rows: u64,
    /// Length of the Parquet file, bytes.
    pub bytes: u64,
    /// sha256 of the Parquet file, in hexadecimal digits.
    pub sha256: String,
    /// Number of rows by part and by number of contacts, number of excluded trials by reason,
    /// columns with types and units.
    #[schema(value_type = Object)]
    pub report: Value,
    /// Time at which the dataset was made.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// Address of the Parquet file, for pandas, polars and DuckDB.
    pub url: String,
}

impl From<DatasetRow> for DatasetOut {
    fn from(row: DatasetRow) -> Self {
        Self {
            url: format!("/api/v1/data/{}.parquet", row.id),
            id: row.id,
            name: row.name,
            definition: row.definition,
            rows: row.rows,
            bytes: row.bytes,
            sha256: row.sha256,
            report: row.report,
            created_at: row.created_at,
        }
    }
}

/// The datasets of a service.
#[derive(Debug, Serialize, ToSchema)]
pub struct Datasets {
    /// Existing datasets, newest first.
    pub datasets: Vec<DatasetOut>,
    /// Names of the built-in definitions. These, and `run-N` for each ended run, are made on
    /// request.
    pub definitions: Vec<&'static str>,
}

/// Request for a dataset: exactly one of `name`, `definition` and `toml`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DatasetRequest {
    /// Name of a built-in definition, of an existing dataset, or of a run (`run-N`).
    pub name: Option<String>,
    /// A definition.
    pub definition: Option<Definition>,
    /// Text of a definition file.
    pub toml: Option<String>,
    /// Name of the definition in messages; default `definition`.
    pub file: Option<String>,
}

/// A page of a dataset's rows.
#[derive(Debug, Serialize, ToSchema)]
pub struct RowsPage {
    /// Id of the dataset.
    pub dataset: DatasetId,
    /// The rows; a null value is absent.
    #[schema(value_type = Vec<Object>)]
    pub rows: Vec<Box<serde_json::value::RawValue>>,
    /// Value of `cursor` for the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<String>,
}

type Pairs = Query<Vec<(String, String)>>;

/// Returns the existing datasets, and the names of the built-in definitions.
#[utoipa::path(get, operation_id = "list_datasets", path = "/api/v1/datasets", tag = "datasets",
    responses((status = 200, body = Datasets)))]
pub async fn list(State(app): State<App>) -> Result<Json<Datasets>, ApiError> {
    let datasets = app.store.datasets().await?.into_iter().map(DatasetOut::from).collect();
    Ok(Json(Datasets { datasets, definitions: Definition::built_in_names().collect() }))
}

/// Makes a dataset from the stored trials, or returns the existing one.
#[utoipa::path(post, operation_id = "make_dataset",
    path = "/api/v1/datasets", tag = "datasets", request_body = DatasetRequest,
    responses((status = 200, body = DatasetOut),
        (status = 400, body = ProblemBody,
            description = "the definition is invalid, or its name is in use"),
        (status = 404, body = ProblemBody,
            description = "no dataset, run or folder of shards has the name, or no rows are selected"),
        (status = 409, body = ProblemBody,
            description = "the runs differ in label, frame length or model, or a run has not ended"),
        (status = 422, body = ProblemBody,
            description = "the body is invalid, or has not exactly one of name, definition and toml")))]
pub async fn make(
    State(app): State<App>,
    act: Act,
    Body(new): Body<DatasetRequest>,
) -> Result<Json<DatasetOut>, ApiError> {
    let file = new.file.as_deref().unwrap_or("definition");
    let row = match (new.name, new.definition, new.toml) {
        (Some(name), None, None) => app.datasets.resolve(&name).await?,
        (None, Some(definition), None) => app.datasets.make_custom(file, &definition).await?,
        (None, None, Some(text)) => {
            let definition = Definition::from_toml(file, &text).map_err(DatasetError::Problems)?;
            app.datasets.make_custom(file, &definition).await?
        }
        _ => {
            let limit = "must have exactly one of name, definition and toml";
            let problem = crate::problem::Problem::whole("request", limit);
            return Err(ApiError::problems(vec![problem]));
        }
    };
    act.about(row.id.as_str());
    Ok(Json(row.into()))
}

/// Returns the dataset with an id, or the current dataset of a name.
///
/// The dataset of a name is made if needed.
#[utoipa::path(get, operation_id = "dataset", path = "/api/v1/datasets/{dataset}", tag = "datasets",
    params(("dataset" = String, Path, description = "id or name")),
    responses((status = 200, body = DatasetOut),
        (status = 404, body = ProblemBody,
            description = "no dataset has this id or name, or its definition selects no rows")))]
pub async fn one(
    State(app): State<App>,
    Path(dataset): Path<String>,
) -> Result<Json<DatasetOut>, ApiError> {
    Ok(Json(app.datasets.resolve(&dataset).await?.into()))
}

/// Returns the lineage of a dataset: runs, models, calibrations, shards and code.
#[utoipa::path(get, operation_id = "dataset_lineage",
    path = "/api/v1/datasets/{dataset}/lineage", tag = "datasets",
    params(("dataset" = String, Path, description = "id or name")),
    responses((status = 200, body = Object),
        (status = 404, body = ProblemBody,
            description = "no dataset has this id or name, or its definition selects no rows")))]
pub async fn lineage(
    State(app): State<App>,
    Path(dataset): Path<String>,
) -> Result<Json<Value>, ApiError> {
    let row = app.datasets.resolve(&dataset).await?;
    Ok(Json(serde_json::json!({
        "dataset": row.id, "sha256": row.sha256, "definition": row.definition,
        "lineage": row.lineage,
    })))
}

/// Returns the card of a dataset in Markdown: content, units, quality, origin and citation.
#[utoipa::path(get, operation_id = "dataset_card",
    path = "/api/v1/datasets/{dataset}/card", tag = "datasets",
    params(("dataset" = String, Path, description = "id or name")),
    responses((status = 200, body = String, content_type = "text/markdown"),
        (status = 404, body = ProblemBody,
            description = "no dataset has this id or name, or its definition selects no rows")))]
pub async fn card(
    State(app): State<App>,
    Path(dataset): Path<String>,
) -> Result<Response, ApiError> {
    let row = app.datasets.resolve(&dataset).await?;
    let text = app.datasets.card(&row.id)?;
    Ok(([(header::CONTENT_TYPE, "text/markdown; charset=utf-8")], text).into_response())
}

/// Returns a page of the rows of a dataset.
///
/// In a format other than JSON the cursor of the next page is in the header `x-next-cursor`.
#[utoipa::path(get, operation_id = "dataset_rows",
    path = "/api/v1/datasets/{dataset}/rows", tag = "datasets",
    params(("dataset" = String, Path, description = "id or name"), RowsParams),
    responses((status = 200, body = RowsPage),
        (status = 400, body = ProblemBody, description = "a parameter is unknown or invalid")))]
pub async fn rows(
    State(app): State<App>,
    Path(dataset): Path<String>,
    Query(pairs): Pairs,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let requested = rows_query(&pairs).map_err(ApiError::bad_query)?;
    let format = requested.format.or_else(|| send::accepted(&headers));
    format.map_or(Ok(()), for_pages).map_err(ApiError::bad_query)?;
    let row = app.datasets.resolve(&dataset).await?;
    let catalog = app.datasets.clone();
    let reading = tokio::task::spawn_blocking(move || {
        let rows = catalog.rows(&row.id, &requested.wanted)?;
        send::check_numbers(&rows.schema(), requested.limit)?;
        let limit = requested.limit as usize;
        let (batches, next) = match &requested.sort {
            Some(sort) => rows.sorted_page(sort, requested.from, limit)?,
            None => rows.page(requested.from, limit)?,
        };
        let next = next.map(|next| next.to_string());
        match format {
            Some(format) => send::batches(format, &rows.schema(), &batches, next),
            None => {
                let mut lines =
                    crate::dataset::format::Stream::new(Format::Ndjson, &rows.schema(), Vec::new())
                        .map_err(DatasetError::from)?;
                for batch in &batches {
                    lines.push(batch).map_err(DatasetError::from)?;
                }
                let lines = lines.finish().map_err(DatasetError::from)?;
                let rows = send::values(&lines)?;
                Ok(Json(RowsPage { dataset: row.id, rows, next }).into_response())
            }
        }
    });
    reading.await.map_err(|_| ApiError::from(DatasetError::Worker))?
}

/// Returns a dataset as a file: `real.parquet`, `ds-0123.npz`, `run-3.csv`.
///
/// The header `Range` selects a part; the entity tag is the sha256 of the file. The dataset of a
/// name and the file are made if needed. For a large dataset request an export, which shows its
/// progress.
#[utoipa::path(get, operation_id = "dataset_file", path = "/api/v1/data/{file}", tag = "datasets",
    params(("file" = String, Path,
        description = "ID_OR_NAME.FORMAT, with a format of `ExportRequest`"), FileParams),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 206, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 304),
        (status = 400, body = ProblemBody, description = "a parameter is unknown or invalid"),
        (status = 404, body = ProblemBody,
            description = "no dataset has this id or name, or the format is unknown")))]
pub async fn data(
    State(app): State<App>,
    Path(file): Path<String>,
    Query(pairs): Pairs,
    request: Request,
) -> Result<Response, ApiError> {
    let (name, extension) = file.rsplit_once('.').unwrap_or((&file, ""));
    let by_extension = Format::ALL.into_iter().find(|format| format.extension() == extension);
    let format = by_extension.map_or_else(|| extension.parse(), Ok);
    let format: Format =
        format.map_err(|error: UnknownFormat| ApiError::not_found(format!("{file}: {error}")))?;
    let wanted = file_query(&pairs).map_err(ApiError::bad_query)?;
    let row = app.datasets.resolve(name).await?;
    let export_file = app.datasets.file(&row, format, &wanted, std::sync::Arc::default()).await?;
    let shown = format!("{}.{}", row.id, format.extension());
    let download = Download { name: &shown, immutable: name == row.id.as_str() };
    send::file(request, &export_file, format, download).await
}
