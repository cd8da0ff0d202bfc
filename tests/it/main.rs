//! Tests of the whole crate that may run next to each other: real files, sockets and processes, but no
//! time limit that a busy machine exceeds. They are one binary, because each binary links every
//! dependency again.
//!
//! Separate binaries: `architecture` links nothing, so that it is built and run in seconds after any change; `system`
//! measures how soon a rig stops.
//! A test here has its own folders (`support::Folder`) and port 0, changes neither the environment nor
//! the current folder, and counts nothing of the process.

mod attacks;
mod web_words;
mod calibrate_skin;
mod calibration;
#[path = "../common/mod.rs"]
mod common;
mod contract;
mod datasets;
mod desk;
mod edited;
mod evaluate;
mod experiments;
mod golden_plans;
mod independent;
mod independent_fit;
mod journal;
mod left;
mod morning;
mod mistakes;
mod network;
mod onnx;
mod night;
mod notify;
mod offline;
mod old_data;
mod once;
mod overlay;
mod pages;
mod requests;
mod resume;
mod rights;
mod rig_transcripts;
mod sim_random;
mod simulate;
mod store_durability;
mod streams;
mod support;
mod taken_over;
mod twin_chunks;
mod waiting;
mod workers;
