//! Files of other formats as batches of the columns that `rows` reads: CSV, NumPy's NPZ, MATLAB's MAT.
//! Uses: the files of this folder, csv, zip, flate2. Never: a check of a value that `rows` makes; a CSV
//! file as a whole in memory; arrays of more bytes than [`arrays::HELD_MAX_BYTES`].
//!
//! | column of `rows` | CSV | NPZ and MAT, of n trials |
//! |---|---|---|
//! | `voltages_v`, `sim_voltages_v` | `v0`, `v1`, ..; or `voltages_v[0]`, `voltages_v_0`, .. | (n, channels) |
//! | `frames_v` | none | (n, frames, channels); NaN throughout for a frame that a trial lacks |
//! | `contacts` | `x_mm`, `y_mm`, `force_n`, `diameter_mm`; `x1_mm`, `y1_mm`, `force1_n`, `x2_mm`, ..; or `contacts` as JSON | `contacts_xy_mm` (n, k, 2), or `x_mm` and `y_mm` (n) or (n, k); `force_n`, `diameter_mm` (n) or (n, k); or `contacts` (n, k, 4) |
//! | other columns | by their names | (n) |
//!
//! A contact is absent if position and force are: an empty cell, or NaN.

use std::io;

mod array;
pub(super) mod arrays;
mod batch;
pub(super) mod csv;
mod line_limit;
mod mat;
mod mat_element;
mod npy;
mod npz;

#[cfg(test)]
mod tests;

/// An error of the file's content.
fn invalid(words: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, words.into())
}
