//! Palpate: touches a robot skin overnight, learns from it, and tells where and how hard it is
//! touched. The modules below stand in the order in which data flows; imports only look back.

pub mod clock;
pub mod ids;
pub mod problem;
pub mod syntax;

pub mod schedule;
pub mod rig;
pub mod campaign;
pub mod store;
pub mod calibrate;
pub mod simulate;
pub mod dataset;
pub mod learn;
pub mod infer;
pub mod evaluate;
pub mod jobs;
pub mod conductor;
pub mod api;
pub mod cli;
