//! Datasets of a service on real files and sockets: what names give, what never changes, exports that
//! outlive the service, imports, and the tools that a notebook uses.

mod exports;
mod filled;
mod imports;
mod names;
mod notebook;
mod queries;
