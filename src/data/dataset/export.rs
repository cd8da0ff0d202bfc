//! An export: selected rows of a dataset in a format, as a file whose name is a hash of the request.
//! Uses: `dataset::{read, format}`, `new_file`. Never: HTTP, a read of the store; two files for equal requests.
//!
//! A dataset never changes, and a format produces the same bytes for the same rows. An interrupted
//! export is therefore written again as the same file.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::schema::{Object, ObjectBuilder, Type};

use super::build::Progress;
use super::error::{DatasetError, DatasetResult};
use super::format::{self, Format, Rows};
use super::read::DatasetRows;
use super::select::Wanted;
use crate::digest::sha256_hex;
use crate::ids::DatasetId;
use crate::new_file::{Finished, NewFile};
use crate::store::TaskRow;

/// Version of the bytes that the formats produce; part of the file name.
const EXPORTS_VERSION: u32 = 2;
/// Number of hexadecimal digits of a file name.
const NAME_DIGITS: usize = 24;

/// Request for an export.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ExportRequest {
    /// Id of a dataset, or a name, which stands for the dataset at the begin of the export.
    pub dataset: String,
    /// Format of the file.
    #[schema(schema_with = format_schema)]
    pub format: Format,
    /// Columns, in this order; empty: all columns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<String>,
    /// Conditions, each `COLUMN__gt=VALUE`; all must hold.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// Adds a force map per row, N per pixel: pixel and map diameter in mm, as in `4x20`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Only these values of each frame, as `FIRST:END`, end excluded: `0:28`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slice: Option<String>,
}

/// Names of all formats, for the API description.
fn format_schema() -> Object {
    let about = Format::ALL.map(|format| format!("- `{format}`: {}", format.about()));
    ObjectBuilder::new()
        .schema_type(Type::String)
        .description(Some(format!("Format of the file:\n\n{}", about.join("\n"))))
        .enum_values(Some(Format::ALL.map(Format::name)))
        .build()
}

impl ExportRequest {
    /// The requested rows and columns.
    pub fn wanted(&self) -> Wanted {
        Wanted {
            columns: self.columns.clone(),
            conditions: self.conditions.clone(),
            map: self.map.clone(),
            slice: self.slice.clone(),
        }
    }
}

/// Returns the file name of an export: a hash of the request, so that equal requests share a file.
///
/// # Errors
/// `DatasetError::Json` if the request cannot be written as JSON.
pub fn file_name(dataset: &DatasetId, format: Format, wanted: &Wanted) -> DatasetResult<String> {
    let text = serde_json::to_string(&(EXPORTS_VERSION, dataset, format.name(), wanted));
    let digest = sha256_hex(text.map_err(DatasetError::Json)?);
    Ok(format!("{}.{}", &digest[..NAME_DIGITS], format.extension()))
}

/// A completed file of a dataset or an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportFile {
    /// Path of the file.
    pub path: PathBuf,
    /// sha256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

/// Result of an export, as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportResult {
    /// Name of the file; equal exports share it.
    pub file: String,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// sha256 of the file, in hexadecimal digits.
    pub sha256: String,
}

impl ExportResult {
    /// Result of a stored export; `None` unless it is done.
    pub fn of(export: &TaskRow) -> Option<Self> {
        Self::deserialize(export.result.as_ref()?).ok()
    }
}

/// Writes rows to the file `name` in `folder`. The bytes depend only on rows and format. Blocks for
/// the whole duration of writing.
///
/// # Errors
/// `DatasetError::File` if the file cannot be written, `Format` if the rows cannot be read or
/// encoded.
pub fn write(
    rows: &DatasetRows,
    format: Format,
    folder: &Path,
    name: &str,
    progress: &Progress,
) -> DatasetResult<Finished> {
    progress.done.store(0, Ordering::Relaxed);
    progress.total.store(rows.count(), Ordering::Relaxed);
    let file = NewFile::create(folder).map_err(DatasetError::file("creating a file in", folder))?;
    let mut out = std::io::BufWriter::with_capacity(1 << 20, file);
    let mut show = |done| progress.done.store(done, Ordering::Relaxed);
    format::write(format, rows, &mut out, &mut show)?;
    let path = folder.join(name);
    let failed = DatasetError::file("writing", &path);
    let file = out.into_inner().map_err(|error| failed(error.into_error()))?;
    file.finish(name).map_err(failed)
}
