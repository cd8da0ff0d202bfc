//! Records of what is computed from trials (twins, datasets, models), tasks, and imports.
//! Uses: `core`, `table`, `bench`. Never: the files that its rows describe.

pub(crate) mod twins;
pub(crate) mod progress;
pub(crate) mod forces;
pub(crate) mod datasets;
pub(crate) mod models;
pub(crate) mod tasks;
pub(crate) mod task_queue;
pub(crate) mod imports;
