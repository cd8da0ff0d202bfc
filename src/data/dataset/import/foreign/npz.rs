//! NumPy's NPZ: headers and values of its arrays.
//! Uses: zip, npyz, `arrays`. Never: pickle; an array that is not read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Cursor, Read};

use npyz::{DType, NpyFile, Order, TimeUnits, TypeChar, TypeStr};
use zip::ZipArchive;

use super::arrays::{Kind, Shape, Values, in_order, is_frame};

/// Largest length of the header of an array, bytes: simple types need 128.
const HEADER_MAX_BYTES: usize = 4096;
/// Longest text of an array, characters.
const TEXT_MAX_CHARS: u64 = 1000;
/// NumPy's NaT.
const NOT_A_TIME: i64 = i64::MIN;

fn invalid(words: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, words.into())
}

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
        let shape = match open(entry) {
            Ok(npy) => {
                let length = |n: &u64| usize::try_from(*n).unwrap_or(usize::MAX);
                Shape { dims: npy.shape().iter().map(length).collect(), kind: kind(&npy.dtype()) }
            }
            // An array of records, which is ignored unless it has the name of a column.
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
        let npy = open(entry).map_err(of_array(name))?;
        if npy.shape().iter().map(|n| *n as usize).ne(shape.dims.iter().copied()) {
            return Err(invalid(format!("{name}: occurs twice")));
        }
        arrays.insert(name.clone(), values(npy, name, &shape.dims).map_err(of_array(name))?);
    }
    Ok(arrays)
}

/// Opens an array after a check of its header: the parser of headers descends into each bracket, so that a
/// crafted header must not have many.
fn open<'r, R: Read + 'r>(entry: R) -> io::Result<NpyFile<Box<dyn Read + 'r>>> {
    let mut entry = BufReader::new(entry);
    let mut start = vec![0; 8];
    entry.read_exact(&mut start)?;
    if !start.starts_with(b"\x93NUMPY") {
        return Err(invalid("is no array of NumPy"));
    }
    let mut length = vec![0; if start[6] == 1 { 2 } else { 4 }];
    entry.read_exact(&mut length)?;
    let bytes = length.iter().rev().fold(0_usize, |all, byte| all << 8 | usize::from(*byte));
    if bytes > HEADER_MAX_BYTES {
        return Err(invalid(format!("its header has {bytes} bytes, limit {HEADER_MAX_BYTES}")));
    }
    let mut header = vec![0; bytes];
    entry.read_exact(&mut header)?;
    let opening = header.iter().filter(|byte| b"([{".contains(byte)).count();
    // One of the dictionary, one of the shape, and one of the unit of a time; records have more.
    if opening > 3 {
        return Err(invalid("must be an array of numbers, texts or times"));
    }
    let start: Vec<u8> = [start, length, header].concat();
    let whole: Box<dyn Read + 'r> = Box::new(Cursor::new(start).chain(entry));
    NpyFile::new(whole)
}

fn kind(of: &DType) -> Kind {
    let DType::Plain(of) = of else { return Kind::Other };
    match of.type_char() {
        TypeChar::Bool | TypeChar::Int | TypeChar::Uint => Kind::Numbers,
        TypeChar::Float if matches!(of.size_field(), 4 | 8) => Kind::Numbers,
        TypeChar::UnicodeStr if of.size_field() <= TEXT_MAX_CHARS => {
            Kind::Texts(4 * of.size_field())
        }
        TypeChar::ByteStr if of.size_field() <= TEXT_MAX_CHARS => Kind::Texts(of.size_field()),
        TypeChar::DateTime if per_ms(of).is_some() => Kind::Times,
        _ => Kind::Other,
    }
}

/// Milliseconds per unit of a type of times, and units per millisecond.
fn per_ms(of: &TypeStr) -> Option<(i64, i64)> {
    match of.time_units()? {
        TimeUnits::Second => Some((1000, 1)),
        TimeUnits::Millisecond => Some((1, 1)),
        TimeUnits::Microsecond => Some((1, 1000)),
        TimeUnits::Nanosecond => Some((1, 1_000_000)),
        _ => None,
    }
}

fn values<R: Read>(npy: NpyFile<R>, name: &str, dims: &[usize]) -> io::Result<Values> {
    let by_columns = npy.order() == Order::Fortran;
    let of = npy.dtype();
    match kind(&of) {
        Kind::Numbers if is_frame(name) => {
            numbers(npy, dims, by_columns, |v| v as f32).map(Values::Singles)
        }
        Kind::Numbers => numbers(npy, dims, by_columns, |v| v).map(Values::Numbers),
        Kind::Texts(_) => {
            let texts = npy.data::<String>().map_err(|error| invalid(error.to_string()))?;
            in_order(dims, by_columns, texts).map(Values::Texts)
        }
        Kind::Times => {
            let DType::Plain(of) = of else { return Err(invalid("is no array of times")) };
            let (times, per) =
                per_ms(&of).ok_or_else(|| invalid("must be times in s, ms, us or ns"))?;
            let read = npy.data::<i64>().map_err(|error| invalid(error.to_string()))?;
            let at = |value: i64| {
                (value != NOT_A_TIME)
                    .then(|| value.checked_mul(times).map(|v| v.div_euclid(per)))
                    .flatten()
            };
            in_order(dims, by_columns, read.map(|value| value.map(at))).map(Values::Times)
        }
        Kind::Other => Err(invalid("must be an array of numbers, texts or times")),
    }
}

/// Reads numbers of any type.
fn numbers<R: Read, T: Clone + Default>(
    npy: NpyFile<R>,
    dims: &[usize],
    by_columns: bool,
    to: impl Fn(f64) -> T,
) -> io::Result<Vec<T>> {
    macro_rules! of {
        ($($kind:ty => $value:expr),*) => {{
            let npy = npy;
            $(let npy = match npy.try_data::<$kind>() {
                Ok(values) => {
                    let values = values.map(|value| value.map($value).map(&to));
                    return in_order(dims, by_columns, values);
                }
                Err(npy) => npy,
            };)*
            drop(npy);
        }};
    }
    of!(f32 => f64::from, f64 => |v| v, u8 => f64::from, u16 => f64::from, u32 => f64::from,
        u64 => |v| v as f64, i8 => f64::from, i16 => f64::from, i32 => f64::from, i64 => |v| v as f64,
        bool => |v| f64::from(u8::from(v)));
    Err(invalid("must be an array of numbers"))
}
