//! Disk space that queued runs need.
//! PURE. Uses: `schedule`, `store` (its rows). Never: the disk, a plan (planning takes too long for
//! what is asked several times per second).

use crate::schedule::estimate::{CONFIGURATION_BYTES, trial_bytes};
use crate::schedule::experiment::Experiment;
use crate::store::RunRow;

/// Returns the disk space that the trials of a queued run need, bytes; `None` if its experiment file
/// cannot be read by this version.
pub fn needed_bytes(run: &RunRow, channels: u64) -> Option<u64> {
    let experiment = Experiment::from_toml(&run.experiment, &run.definition).ok()?;
    let depths = experiment.real_hex.as_ref().map_or(1, |hex| hex.depths.max(1));
    let each = trial_bytes(channels, experiment.measure.frames_per_trial);
    let configurations = run.trials_planned.div_ceil(u64::from(depths));
    Some(run.trials_planned * each + configurations * CONFIGURATION_BYTES)
}
