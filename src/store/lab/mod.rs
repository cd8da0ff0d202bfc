//! Records of what is computed from trials (twins, datasets, models), tasks, and imports.
//! Uses: `core`, `table`, `bench`. Never: the files that its rows describe.

/// Simulated twins of stored trials.
pub(crate) mod twins;
/// Progress of a run by configuration, and over time.
pub(crate) mod progress;
/// Forces of a run over depth.
pub(crate) mod forces;
/// Facts of datasets; their rows are files.
pub(crate) mod datasets;
/// Trained nets, and promotions.
pub(crate) mod models;
/// Exports, trainings and evaluations.
pub(crate) mod tasks;
/// Queues of tasks.
pub(crate) mod task_queue;
/// Trials measured elsewhere.
pub(crate) mod imports;
