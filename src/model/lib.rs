//! The model fitted to a skin, its simulations, and the overlay for a person's hand.
//! Uses: `words`, sim-core. Never: the rig, the database, HTTP.

use palpate_words::{chance, commit, digest, ids, new_file, problem, toml_words};

pub mod figure;
pub mod calibrate;
pub mod simulate;
pub mod overlay;
