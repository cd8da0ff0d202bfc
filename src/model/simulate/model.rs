//! The forward model of a sensor, with its unit responses in a cache file.
//! Uses: sim-core, rustix. Never: an unchecked cache (length, key and checksum are checked), or the
//! need for one.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::{ForwardModel, ModelError};
use sim_core::responses::{ResponsesError, UnitResponses};
use sim_core::sensor::Sensor;

use crate::new_file;

/// Why the model of a sensor is not available.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ModelUnavailable {
    #[error("solving the unit responses: {0}")]
    Responses(#[from] ResponsesError),
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Builds the model of a sensor's skin: the calibrated one if a calibration of the skin is applied,
/// else the nominal one. Takes seconds and all cores if the cache in `cache_dir` does not contain
/// this sensor's unit responses; they are then stored in it.
///
/// # Errors
/// `ModelUnavailable` if the solve fails, or mesh, fields or electrodes do not match.
pub fn load_or_build(
    sensor: impl Into<CalibratedSensor>,
    cache_dir: &Path,
) -> Result<ForwardModel, ModelUnavailable> {
    let sensor = sensor.into();
    let responses = unit_responses(&sensor, cache_dir)?;
    Ok(ForwardModel::new(sensor, Arc::new(responses))?)
}

/// Returns the unit responses of a sensor, from the cache or solved. A cache that cannot be read or
/// written only costs time: this is logged.
///
/// # Errors
/// `ResponsesError` if the solve fails.
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

/// Path of the file of a sensor, named by the key of the responses.
fn cache_file(sensor: &Sensor, cache_dir: &Path) -> PathBuf {
    let key = UnitResponses::key(sensor);
    let name = hex::encode(&key[..8]);
    cache_dir.join(format!("unit-responses-{name}.bin"))
}

/// Writes a temporary file and renames it: a reader never reads a partial file. If the disk is
/// full, the temporary file is removed. Not a [`new_file::NewFile`]: several processes share the cache, and
/// [`sweep_partial`] must tell by the name whose file is unfinished.
fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let dir = path.parent().unwrap_or(Path::new("."));
    new_file::make_folder(dir)?;
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let write = || {
        let mut file = new_file::as_private_as(dir)?.create(true).truncate(true).open(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().inspect_err(|_| {
        // The first failure is the one to report.
        let _ = fs::remove_file(&partial);
    })
}

/// Removes incomplete cache files of killed processes: they occupy tens of megabytes. Those of
/// running processes remain. Called at start; a failure is logged.
pub fn sweep_partial(cache_dir: &Path) {
    let Ok(entries) = fs::read_dir(cache_dir) else { return };
    for path in entries.flatten().map(|entry| entry.path()) {
        if is_left_over(&path)
            && let Err(error) = fs::remove_file(&path)
        {
            tracing::warn!(path = %path.display(), %error, "an incomplete cache file remains");
        }
    }
}

/// Whether the name is `unit-responses-KEY.PROCESS.partial` (or `.tmp`, as the virtual rig names
/// it) with a process that has ended.
fn is_left_over(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    let parts: Vec<&str> = name.split('.').collect();
    let [stem, process, "partial" | "tmp"] = parts[..] else { return false };
    let process = process.parse().ok().and_then(Pid::from_raw);
    stem.starts_with("unit-responses-")
        && process.is_some_and(|pid| test_kill_process(pid) == Err(Errno::SRCH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_writer_left_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        // Linux does not assign this process number.
        let left = ["unit-responses-0a.999999999.partial", "unit-responses-0a.999999999.tmp"];
        let own = format!("unit-responses-0a.{}.partial", std::process::id());
        let kept = [own.as_str(), "unit-responses-0a.bin", "skin-errors.999999999.partial"];
        for name in left.iter().chain(&kept) {
            fs::write(dir.join(name), "x").unwrap();
        }
        sweep_partial(dir);
        assert!(left.iter().all(|name| !dir.join(name).exists()));
        assert!(kept.iter().all(|name| dir.join(name).exists()));
    }
}
