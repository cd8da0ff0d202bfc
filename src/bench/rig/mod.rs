//! The bench: capabilities in units, and the drivers that implement them. One device, one file in
//! `drives` or `input_modules`.
//! Uses: `clock`, `problem`. Never: campaigns, trials, storage, HTTP.

pub mod cells;
pub mod guard;
pub mod profile;
pub mod limits;
pub mod wires;
pub mod axes;
pub mod config;
pub mod setup;
pub mod reach;
pub mod error;
pub mod traits;

pub mod link;
pub mod motion;
pub mod repeats;
pub mod station;
pub mod words;

pub mod axis;
pub mod inputs;
pub mod device;
pub mod drives;
pub mod input_modules;

pub mod ert_stream;

pub mod registry;
