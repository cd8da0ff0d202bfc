//! One trial, pressed or placed by hand: motion to its depth, settling, frames, what is kept of it.
//! Uses: `campaign::{bench, kept}`, `schedule`. Never: retries, states (`run` decides).

pub mod press;
pub mod measure;
pub mod manual;
