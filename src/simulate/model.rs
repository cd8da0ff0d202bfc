//! The forward model of a sensor, its unit responses kept in a cache file.
//! Uses: sim-core. Never: trusts a cache (length, key and checksum are checked), or needs one.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sim_core::forward::{ForwardModel, ModelError};
use sim_core::responses::{ResponsesError, UnitResponses};
use sim_core::sensor::Sensor;

/// Why a sensor has no model.
#[derive(Debug, thiserror::Error)]
pub enum ModelUnavailable {
    /// The elastic problem could not be solved.
    #[error("solving the unit responses: {0}")]
    Responses(#[from] ResponsesError),
    /// Mesh, fields or electrodes do not fit.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// The skin of a sensor: the calibrated one where a calibration of the skin is applied, else the
/// nominal one. Takes seconds and both cores where the cache in `cache_dir` does
/// not hold this sensor's unit responses yet; then leaves them there.
pub fn load_or_build(sensor: &Sensor, cache_dir: &Path) -> Result<ForwardModel, ModelUnavailable> {
    let responses = unit_responses(sensor, cache_dir)?;
    Ok(ForwardModel::new(sensor, Arc::new(responses))?)
}

/// The unit responses of a sensor, from the cache or solved. A cache that cannot be read or written
/// costs seconds, nothing else: it is logged.
pub fn unit_responses(sensor: &Sensor, cache_dir: &Path) -> Result<UnitResponses, ResponsesError> {
    let path = cache_file(sensor, cache_dir);
    match fs::read(&path) {
        Ok(bytes) => match UnitResponses::from_bytes(&bytes, sensor) {
            Ok(responses) => return Ok(responses),
            Err(error) => tracing::warn!(path = %path.display(), %error, "unit responses: solving"),
        },
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => tracing::warn!(path = %path.display(), %error, "unit responses: solving"),
    }
    let responses = UnitResponses::solve(sensor)?;
    if let Err(error) = write_whole(&path, &responses.to_bytes()) {
        tracing::warn!(path = %path.display(), %error, "unit responses: not cached");
    }
    Ok(responses)
}

/// One file for each sensor, named by what the responses depend on.
fn cache_file(sensor: &Sensor, cache_dir: &Path) -> PathBuf {
    let key = UnitResponses::key(sensor);
    let name: String = key[..8].iter().map(|byte| format!("{byte:02x}")).collect();
    cache_dir.join(format!("unit-responses-{name}.bin"))
}

/// Writes beside the file, then renames: a reader never sees half of it.
fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(dir) = path.parent() {
        fs::create_dir_all(dir)?;
    }
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let mut file = File::create(&partial)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&partial, path)
}
