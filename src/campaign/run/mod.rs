//! One run: its states, what is left of its plan, the thread that drives it, and what follows a halt.
//! Uses: everything in `campaign`, `schedule`. Never: HTTP, SQL.
//!
//! PURE: `run_state`, `resume`, `eta`, `halt`, `job`.

pub mod run_state;
pub mod resume;
pub mod eta;
pub mod job;
pub mod halt;
pub mod control;
pub mod engine;
