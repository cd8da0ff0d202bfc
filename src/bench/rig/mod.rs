//! The bench: capabilities in units, and the drivers that implement them. One device, one folder.
//! Uses: `clock`, `problem`. Never: campaigns, trials, storage, HTTP.

pub mod cells;
pub mod guard;
pub mod limits;
pub mod config;
pub mod reach;
pub mod error;
pub mod traits;

pub mod link;
pub mod motion;
pub mod repeats;
pub mod station;
pub mod words;

pub mod axis;
pub mod iai;
pub mod leadshine_em2rs;
pub mod oriental_az;

pub mod adam_6017;
pub mod waveshare_8ch;

pub mod ert_stream;

pub mod check;
pub mod registry;
