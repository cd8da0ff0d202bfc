//! The guarded bench: readings of its devices, trips, motion and stops.
//! Uses: `rig`, `clock`. Never: the plan, storage, SQL; from `run` only requests and halts.
//! Tests alone have `stand_in`, which also uses the plan and `run::job`.
//!
//! PURE: `interlock`, `evidence`, `stopping`, `rig_state`, `stuck`, `not_clear`.

pub mod stage;
pub mod travel;
mod clear;
pub mod not_clear;
mod sound;
mod placed;
pub mod descent;
pub mod interlock;
pub mod evidence;
pub mod stopping;
pub mod estop;
pub mod rig_state;
pub mod stuck;
pub mod tare;
pub mod touch_off;
#[cfg(test)]
pub(in crate::campaign) mod stand_in;
