//! How good is it: the model against measured frames, and the pictures of it.
//! Uses: `store` (its rows), plotters. Never: motion, training, a number that was not measured.

pub mod figures;
pub mod simulation;
