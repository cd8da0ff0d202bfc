//! The disk cache of unit responses: one file per sensor, named by its key.
//! Uses: `sim_core::responses`. Never: trusts a file (length, key and checksum are checked).

use std::fs::{DirBuilder, File};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sim_core::responses::{ResponsesError, UnitResponses};
use sim_core::sensor::Sensor;

/// Reads the unit responses of a sensor from the cache, or solves and stores them. A cache that
/// cannot be read or written only costs time: it is logged.
///
/// # Errors
/// The responses cannot be solved for this sensor.
pub(super) fn unit_responses(
    sensor: &Sensor,
    dir: Option<&Path>,
) -> Result<Arc<UnitResponses>, ResponsesError> {
    let path = dir.map(|dir| file(dir, sensor));
    if let Some(path) = &path
        && let Some(cached) = read(path, sensor)
    {
        return Ok(Arc::new(cached));
    }
    let solved = UnitResponses::solve(sensor)?;
    if let Some(path) = &path
        && let Err(error) = write(path, &solved)
    {
        tracing::warn!(path = %path.display(), %error, "writing the cache of unit responses");
    }
    Ok(Arc::new(solved))
}

fn file(dir: &Path, sensor: &Sensor) -> PathBuf {
    let key = hex::encode(&UnitResponses::key(sensor)[..8]);
    dir.join(format!("unit-responses-{key}.bin"))
}

fn read(path: &Path, sensor: &Sensor) -> Option<UnitResponses> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        Err(error) => {
            tracing::warn!(path = %path.display(), %error, "reading the cache of unit responses");
            return None;
        }
    };
    UnitResponses::from_bytes(&bytes, sensor)
        .inspect_err(|error| tracing::warn!(path = %path.display(), %error, "solving again"))
        .ok()
}

/// Writes to a temporary file and renames it, so that a reader never reads an incomplete file.
fn write(path: &Path, responses: &UnitResponses) -> std::io::Result<()> {
    if let Some(dir) = path.parent() {
        DirBuilder::new().recursive(true).mode(0o700).create(dir)?;
    }
    let partial = path.with_extension(format!("{}.tmp", std::process::id()));
    // The cache of the service, too, which keeps its folder to one user.
    let mut file =
        File::options().write(true).create(true).truncate(true).mode(0o600).open(&partial)?;
    file.write_all(&responses.to_bytes())?;
    std::fs::rename(&partial, path)
}
