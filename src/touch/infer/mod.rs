//! From a frame to contacts: the serving models, and the three methods that use them.
//! Uses: `learn` (files of models), `dataset::force_map`, sim-core, tract. Never: HTTP, training,
//! motion.
//!
//! ```text
//! registry (folders, loaded plans) -> serving (what is promoted) -> pipeline (what serves)
//!     -> methods: paper, fast, exact; one_step for evaluations
//! ```

pub mod answer;
pub mod matching;
pub mod error;
pub mod plan;
pub mod registry;
pub mod maps;
pub mod slot;
pub mod scatter;
pub mod untouched_frame;
pub mod methods;
pub mod untouched;
pub mod quantity;
pub mod pipeline;
pub mod serving;
