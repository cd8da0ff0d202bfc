//! Datasets of a service on real files and sockets, and models made of them: what names give, what
//! never changes, exports that outlive the service, imports, the tools that a notebook uses.

mod ahead;
mod exports;
mod federate;
pub mod filled;
mod formats;
mod imports;
mod names;
mod models;
mod notebook;
mod private;
mod queries;
mod sql;
mod trainings;
