//! One trial, pressed or manual: motion to its depth, settling, frames, its record.
//! Uses: `campaign::{bench, diary}`, `schedule`. Never: retries, states (`run` decides).

pub mod press;
pub mod measure;
pub mod rest;
pub mod untouched;
pub mod manual;
