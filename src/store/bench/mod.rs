//! Records of the bench: runs with their trials, the queue, events, actions and the operator lock.
//! Uses: `core`, `table`. Never: `lab`; a decision of the campaign or the conductor.

pub(crate) mod run_row;
mod runs;
mod plans;
mod run_state;
mod queue;
pub(crate) mod trials;
pub(crate) mod placed;
mod discard;
pub(crate) mod attempts;
mod auxiliary;
pub(crate) mod untouched;
mod mountings;
pub(crate) mod counts;
pub(crate) mod wear;
mod events;
pub(crate) mod actions;
pub(crate) mod lock;
mod examine;
mod as_journal;
