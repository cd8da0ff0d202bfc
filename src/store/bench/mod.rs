//! Records of the bench: runs with their trials, the queue, events, actions and the operator lock.
//! Uses: `core`, `table`. Never: `lab`; a decision of the campaign or the conductor.

/// Columns of a run, inserted and read.
pub(crate) mod run_row;
/// Storing, listing and reading runs.
mod runs;
/// Plans of runs, with their sha256.
mod plans;
/// The state and the end of a run.
mod run_state;
/// Queued runs, and started runs that wait for their turn.
mod queue;
/// Trials: one transaction each.
pub(crate) mod trials;
/// The placement that was stored last.
pub(crate) mod placed;
/// Discarding stored trials.
mod discard;
/// Failed attempts and skips.
pub(crate) mod attempts;
/// Tares, reference presses and touch-offs.
mod auxiliary;
/// Frames of the untouched skin.
pub(crate) mod untouched;
/// The number of mounted tips.
mod mountings;
/// Progress of a run, and counts of its trials.
pub(crate) mod counts;
/// Wear, and trials of the untouched skin.
pub(crate) mod wear;
/// Events, with numbers that only increase.
mod events;
/// The log of actions.
pub(crate) mod actions;
/// The operator lock.
pub(crate) mod lock;
/// Examination of the file for damage.
mod examine;
/// The `Journal` of the campaign.
mod as_journal;
