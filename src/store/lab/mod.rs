//! What is made of the trials: twins, datasets, exports, models; and trials from elsewhere.
//! Uses: `core`, `table`, `bench`. Never: a file of a dataset or a model.

/// Simulated twins of stored trials.
pub(crate) mod twins;
/// Datasets.
pub(crate) mod datasets;
/// Exports.
pub(crate) mod exports;
/// Trained nets, and what serves.
pub(crate) mod models;
/// Trainings and evaluations.
pub(crate) mod jobs;
/// Trials measured elsewhere.
pub(crate) mod imports;
