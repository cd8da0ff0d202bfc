//! NumPy's NPZ: headers and values of its arrays.
//! Uses: zip, `npy`, `array`. Never: an array that is not read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};

use zip::ZipArchive;

use super::array::{Kind, Shape, Values, in_order, is_frame};
use super::invalid;
use super::npy::{Header, Item};

/// Longest text of an array: 1000 characters.
const TEXT_MAX_BYTES: usize = 4000;

/// An error with the name of its array.
fn of_array(name: &str) -> impl Fn(io::Error) -> io::Error {
    move |error| invalid(format!("{name}: {error}"))
}

fn archive(file: File) -> io::Result<ZipArchive<BufReader<File>>> {
    ZipArchive::new(BufReader::new(file)).map_err(|error| invalid(error.to_string()))
}

/// Returns shape and type of each array.
///
/// # Errors
/// The file is no zip file, or it ends within an array's header.
pub(super) fn shapes(file: File) -> io::Result<BTreeMap<String, Shape>> {
    let mut archive = archive(file)?;
    let mut shapes = BTreeMap::new();
    for at in 0..archive.len() {
        let entry = archive.by_index(at).map_err(|error| invalid(error.to_string()))?;
        let name = entry.name().map_err(|error| invalid(error.to_string()))?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let shape = match Header::read(&mut BufReader::new(entry)) {
            Ok(header) => Shape { kind: kind(&header), dims: header.dims },
            // It is ignored unless it has the name of a column.
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                Shape { dims: Vec::new(), kind: Kind::Other }
            }
            Err(error) => return Err(of_array(&name)(error)),
        };
        shapes.insert(name, shape);
    }
    Ok(shapes)
}

/// Reads the wanted arrays.
///
/// # Errors
/// An array is damaged, or has another shape than before.
pub(super) fn read(
    file: File,
    wanted: &BTreeMap<String, Shape>,
) -> io::Result<BTreeMap<String, Values>> {
    let mut archive = archive(file)?;
    let mut arrays = BTreeMap::new();
    for (name, shape) in wanted {
        let entry =
            archive.by_name(&format!("{name}.npy")).map_err(|error| invalid(error.to_string()))?;
        let mut entry = BufReader::new(entry);
        let header = Header::read(&mut entry).map_err(of_array(name))?;
        if header.dims != shape.dims {
            return Err(invalid(format!("{name}: occurs twice")));
        }
        arrays.insert(name.clone(), values(&header, entry, name).map_err(of_array(name))?);
    }
    Ok(arrays)
}

fn kind(header: &Header) -> Kind {
    match header.item {
        Item::Bool | Item::Int | Item::Uint | Item::Float => Kind::Numbers,
        Item::Unicode | Item::Bytes if (1..=TEXT_MAX_BYTES).contains(&header.bytes) => {
            Kind::Texts(header.bytes as u64)
        }
        Item::Time(_) => Kind::Times,
        Item::Unicode | Item::Bytes | Item::Other => Kind::Other,
    }
}

fn values(header: &Header, from: impl Read, name: &str) -> io::Result<Values> {
    let (dims, by_columns) = (&header.dims, header.by_columns);
    match kind(header) {
        Kind::Numbers if is_frame(name) => {
            let numbers = header.numbers(from).map(|value| value.map(|value| value as f32));
            in_order(dims, by_columns, numbers).map(Values::Singles)
        }
        Kind::Numbers => in_order(dims, by_columns, header.numbers(from)).map(Values::Numbers),
        Kind::Texts(_) => in_order(dims, by_columns, header.texts(from)).map(Values::Texts),
        Kind::Times => in_order(dims, by_columns, header.times_ms(from)).map(Values::Times),
        Kind::Other => Err(invalid("must be an array of numbers, texts or times")),
    }
}
