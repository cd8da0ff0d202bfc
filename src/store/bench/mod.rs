//! What the bench leaves behind: runs, trials, events and who did what.
//! Uses: `core`, `table`. Never: `lab`.

/// The row of a run.
pub(crate) mod run_row;
/// Runs, stored and listed.
mod runs;
/// Changes of a run's state, and its end.
mod run_state;
/// Runs that wait for their turn.
mod queue;
/// Trials, stored.
pub(crate) mod trials;
/// Trials, taken back.
mod take_back;
/// Failed attempts and skips.
pub(crate) mod attempts;
/// Tares, reference presses, touch-offs.
mod auxiliary;
/// How many tips are mounted.
mod mountings;
/// Stored trials of a run, counted.
pub(crate) mod counts;
/// Events.
mod events;
/// The log of actions.
pub(crate) mod actions;
/// The search for damage in the file.
mod examine;
/// The campaign's `Journal`.
mod as_journal;
