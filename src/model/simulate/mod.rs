//! Simulated frames: one trial, the twins of stored trials, free trials in bulk.
//! Uses: sim-core. Never: the rig, the database, HTTP.

pub mod contacts;
pub mod dent;
pub mod pressed;
pub mod model;
pub mod picture;
pub mod export;
pub mod compare;
pub mod schema;
pub mod random;
pub mod twins;
