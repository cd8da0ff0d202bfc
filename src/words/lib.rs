//! The shared types: time, random numbers, keys, records of a run, rejected values.
//! Uses: no other chapter. Never: devices, files, the database, HTTP.

pub mod chance;
pub mod clock;
pub mod commit;
pub mod digest;
pub mod ids;
pub mod journal;
pub mod problem;
pub mod record;
pub mod state;
pub mod syntax;
