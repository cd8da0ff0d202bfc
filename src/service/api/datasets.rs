//! Datasets: lists, lineage, cards, rows by pages and as files.
//! Uses: `dataset::catalog`. Never: SQL, a row that is not in a dataset's file.

use axum::Json;
use axum::extract::{Query, Request};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::audit::Act;
use super::pages::{Cursors, Page, PageParams, PageRequest};
use super::params::{FileParams, RowGroupParams, RowsParams};
use super::problem::{ApiError, ApiResult, Body, Path};
use super::query::{GroupsOf, GroupsRequest, file_query, for_pages, groups_query, rows_query};
use super::send::{self, Download};
use super::trials::grouped;
use super::{App, accept};
use crate::dataset::definition::Definition;
use crate::dataset::error::DatasetError;
use crate::dataset::format::{Format, UnknownFormat};
use crate::dataset::making::Making;
use crate::dataset::prune::Pruned;
use crate::dataset::{origin, package};
use crate::ids::DatasetId;
use crate::problem::Problem;
use crate::query::TABLES;
use crate::query::groups::conditions;
use crate::store::{DatasetRow, Label, ModelRow};

/// A dataset: its definition, size, checksum and counts.
#[derive(Debug, Serialize, ToSchema)]
pub struct DatasetOut {
    /// `ds-` and the start of a sha256 over its definition, its rows and its columns.
    pub id: DatasetId,
    /// Name of the definition.
    pub name: String,
    /// Definition that selected, labelled and split the trials.
    #[schema(value_type = Definition)]
    pub definition: Value,
    /// Origin of all its rows, `simulated` without runs; null if they have several, or if it cannot be read.
    pub label: Option<Label>,
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
    pub created_at: jiff::Timestamp,
    /// Address of the Parquet file, for pandas, polars and DuckDB.
    pub url: String,
    /// Wall time at which its rows were last read; absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_used_at: Option<jiff::Timestamp>,
    /// False if its definition selects other trials or shards now, so that making it again makes
    /// another dataset. Absent in lists, and if it cannot be made again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub is_current: Option<bool>,
}

impl From<DatasetRow> for DatasetOut {
    fn from(row: DatasetRow) -> Self {
        Self {
            url: format!("/api/v1/data/{}.parquet", row.id),
            id: row.id,
            name: row.name,
            label: origin::label(&row.lineage),
            definition: row.definition,
            rows: row.rows,
            bytes: row.bytes,
            sha256: row.sha256,
            report: row.report,
            created_at: row.created_at,
            last_used_at: None,
            is_current: None,
        }
    }
}

/// A page of datasets.
#[derive(Debug, Serialize, ToSchema)]
pub struct DatasetsPage {
    /// Datasets, newest first, and the next page.
    #[serde(flatten)]
    pub page: Page<DatasetOut>,
    /// Names of the built-in definitions, of which datasets can be made.
    pub definitions: Vec<&'static str>,
    /// Datasets that are being made and imports that are being stored, oldest first.
    pub making: Vec<Making>,
}

/// Request for a dataset: exactly one of `name`, `definition` and `toml`.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DatasetRequest {
    /// Name of a built-in definition, of an existing dataset, or of a run (`run-N`).
    pub name: Option<String>,
    /// A definition, as JSON instead of TOML.
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
    pub items: Vec<Box<serde_json::value::RawValue>>,
    /// Value of `cursor` for the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<String>,
}

/// Position in the rows of a dataset: the dataset, and the number of rows before it.
struct RowsAt {
    dataset: DatasetId,
    from: u64,
}

impl std::fmt::Display for RowsAt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.dataset, self.from)
    }
}

impl std::str::FromStr for RowsAt {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (dataset, from) = text.split_once(' ').ok_or(())?;
        let dataset = dataset.parse().map_err(|_| ())?;
        Ok(Self { dataset, from: from.parse().map_err(|_| ())? })
    }
}

type Pairs = Query<Vec<(String, String)>>;

/// Returns a page of the datasets, newest first, and the names of the built-in definitions.
#[utoipa::path(get, operation_id = "list_datasets", path = "/api/v1/datasets", tag = "datasets",
    params(PageParams), responses((status = 200, body = DatasetsPage)))]
pub async fn list(app: App, asked: PageRequest) -> ApiResult<Json<DatasetsPage>> {
    let datasets = app.store.datasets().await?.into_iter().map(|row| {
        let last_used_at = app.datasets.last_used_at(&row.id);
        DatasetOut { last_used_at, ..row.into() }
    });
    let datasets = datasets.collect();
    let page = asked.of_all(datasets, |dataset: &DatasetOut| dataset.id.clone())?;
    let definitions = Definition::built_in_names().collect();
    Ok(Json(DatasetsPage { page, definitions, making: app.datasets.making().list() }))
}

/// Makes a dataset from the stored trials, or returns the existing one.
#[utoipa::path(post, operation_id = "make_dataset", path = "/api/v1/datasets", tag = "datasets",
    request_body = DatasetRequest, responses((status = 200, body = DatasetOut),
        (status = 400, description = "the definition is invalid, or its name is in use"),
        (status = 404,
            description = "no dataset, run or folder of shards has the name, or no rows are selected"),
        (status = 409,
            description = "the runs differ in label, frame length or model, or a run has not ended"),
        (status = 422,
            description = "the body is invalid, or has not exactly one of name, definition and toml")))]
pub async fn make(
    app: App,
    act: Act,
    Body(new): Body<DatasetRequest>,
) -> ApiResult<Json<DatasetOut>> {
    let file = new.file.as_deref().unwrap_or("definition");
    let row = match (new.name, new.definition, new.toml) {
        (Some(name), None, None) => app.datasets.resolve(&name).await?,
        (None, Some(definition), None) => {
            app.datasets.make_custom(file, &named(file, definition)?).await?
        }
        (None, None, Some(text)) => {
            let definition = Definition::from_toml(file, &text).map_err(DatasetError::Problems)?;
            app.datasets.make_custom(file, &named(file, definition)?).await?
        }
        _ => {
            let limit = "must have exactly one of name, definition and toml";
            let problem = Problem::whole("request", limit);
            return Err(ApiError::problems(vec![problem]));
        }
    };
    act.about(row.id.as_str());
    Ok(Json(DatasetOut { is_current: Some(true), ..row.into() }))
}

/// Refuses the name of a table that statements would read instead of the dataset.
fn named(file: &str, definition: Definition) -> ApiResult<Definition> {
    if TABLES.iter().any(|table| table.name == definition.name) {
        let limit = "is the name of a table of `palpate query`: choose another name";
        let problem = Problem::new(file, "name", &definition.name, limit);
        return Err(ApiError::bad_query(vec![problem]));
    }
    Ok(definition)
}

/// Returns the dataset with an id, or the newest one of a name.
#[utoipa::path(get, operation_id = "dataset", path = "/api/v1/datasets/{dataset}", tag = "datasets",
    responses((status = 200, body = DatasetOut)))]
pub async fn one(app: App, Path(dataset): Path<String>) -> ApiResult<Json<DatasetOut>> {
    let row = app.datasets.find(&dataset).await?;
    let is_current = app.datasets.is_current(&row).await?;
    let last_used_at = app.datasets.last_used_at(&row.id);
    Ok(Json(DatasetOut { is_current, last_used_at, ..row.into() }))
}

/// Returns the lineage of a dataset: runs, models, calibrations, shards, code and files, and the nets that were
/// trained on it (`trained`).
#[utoipa::path(get, operation_id = "dataset_lineage",
    path = "/api/v1/datasets/{dataset}/lineage", tag = "datasets",
    responses((status = 200, body = Object)))]
pub async fn lineage(app: App, Path(dataset): Path<String>) -> ApiResult<Json<Value>> {
    let row = app.datasets.find(&dataset).await?;
    let url = format!("/api/v1/data/{}.parquet", row.id);
    let nets = app.store.models_of(&row.id).await?;
    let net =
        |net: &ModelRow| serde_json::json!({ "id": net.id, "name": net.name, "task": net.task });
    let trained: Vec<Value> = nets.iter().map(net).collect();
    Ok(Json(serde_json::json!({
        "dataset": row.id, "sha256": row.sha256, "definition": row.definition,
        "lineage": row.lineage, "trained": trained,
        "files": [{ "url": url, "bytes": row.bytes, "sha256": row.sha256 }],
    })))
}

/// Returns the card of a dataset in Markdown: content, units, quality, origin and citation.
#[utoipa::path(get, operation_id = "dataset_card", path = "/api/v1/datasets/{dataset}/card",
    tag = "datasets", responses((status = 200, body = String, content_type = "text/markdown")))]
pub async fn card(app: App, Path(dataset): Path<String>) -> ApiResult<Response> {
    let row = app.datasets.find(&dataset).await?;
    let text = app.datasets.card(&row)?;
    Ok(([(header::CONTENT_TYPE, "text/markdown; charset=utf-8")], text).into_response())
}

/// Returns the description of a dataset as a Data Package: columns with types, units and meanings,
/// sources, lineage, address and sha256 of the file.
#[utoipa::path(get, operation_id = "dataset_package",
    path = "/api/v1/datasets/{dataset}/datapackage.json", tag = "datasets",
    responses((status = 200, body = Object)))]
pub async fn package(app: App, Path(dataset): Path<String>) -> ApiResult<Json<Value>> {
    let row = app.datasets.find(&dataset).await?;
    Ok(Json(package::of(&row, &format!("/api/v1/data/{}.parquet", row.id))))
}

/// Request to remove datasets.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PruneRequest {
    /// Number of datasets of each name that stay, the newest ones.
    #[schema(value_type = u32, minimum = 1)]
    pub keep: std::num::NonZeroU32,
    /// True: nothing is removed, the response shows what would be.
    #[serde(default)]
    pub dry_run: bool,
}

/// What becomes of the datasets.
#[derive(Debug, Serialize, ToSchema)]
pub struct PruneOut {
    /// All datasets, newest first; those without `stays` are removed.
    pub datasets: Vec<Pruned>,
    /// Sum of the lengths of the removed files, bytes.
    pub freed_bytes: u64,
    /// Whether nothing was removed.
    pub dry_run: bool,
}

/// Removes the older datasets of each name. Those to which a model, a training, an evaluation or a
/// waiting export refers stay.
#[utoipa::path(post, operation_id = "prune_datasets", path = "/api/v1/datasets/prune",
    tag = "datasets", request_body = PruneRequest, responses((status = 200, body = PruneOut)))]
pub async fn prune(
    app: App,
    act: Act,
    Body(request): Body<PruneRequest>,
) -> ApiResult<Json<PruneOut>> {
    let keep = request.keep.get() as usize;
    let datasets = match request.dry_run {
        true => app.datasets.prunable(keep).await?,
        false => app.datasets.prune(keep).await?,
    };
    let gone = datasets.iter().filter(|one| one.stays.is_none());
    let freed_bytes = gone.map(|one| one.bytes).sum();
    act.about(&format!("keep {}{}", request.keep, if request.dry_run { ", dry run" } else { "" }));
    Ok(Json(PruneOut { datasets, freed_bytes, dry_run: request.dry_run }))
}

/// Returns a page of the rows of a dataset.
///
/// The pages of one list of rows stay with the dataset that the first page was read from, also if
/// another dataset of the name is made meanwhile. The header `Link` has the address of the next page
/// in every format.
#[utoipa::path(get, operation_id = "dataset_rows", path = "/api/v1/datasets/{dataset}/rows",
    tag = "datasets", params(("dataset" = String, Path), RowsParams),
    responses((status = 200, body = RowsPage)))]
pub async fn rows(
    app: App,
    Path(dataset): Path<String>,
    Query(pairs): Pairs,
    cursors: Cursors,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let requested = rows_query(&pairs).map_err(ApiError::bad_query)?;
    let format = accept::of_list(requested.format, &pairs, &headers)?;
    format.map_or(Ok(()), for_pages).map_err(ApiError::bad_query)?;
    let at: Option<RowsAt> = cursors.position(&pairs)?;
    let from = at.as_ref().map_or(0, |at| at.from);
    let row = match at {
        Some(at) => app.datasets.find(at.dataset.as_str()).await?,
        None => app.datasets.find(&dataset).await?,
    };
    let catalog = app.datasets.clone();
    let reading = tokio::task::spawn_blocking(move || -> ApiResult<Response> {
        let rows = catalog.pages(&row.id, &requested.wanted)?;
        send::check_numbers(send::numbers_per_row(rows.schema()), requested.limit)?;
        let limit = requested.limit as usize;
        let (batches, next) = match &requested.sort {
            Some(sort) => rows.sorted_page(sort, from, limit)?,
            None => rows.page(from, limit)?,
        };
        let next = next.map(|from| cursors.cursor(RowsAt { dataset: row.id.clone(), from }));
        let link = next.as_deref().and_then(|next| cursors.link(next));
        let bytes = send::encoded(format.unwrap_or(Format::Ndjson), rows.schema(), &batches)?;
        let response = match format {
            Some(format) => send::in_format(format, bytes),
            None => {
                let items = send::values(&bytes)?;
                Json(RowsPage { dataset: row.id, items, next }).into_response()
            }
        };
        Ok((link.map(|link| [link]), response).into_response())
    });
    reading.await.map_err(|_| ApiError::from(DatasetError::Worker))?
}

/// Returns groups of the rows of a dataset with their aggregates, by the conditions of its rows.
#[utoipa::path(get, operation_id = "dataset_groups", path = "/api/v1/datasets/{dataset}/groups",
    tag = "datasets", params(("dataset" = String, Path), RowGroupParams),
    responses((status = 200, body = Page<Object>),
        (status = 503, description = "as of queries (with `Retry-After`)")))]
pub async fn groups(
    app: App,
    Path(dataset): Path<String>,
    Query(pairs): Pairs,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let GroupsRequest { query, groups, format } =
        groups_query(&pairs, GroupsOf::Dataset).map_err(ApiError::bad_query)?;
    let row = app.datasets.find(&dataset).await?;
    let sql = groups.sql(row.id.as_str(), &conditions(&query), query.limit);
    grouped(&app, sql, accept::of_list(format, &pairs, &headers)?).await
}

/// Returns a dataset as a file: `real.parquet`, `ds-0123.npz`, `run-3.csv`.
///
/// The header `Range` selects a part; the entity tag is the sha256 of the file. A name stands for the
/// newest dataset that was made with it, whose address is in the header `Content-Location`. A file
/// in another format than Parquet, or with a selection, is written if needed; for a large dataset
/// request an export, which shows its progress.
#[utoipa::path(get, operation_id = "dataset_file", path = "/api/v1/data/{file}", tag = "datasets",
    params(("file" = String, Path,
        description = "ID_OR_NAME.FORMAT, with a format of `ExportRequest`"), FileParams),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 206, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 304),
        (status = 404,
            description = "no dataset has this id, none of this name has been made, or the format is unknown")))]
pub async fn data(
    app: App,
    Path(file): Path<String>,
    Query(pairs): Pairs,
    request: Request,
) -> ApiResult<Response> {
    let (name, format) = Format::of_file(&file).ok_or_else(|| {
        let name = file.rsplit_once('.').map_or("", |(_, ending)| ending).to_owned();
        ApiError::not_found(format!("{file}: {}", UnknownFormat { name }))
    })?;
    let wanted = file_query(&pairs).map_err(ApiError::bad_query)?;
    let row = app.datasets.find(name).await?;
    let export_file = app.datasets.file(&row, format, &wanted, std::sync::Arc::default()).await?;
    let shown = format!("{}.{}", row.id, format.extension());
    let download = Download { name: &shown, immutable: name == row.id.as_str() };
    let mut response = send::file(request, &export_file, format, download).await?;
    let address = format!("/api/v1/data/{shown}");
    send::set(&mut response, header::CONTENT_LOCATION, &address);
    Ok(response)
}
