//! How good is it: the model against measured frames, answers against contacts, and pictures.
//! Uses: `store` (its rows), `dataset` (force maps), plotters. Never: motion, training, a number
//! that was not measured.
//!
//! PURE: all but what says otherwise. Answers: `matching` -> `touch` (a frame) -> `score` (many) ->
//! `table`, with `perfect` and `published` beside; `anova` says what they depend on.

pub mod quantile;
pub mod figures;
pub mod held_out;
pub mod simulation;
pub mod matching;
pub mod touch;
pub mod score;
pub mod perfect;
pub mod published;
pub mod table;
pub mod anova;
pub mod voltages;
pub mod request;
pub mod charts;
