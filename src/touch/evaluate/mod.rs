//! Scores: the model compared with measured frames, answers compared with contacts, and figures.
//! Uses: `store` (its rows), `dataset` (force maps), plotters. Never: motion, training, a number
//! that was not measured.
//!
//! PURE, except for files whose heads state otherwise. Answers: `touch` (a frame, judged by `distances`) -> `score` (many) -> `table`, with
//! `perfect` and `published` for comparison; `anova` analyses factors.

pub mod figures;
pub mod held_out;
pub mod simulation;
pub mod distances;
pub mod touch;
pub mod score;
pub mod reliability;
pub mod perfect;
pub mod published;
pub mod table;
pub mod anova;
pub mod voltages;
pub mod quantities;
pub mod request;
pub mod frame_pairs;
pub mod charts;
pub mod force_maps;
pub mod run_figures;
pub mod losses;
pub mod opening;
