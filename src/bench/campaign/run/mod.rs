//! One run: its states, the remaining plan, the thread that executes it, and decisions after a
//! halt.
//! Uses: everything in `campaign`, `schedule`. Never: HTTP, SQL.
//!
//! PURE: `run_state`, `resume`, `eta`, `halt`, `job`.

pub mod run_state;
pub mod resume;
pub mod eta;
pub mod job;
pub mod halt;
pub mod unattended;
pub mod control;
pub mod engine;
