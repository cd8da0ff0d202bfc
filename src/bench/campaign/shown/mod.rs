//! The campaign seen from outside: the status and how it is filled, requests and their answers.
//! Uses: `campaign::{bench, run}`. Never: decisions, HTTP.
//!
//! PURE: `status`, `placement`, `rig_action`, `run_action`.

pub mod safe_end;
pub mod placement;
pub mod status;
pub mod rig_action;
pub mod run_action;
pub mod samples;
pub mod frames;
pub mod show;
pub mod command;
