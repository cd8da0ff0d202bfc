//! MATLAB's MAT files of version 5 to 7: headers and values of their arrays.
//! Uses: `mat_element`, `array`. Never: version 7.3, which is HDF5; a matrix that is not read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader};

use super::array::{Kind, Shape, Values, in_order, is_frame};
use super::invalid;
use super::mat_element::{CELL, CHAR, Elements, Matrix, NUMBERS, character, each};

/// Longest text of a cell array, characters.
const TEXT_MAX_CHARS: usize = 100;
/// Largest length of a character, bytes, as UTF-32 and as UTF-8.
const CHARACTER_BYTES: usize = 4;

/// Returns shape and type of each array.
///
/// # Errors
/// The file has another structure.
pub(super) fn shapes(file: File) -> io::Result<BTreeMap<String, Shape>> {
    let mut shapes = BTreeMap::new();
    each(&mut BufReader::new(file), |matrix, _| {
        // Without a name: data of objects.
        if !matrix.name.is_empty() {
            shapes.insert(matrix.name.clone(), shape(matrix));
        }
        Ok(())
    })?;
    Ok(shapes)
}

fn shape(matrix: &Matrix) -> Shape {
    let dims = matrix.dims.clone();
    match (matrix.class, dims.as_slice()) {
        // A text per row. All characters are held in UTF-32 until the texts are made of them.
        (CHAR, [rows, width]) => {
            let kind = Kind::Texts(width.saturating_mul(2 * CHARACTER_BYTES) as u64);
            Shape { dims: vec![*rows], kind }
        }
        (CELL, _) => Shape { dims, kind: Kind::Texts((TEXT_MAX_CHARS * CHARACTER_BYTES) as u64) },
        (class, _) if NUMBERS.contains(&class) && !matrix.is_complex => {
            Shape { dims, kind: Kind::Numbers }
        }
        _ => Shape { dims, kind: Kind::Other },
    }
}

/// Reads the wanted arrays.
///
/// # Errors
/// An array is damaged, or a cell array holds something else than texts.
pub(super) fn read(
    file: File,
    wanted: &BTreeMap<String, Shape>,
) -> io::Result<BTreeMap<String, Values>> {
    let mut arrays = BTreeMap::new();
    each(&mut BufReader::new(file), |matrix, elements| {
        let Some(known) = wanted.get(&matrix.name) else { return Ok(()) };
        if *known != shape(matrix) {
            return Err(invalid(format!("{}: occurs twice", matrix.name)));
        }
        let values = values(matrix, elements)
            .map_err(|error| invalid(format!("{}: {error}", matrix.name)))?;
        arrays.insert(matrix.name.clone(), values);
        Ok(())
    })?;
    Ok(arrays)
}

fn values(matrix: &Matrix, elements: &mut Elements<'_>) -> io::Result<Values> {
    let count = matrix.count();
    match matrix.class {
        CELL => elements.texts(count, TEXT_MAX_CHARS).map(Values::Texts),
        // As many empty texts as rows.
        CHAR if count == 0 => {
            Ok(Values::Texts(vec![String::new(); matrix.dims.first().copied().unwrap_or_default()]))
        }
        CHAR => {
            let characters = elements.numbers(count)?.map(|code| code.map(character));
            let characters = in_order(&matrix.dims, true, characters)?;
            let width = matrix.dims.last().copied().unwrap_or_default().max(1);
            let text = |row: &[char]| row.iter().collect::<String>();
            Ok(Values::Texts(
                characters.chunks(width).map(|row| text(row).trim_end().to_owned()).collect(),
            ))
        }
        _ if is_frame(&matrix.name) => {
            let values = elements.numbers(count)?.map(|value| value.map(|v| v as f32));
            in_order(&matrix.dims, true, values).map(Values::Singles)
        }
        _ => in_order(&matrix.dims, true, elements.numbers(count)?).map(Values::Numbers),
    }
}
