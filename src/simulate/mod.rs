//! Simulated frames: one trial, the twins of stored trials, free trials in bulk.
//! Uses: sim-core, `store`. Never: the rig, HTTP; no trial waits for a simulation.

pub mod contacts;
pub mod model;
pub mod picture;
pub mod export;
pub mod compare;
pub mod drift;
pub mod twins;
pub mod schema;
pub mod random;
