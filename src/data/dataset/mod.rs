//! Datasets: definitions, labels, splits, force maps, files, exports and imports.
//! Uses: `store`, `simulate` (Sim-Random's manifests). Never: HTTP, motion, a dataset that changes.
//!
//! PURE: `definition`, `filter`, `split`, `force_map`, `schema`, `batch`, `survey`, `select`,
//! `sort`, `card`, `origin`, `package`, `prune`, `pressed`, `space`.
//!
//! ```text
//! definition -> build: survey, batch, shards -> file DATA/datasets/ds-..  -> read, select -> format
//! files of several services -> federate -> tables of all rigs, each an import
//! ```

pub mod error;
pub mod definition;
pub mod schema;
pub mod space;
pub mod filter;
pub mod split;
pub mod force_map;
pub mod batch;
pub mod survey;
pub mod shards;
pub mod background;
pub mod format;
pub mod select;
pub mod sort;
pub mod read;
pub mod card;
pub mod origin;
pub mod inputs;
pub mod pressed;
pub mod encoder;
pub mod begun;
pub mod build;
pub mod making;
pub mod export;
pub mod import;
pub mod federate;
pub mod package;
pub mod prune;
pub mod used;
pub mod catalog;
