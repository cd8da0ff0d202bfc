//! The model fitted to a skin, its simulations, and the overlay for a person's hand.
//! Uses: `words`, sim-core. Never: the rig, the database, HTTP.
//!
//! ```text
//! tables of measurements ---> calibrate --> Calibration --+
//! sensor file --------------------------------------------+--> simulate --> frames: of contacts, in bulk
//!      |                                                  +--> plots of the fit, on a page of figure
//!      +--> overlay --> PDF at true scale
//! ```
//! - `figure` is the page of every figure: SVG text with title, label and n. Later chapters draw on it, too.
//! - `calibrate` fits Eq. 1, the moduli and the skin to measurements. Text comes in, text goes out; the files
//!   are read and written by `cli`.
//! - `chunk` divides bulk work into parts that any process makes, on any machine, each under a key of its contents.
//! - `simulate` returns the frame of given contacts with the calibrated sensor, one trial or many; `random`
//!   writes Sim-Random as a folder of Parquet files, `twins` makes the twins of stored trials.
//! - `overlay` draws the points of a skin as a PDF, from which a person places weights.
//!
//! The physics is in sim-core; this chapter supplies its data and names the results. `data` and `touch` read the
//! simulated files and use the forward model, `service` simulates the twin of each trial and returns the
//! overlay, `studies` and `cli` draw figures and start fits and bulk simulations.

use palpate_words::{
    chance, commit, difference, digest, ids, new_file, plain, problem, record, toml_words,
};

pub mod figure;
pub mod calibrate;
pub mod chunk;
pub mod simulate;
pub mod overlay;
