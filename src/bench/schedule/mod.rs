//! From an experiment file to a plan in which everything is decided before the run.
//! PURE: no async, files, clock or unseeded chance. Uses: `problem`, sim-core's sensor.

mod list_schema;
pub mod experiment;
pub mod schema;
pub mod configuration;
pub mod order;
pub mod manual;
pub mod plan;
pub mod kept;
pub mod visits;
pub mod reach;
pub mod lint;
pub mod estimate;
pub mod preflight;

#[cfg(test)]
pub(crate) mod tests;
