//! From an experiment file to a plan that leaves no choice for run time.
//! PURE: no async, files, clock or unseeded chance. Uses: `problem`, sim-core's sensor.

pub mod experiment;
