//! Records of what is computed from trials (twins, datasets, exports, models, jobs), and imports.
//! Uses: `core`, `table`, `bench`. Never: the files that its rows describe.

/// Simulated twins of stored trials.
pub(crate) mod twins;
/// Datasets.
pub(crate) mod datasets;
/// Exports.
pub(crate) mod exports;
/// Trained nets, and promotions.
pub(crate) mod models;
/// Trainings and evaluations.
pub(crate) mod jobs;
/// Trials measured elsewhere.
pub(crate) mod imports;
