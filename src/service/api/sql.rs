//! Questions in SQL: one SELECT statement, answered in the requested format.
//! Uses: `data::query`. Never: SQL that no client sent, an answer that is not whole without an error.

use arrow_schema::ArrowError;
use axum::Json;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use futures::stream::{StreamExt, iter, unfold};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use utoipa::{IntoParams, ToSchema};

use super::audit::cut;
use super::encoder::RowEncoder;
use super::limits::{QUERY_JSON_MAX_BYTES, REPEATED_CHARS};
use super::problem::{ApiError, ApiResult, Body, Params};
use super::query::for_pages;
use super::{App, accept, send};
use crate::dataset::error::DatasetError;
use crate::dataset::format::Format;
use crate::dataset::schema::type_words;
use crate::query::{QueryError, ResultRows, TABLES};

/// A statement, and the format of its rows.
#[derive(Debug, Clone, Deserialize, ToSchema, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct QueryRequest {
    /// One SELECT statement, in the dialect of polars.
    #[schema(
        example = "SELECT contact_count, count(*) AS trials FROM trials GROUP BY contact_count"
    )]
    pub sql: String,
    /// Format of the rows: json, ndjson, csv, parquet, arrow (a stream) or feather (a file of Arrow); default:
    /// that of the `Accept` header, or json.
    #[serde(default)]
    pub format: Option<String>,
}

/// A column of a result.
#[derive(Debug, Serialize, ToSchema)]
pub struct QueryColumn {
    /// Name of the column, as the statement states it.
    pub name: String,
    /// Type, for people.
    #[serde(rename = "type")]
    pub kind: String,
}

/// A result as JSON.
#[derive(Debug, Serialize, ToSchema)]
pub struct QueryOut {
    /// Columns, in their order.
    pub columns: Vec<QueryColumn>,
    /// Number of rows.
    pub count: u64,
    /// The rows; a null value is absent.
    #[schema(value_type = Vec<Object>)]
    pub rows: Vec<Box<RawValue>>,
}

/// A table that statements may read.
#[derive(Debug, Serialize, ToSchema)]
pub struct QueryTable {
    /// Name in statements; names with a hyphen stand in double quotes.
    pub name: String,
    /// What a row is.
    pub about: String,
}

/// Answers a SELECT statement over the stored trials and the datasets.
///
/// Every dataset is a table under its id and its name. Nothing can be written, and no file or address
/// be read.
#[utoipa::path(post, operation_id = "query", path = "/api/v1/query", tag = "datasets",
    request_body = QueryRequest, responses((status = 200, body = QueryOut),
        (status = 400,
            description = "the statement is invalid, or needs more time, memory or rows than a query may use"),
        (status = 406, description = "the header `Accept` permits no format of the response"),
        (status = 503,
            description = "the query engine is being built, or other queries are in progress (with `Retry-After`)")))]
pub async fn ask(
    app: App,
    headers: HeaderMap,
    Body(request): Body<QueryRequest>,
) -> ApiResult<Response> {
    answer(&app, &headers, request).await
}

/// Answers a SELECT statement in the address, as `pandas.read_parquet(url)` needs it.
///
/// As the POST of this path.
#[utoipa::path(get, operation_id = "query_by_address", path = "/api/v1/query", tag = "datasets",
    params(QueryRequest), responses((status = 200, body = QueryOut),
        (status = 400,
            description = "the statement is invalid, or needs more time, memory or rows than a query may use"),
        (status = 503,
            description = "the query engine is being built, or other queries are in progress (with `Retry-After`)")))]
pub async fn asked(
    app: App,
    headers: HeaderMap,
    Params(request): Params<QueryRequest>,
) -> ApiResult<Response> {
    answer(&app, &headers, request).await
}

/// Lists the tables of statements: those of every data folder, then the datasets.
#[utoipa::path(get, operation_id = "query_tables", path = "/api/v1/query/tables", tag = "datasets",
    responses((status = 200, body = Vec<QueryTable>)))]
pub async fn tables(app: App) -> ApiResult<Json<Vec<QueryTable>>> {
    let known = TABLES.iter().map(|table| QueryTable {
        name: table.name.into(),
        about: format!("a row: {}", table.about),
    });
    let datasets = app.store.datasets().await?;
    let mut datasets: Vec<_> = datasets.into_iter().map(|dataset| dataset.name).collect();
    datasets.sort();
    datasets.dedup();
    let datasets = datasets.into_iter().map(|name| QueryTable {
        about: format!("a row of the newest dataset of the name {name}"),
        name,
    });
    Ok(Json(known.chain(datasets).collect()))
}

async fn answer(app: &App, headers: &HeaderMap, request: QueryRequest) -> ApiResult<Response> {
    let format = match request.format.as_deref() {
        None => accept::accepted(headers, accept::PAGE_TYPE)?,
        Some("json") => None,
        Some(name) => Some(
            name.parse::<Format>()
                .map_err(|error| ApiError::query("format", name, &format!("{error}, or json")))?,
        ),
    };
    format.map_or(Ok(()), for_pages).map_err(ApiError::bad_query)?;
    let rows = app.queries.answer(&request.sql).await.map_err(|error| match error {
        QueryError::Refused(why) => ApiError::query("sql", cut(&request.sql, REPEATED_CHARS), &why),
        other => other.into(),
    })?;
    match format {
        Some(format) => streamed(format, rows).await,
        None => {
            let column = |field: &arrow_schema::FieldRef| QueryColumn {
                name: field.name().clone(),
                kind: type_words(field.data_type()),
            };
            let columns = rows.schema.fields().iter().map(column).collect();
            let count = rows.count;
            Ok(Json(QueryOut { columns, count, rows: items(rows).await? }).into_response())
        }
    }
}

/// The rows in a row format, encoded as they arrive.
///
/// # Errors
/// `ApiError` if the format cannot hold a column, or the first rows cannot be read or encoded.
pub async fn streamed(format: Format, mut rows: ResultRows) -> ApiResult<Response> {
    let mut encoder = RowEncoder::new(format, &rows.schema)?;
    let rest = match rows.next().await {
        Some(first) => encoder.begin(first.map_err(unreadable)?)?,
        None => None,
    };
    let batches = unfold(rows, |mut rows| async move { Some((rows.next().await?, rows)) });
    let batches = iter(rest.map(Ok)).chain(batches);
    Ok(encoder.response(batches, "the answer to a query is incomplete"))
}

/// A value that no format can hold is the statement's; anything else is a failure.
fn unreadable(error: ArrowError) -> ApiError {
    match error {
        ArrowError::InvalidArgumentError(why) => QueryError::Refused(why).into(),
        other => DatasetError::from(other).into(),
    }
}

/// The rows as JSON objects.
///
/// # Errors
/// 400 if they are too long for JSON; 500 if the engine fails meanwhile.
pub async fn items(mut rows: ResultRows) -> ApiResult<Vec<Box<RawValue>>> {
    let mut lines = RowEncoder::new(Format::Ndjson, &rows.schema)?;
    let mut text = Vec::new();
    while let Some(batch) = rows.next().await {
        lines.push(&batch.map_err(unreadable)?)?;
        text.extend(lines.take());
        if text.len() > QUERY_JSON_MAX_BYTES {
            let limit = format!(
                "must be another one for a result of more than {} MiB: ndjson, csv, parquet, arrow or feather",
                QUERY_JSON_MAX_BYTES >> 20
            );
            return Err(ApiError::query("format", "json", &limit));
        }
    }
    text.extend(lines.finish()?);
    Ok(send::values(&text)?)
}
