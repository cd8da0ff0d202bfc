//! From a frame to contacts: the serving models, and the three methods that use them.
//! Uses: `learn` (files of models), `dataset::force_map`, sim-core, tract. Never: HTTP, training,
//! motion.
//!
//! ```text
//! registry (folders, loaded plans) -> serving (what is promoted) -> methods: paper, fast, exact
//! ```

pub mod answer;
pub mod error;
pub mod plan;
pub mod registry;
pub mod maps;
pub mod points;
pub mod exact;
pub mod one_step;
pub mod skins;
pub mod serving;
