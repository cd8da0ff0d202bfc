//! An array of a file, as its reader returns it: shape and type by its header, and its values row by row.
//! PURE. Uses: the names of frames' columns. Never: a file, which arrays are read (`arrays` chooses them).

use std::io;

use crate::dataset::import::columns::FRAMES_V;
use crate::dataset::schema::VOLTAGES_V;
use crate::simulate::schema::SIM_VOLTAGES_V;

/// Type of the values of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Real numbers, or truth values.
    Numbers,
    /// Texts, each of which takes at most this number of bytes of memory.
    Texts(u64),
    /// Times, ms since 1970, UTC.
    Times,
    /// Values that cannot be read.
    Other,
}

impl Kind {
    fn words(self) -> &'static str {
        match self {
            Self::Numbers => "numbers",
            Self::Texts(_) => "texts",
            Self::Times => "times",
            Self::Other => "values of another type",
        }
    }
}

/// Shape and type of an array, by its header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Shape {
    /// Lengths of the dimensions.
    pub dims: Vec<usize>,
    /// Type of the values.
    pub kind: Kind,
}

impl Shape {
    /// Number of values; the largest number if it is not representable.
    pub(super) fn values(&self) -> u64 {
        self.dims.iter().fold(1, |all: u64, n| all.saturating_mul(*n as u64))
    }

    pub(super) fn shown(&self) -> String {
        let dims: Vec<String> = self.dims.iter().map(usize::to_string).collect();
        format!("({}) {}", dims.join(", "), self.kind.words())
    }
}

/// Values of an array, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Values {
    /// Voltages, V, in single precision.
    Singles(Vec<f32>),
    /// Real numbers in double precision; truth values are 0 and 1.
    Numbers(Vec<f64>),
    /// Texts, decoded to UTF-8.
    Texts(Vec<String>),
    /// Times, ms since 1970, UTC.
    Times(Vec<Option<i64>>),
}

/// Whether the values of the array with this name are held as f32.
pub(super) fn is_frame(name: &str) -> bool {
    name == VOLTAGES_V || name == SIM_VOLTAGES_V || name == FRAMES_V
}

/// Collects values in the order of the rows. `by_columns`: the first dimension varies fastest in `values`.
///
/// # Errors
/// The first error of `values`, or that they are too few.
pub(super) fn in_order<T: Clone + Default>(
    dims: &[usize],
    by_columns: bool,
    mut values: impl Iterator<Item = io::Result<T>>,
) -> io::Result<Vec<T>> {
    let count = dims.iter().fold(1, |all: usize, n| all.saturating_mul(*n));
    let mut out = vec![T::default(); count];
    let mut index = vec![0_usize; dims.len()];
    for n in 0..count {
        let value = values.next().unwrap_or_else(|| Err(io::ErrorKind::UnexpectedEof.into()))?;
        let at = match by_columns {
            true => dims.iter().zip(&index).fold(0, |at, (length, i)| at * length + i),
            false => n,
        };
        out[at] = value;
        for (i, length) in index.iter_mut().zip(dims) {
            *i += 1;
            if *i < *length {
                break;
            }
            *i = 0;
        }
    }
    Ok(out)
}
