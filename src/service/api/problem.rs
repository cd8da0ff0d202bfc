//! Error responses: RFC 9457 problem bodies that name field, value and limit.
//! Uses: axum, the errors of `conductor`, `store`, `campaign`. Never: logging of secrets.

use axum::Json;
use axum::extract::multipart::MultipartRejection;
use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection, StringRejection};
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::ext::ReasonPhrase;
use serde::Serialize;
use utoipa::ToSchema;

use super::body::TooSlow;
use super::limits::REPEATED_CHARS;
use crate::campaign::shown::command::Refusal;
use crate::conductor::ConductorError;
use crate::dataset::error::DatasetError;
use crate::dataset::shards::ShardsError;
use crate::infer::error::InferError;
use crate::jobs::JobError;
use crate::journal::error_chain;
use crate::plain::violated;
use crate::problem::{Problem, listed};
use crate::query::QueryError;
use crate::store::StoreError;

/// Longest description in a status line: it repeats the start of a statement.
const REASON_CHARS: usize = 2 * REPEATED_CHARS;

/// A problem body (RFC 9457).
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProblemBody {
    /// Always `about:blank`: the status determines the kind of error.
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// Name of the HTTP status.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// Description of the error, for people.
    pub detail: String,
    /// Invalid values; absent if the error is of another kind.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(value_type = Vec<Object>)]
    pub errors: Vec<Problem>,
}

/// Description of an error, an extension of its response, for the log of actions.
#[derive(Debug, Clone)]
pub struct Refused(pub String);

/// Result of an operation of the API.
pub type ApiResult<T> = Result<T, ApiError>;

/// An error response.
#[derive(Debug)]
pub struct ApiError {
    status: StatusCode,
    detail: String,
    errors: Vec<Problem>,
    retry_after_s: Option<u32>,
}

impl ApiError {
    /// An error with a status and a description.
    pub fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self { status, detail: detail.into(), errors: Vec::new(), retry_after_s: None }
    }

    /// The same request may succeed after this time (header `Retry-After`).
    pub fn retry_after(self, seconds: u32) -> Self {
        Self { retry_after_s: Some(seconds), ..self }
    }

    /// One invalid value of a request (422).
    pub fn value(key: &str, value: impl std::fmt::Display, limit: &str) -> Self {
        Self::problems(vec![Problem::new("request", key, value, limit)])
    }

    /// One invalid value of a query (400).
    pub fn query(key: &str, value: impl std::fmt::Display, limit: &str) -> Self {
        Self::bad_query(vec![Problem::new("query", key, value, limit)])
    }

    /// Invalid values (422).
    pub fn problems(errors: Vec<Problem>) -> Self {
        let detail = listed(&errors);
        Self { errors, ..Self::new(StatusCode::UNPROCESSABLE_ENTITY, detail) }
    }

    /// A body that could not be read: 408 if it arrived too slowly.
    pub fn of_body(
        status: StatusCode,
        words: String,
        cause: &(dyn std::error::Error + 'static),
    ) -> Self {
        let mut causes = std::iter::successors(Some(cause), |cause| cause.source());
        match causes.find(|cause| cause.is::<TooSlow>()) {
            Some(slow) => Self::new(StatusCode::REQUEST_TIMEOUT, slow.to_string()),
            None => Self::new(status, words),
        }
    }

    /// Invalid values of a query, a form or a dataset definition (400).
    pub fn bad_query(errors: Vec<Problem>) -> Self {
        Self { status: StatusCode::BAD_REQUEST, ..Self::problems(errors) }
    }

    /// Checks the length of a name or note, and that it has no control characters (422).
    ///
    /// # Errors
    /// 422 if it violates a limit; the text itself is not repeated.
    pub fn check_text(key: &str, text: &str, max_chars: usize) -> Result<(), Self> {
        match violated(text, max_chars) {
            Some(limit) => {
                Err(Self::value(key, format!("{} characters", text.chars().count()), &limit))
            }
            None => Ok(()),
        }
    }

    /// The requested object does not exist (404).
    pub fn not_found(what: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, what)
    }

    /// An error that no client can mend (500).
    pub fn internal(error: impl std::fmt::Display) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
    }

    /// The HTTP status.
    pub fn status(&self) -> StatusCode {
        self.status
    }

    /// The description, for the log.
    pub fn detail(&self) -> &str {
        &self.detail
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let refused = Refused(self.detail.clone());
        let body = ProblemBody {
            kind: "about:blank",
            title: self.status.canonical_reason().unwrap_or("error").into(),
            status: self.status.as_u16(),
            detail: self.detail,
            errors: self.errors,
        };
        let mut response = (self.status, Json(body)).into_response();
        let kind = HeaderValue::from_static("application/problem+json");
        response.headers_mut().insert(header::CONTENT_TYPE, kind);
        if let Some(seconds) = self.retry_after_s {
            response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
        }
        if self.status == StatusCode::UNAUTHORIZED {
            let challenge = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, challenge);
        }
        if let Some(reason) = reason(&refused.0) {
            response.extensions_mut().insert(reason);
        }
        response.extensions_mut().insert(refused);
        response
    }
}

/// The description for the status line: `pandas.read_csv(url)` and other readers show nothing else of a refusal.
fn reason(detail: &str) -> Option<ReasonPhrase> {
    let plain = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
    ReasonPhrase::try_from(detail.chars().take(REASON_CHARS).map(plain).collect::<String>()).ok()
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let status = match &refusal {
            Refusal::State(_) | Refusal::Busy(_) | Refusal::Fault(..) => StatusCode::CONFLICT,
            Refusal::Value(words) => {
                return Self::problems(vec![Problem::whole("request", words.clone())]);
            }
            Refusal::Gone => StatusCode::SERVICE_UNAVAILABLE,
        };
        Self::new(status, refusal.to_string())
    }
}

impl From<ConductorError> for ApiError {
    fn from(error: ConductorError) -> Self {
        match error {
            ConductorError::Problems { problems } => Self::problems(problems),
            ConductorError::NoRun(_) => Self::not_found(error.to_string()),
            ConductorError::PlanDiffers { .. } => {
                Self::new(StatusCode::CONFLICT, error.to_string())
            }
            ConductorError::Forbidden(words) => Self::new(StatusCode::CONFLICT, words),
            ConductorError::Refused(refusal) => refusal.into(),
            ConductorError::Store(error) => error.into(),
            ConductorError::NotEnded(error) => {
                Self::new(StatusCode::INTERNAL_SERVER_ERROR, error_chain(&error))
            }
        }
    }
}

impl From<DatasetError> for ApiError {
    fn from(error: DatasetError) -> Self {
        let status = match error {
            DatasetError::Problems(problems) => return Self::bad_query(problems),
            DatasetError::Store(error) => return error.into(),
            DatasetError::NoDataset { .. }
            | DatasetError::NotMade(_)
            | DatasetError::NoRun(_)
            | DatasetError::FileMissing(_)
            | DatasetError::Empty { .. } => StatusCode::NOT_FOUND,
            DatasetError::Labels(_)
            | DatasetError::Channels { .. }
            | DatasetError::Models { .. }
            | DatasetError::Changed
            | DatasetError::NotEnded(_)
            | DatasetError::Imported(_) => StatusCode::CONFLICT,
            DatasetError::Shards(ShardsError::None(_)) => StatusCode::NOT_FOUND,
            DatasetError::DiskFull { .. } => StatusCode::INSUFFICIENT_STORAGE,
            DatasetError::Shards(_)
            | DatasetError::File { .. }
            | DatasetError::Format(_)
            | DatasetError::Arrow(_)
            | DatasetError::Parquet(_)
            | DatasetError::Json(_)
            | DatasetError::Worker => StatusCode::INTERNAL_SERVER_ERROR,
        };
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(error = error_chain(&error), "an operation on datasets failed");
        }
        Self::new(status, error.to_string())
    }
}

impl From<QueryError> for ApiError {
    fn from(error: QueryError) -> Self {
        let words = error.to_string();
        match error {
            QueryError::Refused(_) => Self::bad_query(vec![Problem::whole("query", words)]),
            QueryError::Building(_) => {
                Self::new(StatusCode::SERVICE_UNAVAILABLE, words).retry_after(5)
            }
            QueryError::Busy => Self::new(StatusCode::SERVICE_UNAVAILABLE, words).retry_after(1),
            // A program that is not installed is no fault of this one.
            QueryError::Program(_) => Self::new(StatusCode::SERVICE_UNAVAILABLE, words),
            QueryError::Dataset(error) => error.into(),
            QueryError::Talk(_) | QueryError::Ended(_) => {
                tracing::error!(error = error_chain(&error), "a query failed");
                Self::new(StatusCode::INTERNAL_SERVER_ERROR, words)
            }
        }
    }
}

impl From<InferError> for ApiError {
    fn from(error: InferError) -> Self {
        let status = match error {
            InferError::Problems(problems) => return Self::problems(problems),
            InferError::Store(error) => return error.into(),
            InferError::Calibration(_)
            | InferError::Model(_)
            | InferError::Plan(_)
            | InferError::Fit(_) => StatusCode::UNPROCESSABLE_ENTITY,
            InferError::NoModel(_) | InferError::SeveralModels { .. } | InferError::NoSkin(_) => {
                StatusCode::NOT_FOUND
            }
            InferError::NotServed { .. }
            | InferError::OtherTask { .. }
            | InferError::OtherSensor { .. }
            | InferError::NoEarlier(_) => StatusCode::CONFLICT,
            InferError::File { ref source, .. }
                if source.kind() == std::io::ErrorKind::NotFound =>
            {
                StatusCode::NOT_FOUND
            }
            InferError::Fitter(_)
            | InferError::Errors(_)
            | InferError::Steady(_)
            | InferError::OneStep(_)
            | InferError::Skin(_)
            | InferError::Map(_)
            | InferError::File { .. }
            | InferError::Json { .. }
            | InferError::Worker => StatusCode::INTERNAL_SERVER_ERROR,
        };
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(error = error_chain(&error), "an inference failed");
        }
        Self::new(status, error.to_string())
    }
}

impl From<JobError> for ApiError {
    fn from(error: JobError) -> Self {
        match error {
            JobError::Problems(problems) => Self::problems(problems),
            JobError::Store(error) => error.into(),
            JobError::Infer(error) => error.into(),
            JobError::Dataset(error) => error.into(),
            JobError::Full(_) => Self::new(StatusCode::TOO_MANY_REQUESTS, error.to_string()),
            JobError::InVain(_)
            | JobError::Learn(_)
            | JobError::Trainer(_)
            | JobError::Json(_)
            | JobError::Worker => {
                tracing::error!(error = error_chain(&error), "an operation on jobs failed");
                Self::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
            }
        }
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        let status = match error {
            StoreError::NoSuchRun(_) | StoreError::NoSuchTrial { .. } => StatusCode::NOT_FOUND,
            StoreError::Refused { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            StoreError::RunEnded(_) | StoreError::NotQueued(_) | StoreError::LockHeld { .. } => {
                StatusCode::CONFLICT
            }
            StoreError::Open { .. }
            | StoreError::Lost { .. }
            | StoreError::DamagedLog { .. }
            | StoreError::Migrate { .. }
            | StoreError::StartWriter(_)
            | StoreError::Sql { .. }
            | StoreError::Read { .. }
            | StoreError::NotStored { .. }
            | StoreError::Late { .. }
            | StoreError::Closed { .. }
            | StoreError::ReadOnly { .. }
            | StoreError::Unreadable { .. }
            | StoreError::Damaged { .. }
            | StoreError::FreeSpace(_) => StatusCode::INTERNAL_SERVER_ERROR,
        };
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            tracing::error!(error = error_chain(&error), "the store failed");
        }
        Self::new(status, error_chain(&error))
    }
}

/// Errors of extractors: `TYPE: |rejection| error;`.
macro_rules! rejections {
    ($($kind:ty: |$rejection:ident| $error:expr;)*) => {$(
        impl From<$kind> for ApiError {
            fn from($rejection: $kind) -> Self {
                $error
            }
        }
    )*};
}

rejections! {
    JsonRejection: |r| ApiError::of_body(r.status(), r.body_text(), &r);
    StringRejection: |r| ApiError::of_body(r.status(), r.body_text(), &r);
    MultipartRejection: |r| ApiError::of_body(r.status(), r.body_text(), &r);
    QueryRejection: |r| ApiError::new(StatusCode::BAD_REQUEST, r.body_text());
    PathRejection: |r| ApiError::new(r.status(), r.body_text());
    WebSocketUpgradeRejection: |r| ApiError::new(r.status(), r.body_text());
}

/// Extractor of a path; an invalid one is answered with a problem body.
#[derive(axum::extract::FromRequestParts)]
#[from_request(via(axum::extract::Path), rejection(ApiError))]
pub struct Path<T>(pub T);

/// Extractor of a body of text; an invalid one is answered with a problem body.
#[derive(axum::extract::FromRequest)]
#[from_request(rejection(ApiError))]
pub struct Text(pub String);

/// Extractor of a JSON body; an invalid body is answered with a problem body.
#[derive(axum::extract::FromRequest)]
#[from_request(via(axum::Json), rejection(ApiError))]
pub struct Body<T>(pub T);

/// Extractor of a query string; an invalid one is answered with a problem body.
#[derive(axum::extract::FromRequestParts)]
#[from_request(via(axum::extract::Query), rejection(ApiError))]
pub struct Params<T>(pub T);
