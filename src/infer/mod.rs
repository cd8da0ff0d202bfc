//! A model at work: frames in, answers out.
//! Uses: learn (its files). Never: HTTP, the rig, training.

pub mod plan;
