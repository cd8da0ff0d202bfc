//! One run on one bench: states, safety, the engine that presses and measures.
//! Uses: `schedule`, `rig`, `clock`, `ids`. Never: SQL, HTTP.
//!
//! PURE: `run_state`, `rig_state`, `interlock`, `evidence`, `stopping`, `resume`, `eta`, `record`,
//! `halt`, `job`, `status`, `stuck`.

pub mod record;
pub mod journal;
pub mod diary;
pub mod run_state;
pub mod rig_state;
pub mod interlock;
pub mod evidence;
pub mod stopping;
pub mod resume;
pub mod eta;
pub mod job;
pub mod status;
pub mod halt;
pub mod estop;
pub mod command;
pub mod control;
pub mod stuck;
pub mod stage;
pub mod travel;
pub mod safe_end;
pub mod tare;
pub mod touch_off;
pub mod measure;
pub mod press;
pub mod manual;
pub mod show;
pub mod engine;
