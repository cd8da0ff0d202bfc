//! An export: rows of a dataset in some format, as a file named by what it holds.
//! Uses: `dataset::{read, format, file}`. Never: HTTP, the store; two files for equal wishes.
//!
//! A dataset never changes and the formats give the same bytes for the same rows, so an export that
//! a kill interrupted is written again and is the same file.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::build::Progress;
use super::error::DatasetError;
use super::file::{Finished, NewFile};
use super::format::{self, Format, Rows};
use super::read::DatasetRows;
use super::select::Wanted;

/// Version of the formats' bytes: another one gives other files.
const FORMAT_VERSION: u32 = 1;
/// Hexadecimal digits of a file's name.
const NAME_DIGITS: usize = 24;

/// What is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ExportRequest {
    /// A dataset's id, or a name: then the dataset as it is when the export begins.
    pub dataset: String,
    /// `parquet`, `arrow`, `csv`, `ndjson` or `npz`.
    #[schema(value_type = String)]
    pub format: Format,
    /// Columns, in this order; empty: all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<String>,
    /// Conditions that all hold, each `COLUMN__gt=VALUE`.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<String>,
    /// A force map for each row, as pixel and diameter in mm: `4x20`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Only these values of each frame: `0:28`, the end left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slice: Option<String>,
}

impl ExportRequest {
    /// Which rows and columns.
    pub fn wanted(&self) -> Wanted {
        Wanted {
            columns: self.columns.clone(),
            conditions: self.conditions.clone(),
            map: self.map.clone(),
            slice: self.slice.clone(),
        }
    }
}

/// Name of the file that holds this: by its contents, so that equal wishes share it.
pub fn file_name(dataset: &str, format: Format, wanted: &Wanted) -> Result<String, DatasetError> {
    let text = serde_json::to_string(&(FORMAT_VERSION, dataset, format.name(), wanted));
    let digest = Sha256::digest(text.map_err(DatasetError::json)?);
    Ok(format!("{}.{}", &hex::encode(digest)[..NAME_DIGITS], format.extension()))
}

/// A file that can be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sendable {
    /// Where it is.
    pub path: PathBuf,
    /// sha256 of its bytes.
    pub sha256: String,
}

/// Writes rows into a file of this name. Takes long; the bytes follow from rows and format alone.
pub fn write(
    rows: &DatasetRows,
    format: Format,
    folder: &Path,
    name: &str,
    progress: &Progress,
) -> Result<Finished, DatasetError> {
    progress.done.store(0, Ordering::Relaxed);
    progress.total.store(rows.count(), Ordering::Relaxed);
    let file = NewFile::create(folder).map_err(DatasetError::file("making", folder))?;
    let mut out = std::io::BufWriter::with_capacity(1 << 20, file);
    let mut told = |done| progress.done.store(done, Ordering::Relaxed);
    format::write(format, rows, &mut out, &mut told)?;
    let path = folder.join(name);
    let failed = DatasetError::file("writing", &path);
    let file = out.into_inner().map_err(|error| failed(error.into_error()))?;
    file.finish(name).map_err(failed)
}
