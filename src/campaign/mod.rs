//! One run on one bench: states, safety, the engine that presses and measures.
//! Uses: `schedule`, `rig`, `clock`, `ids`. Never: SQL, HTTP.

pub mod journal;
pub mod record;
