//! The bench under guard: what its devices say, what trips, how it moves and is stopped.
//! Uses: `rig`, `clock`. Never: the plan, storage, SQL; of `run` it knows requests and halts alone.
//!
//! PURE: `interlock`, `evidence`, `stopping`, `rig_state`, `stuck`.

pub mod stage;
pub mod travel;
pub mod interlock;
pub mod evidence;
pub mod stopping;
pub mod estop;
pub mod rig_state;
pub mod stuck;
pub mod tare;
pub mod touch_off;
