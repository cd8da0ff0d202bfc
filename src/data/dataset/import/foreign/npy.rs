//! An array of NumPy's format `.npy`: its header, and its values one by one.
//! Uses: `format::npy` (the time that is none). Never: pickle, records.
//!
//! Source: NumPy, `numpy.lib.format`, versions 1.0 to 3.0. Kept crates read the header with a parser generator, which
//! costs twelve crates.

use std::io::{self, Read};

use super::invalid;
use crate::dataset::format::npy::NOT_A_TIME;

/// Largest length of the header of an array, bytes: simple types need 128.
const HEADER_MAX_BYTES: usize = 4096;
/// Length of a character of a text in UTF-32, bytes.
const CHARACTER_BYTES: usize = 4;

/// How a value is stored, by its type code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Item {
    /// Truth value, 1 byte.
    Bool,
    /// Signed integer.
    Int,
    /// Unsigned integer.
    Uint,
    /// IEEE floating point number.
    Float,
    /// UTF-32, padded with zeros.
    Unicode,
    /// Bytes, padded with zeros.
    Bytes,
    /// Time since 1970; the units of a second as a power of ten: s 0, ms 3, us 6, ns 9.
    Time(u32),
    /// Values that cannot be read.
    Other,
}

/// What precedes the values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    /// Type of the values.
    pub item: Item,
    /// Length of a value, bytes.
    pub bytes: usize,
    /// Whether values are stored with their most significant byte first.
    pub big_endian: bool,
    /// Whether the first dimension varies fastest.
    pub by_columns: bool,
    /// Lengths of the dimensions.
    pub dims: Vec<usize>,
}

impl Header {
    /// Reads the header; the reader is at the first value then.
    ///
    /// # Errors
    /// `InvalidData`: it is no array of NumPy, or its header is longer than 4096 bytes or lacks an entry. Errors of
    /// `from`.
    pub(super) fn read(from: &mut impl Read) -> io::Result<Self> {
        let mut start = [0; 8];
        from.read_exact(&mut start)?;
        if !start.starts_with(b"\x93NUMPY") {
            return Err(invalid("is no array of NumPy"));
        }
        let mut length = [0; 4];
        from.read_exact(&mut length[..if start[6] == 1 { 2 } else { 4 }])?;
        let bytes = u32::from_le_bytes(length) as usize;
        if bytes > HEADER_MAX_BYTES {
            return Err(invalid(format!("its header has {bytes} bytes, limit {HEADER_MAX_BYTES}")));
        }
        let mut text = vec![0; bytes];
        from.read_exact(&mut text)?;
        Self::parse(&String::from_utf8_lossy(&text))
            .ok_or_else(|| invalid("its header is not that of an array of numbers, texts or times"))
    }

    /// Parses `{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }`, entries in any order.
    fn parse(text: &str) -> Option<Self> {
        let after = |key: &str| {
            let at = text.find(&format!("'{key}'"))? + key.len() + 2;
            text[at..].trim_start().strip_prefix(':').map(str::trim_start)
        };
        let descr = after("descr")?;
        let (item, bytes, big_endian) = match descr.strip_prefix('\'') {
            Some(descr) => type_of(descr.split_once('\'')?.0)?,
            None => (Item::Other, 0, false), // a list of the fields of a record
        };
        let by_columns = after("fortran_order")?.starts_with("True");
        let (dims, _) = after("shape")?.strip_prefix('(')?.split_once(')')?;
        let dims = dims.split(',').map(str::trim).filter(|length| !length.is_empty());
        let dims = dims.map(|length| length.parse().ok()).collect::<Option<_>>()?;
        Some(Self { item, bytes, big_endian, by_columns, dims })
    }

    /// Reads the values as bytes, the least significant one first, in the order of the file.
    fn values<T>(
        &self,
        mut from: impl Read,
        of: impl Fn(&[u8]) -> Option<T>,
    ) -> impl Iterator<Item = io::Result<T>> {
        let swapped = match (self.big_endian, self.item) {
            (false, _) | (true, Item::Bytes) => 1,
            (true, Item::Unicode) => CHARACTER_BYTES,
            (true, _) => self.bytes,
        };
        let mut value = vec![0; self.bytes];
        std::iter::repeat_with(move || {
            from.read_exact(&mut value)?;
            value.chunks_exact_mut(swapped.max(1)).for_each(<[u8]>::reverse);
            of(&value)
                .ok_or_else(|| invalid("must be numbers, texts or times, as its header states"))
        })
    }

    /// Reads numbers and truth values.
    pub(super) fn numbers(&self, from: impl Read) -> impl Iterator<Item = io::Result<f64>> {
        let item = self.item;
        self.values(from, move |bytes| number(item, bytes))
    }

    /// Reads texts without their padding.
    pub(super) fn texts(&self, from: impl Read) -> impl Iterator<Item = io::Result<String>> {
        let item = self.item;
        self.values(from, move |bytes| match item {
            Item::Bytes => String::from_utf8(bytes.to_vec()).ok(),
            Item::Unicode => bytes
                .as_chunks::<CHARACTER_BYTES>()
                .0
                .iter()
                .map(|code| char::from_u32(u32::from_le_bytes(*code)))
                .collect(),
            _ => None,
        })
        .map(|text| text.map(|text| text.trim_end_matches('\0').to_owned()))
    }

    /// Reads times, ms since 1970; `None` for NaT and times that are not representable.
    pub(super) fn times_ms(
        &self,
        from: impl Read,
    ) -> impl Iterator<Item = io::Result<Option<i64>>> {
        let item = self.item;
        self.values(from, move |bytes| {
            let (Item::Time(digits), Ok(bytes)) = (item, bytes.try_into()) else { return None };
            let time = i64::from_le_bytes(bytes);
            Some(match digits {
                _ if time == NOT_A_TIME => None,
                0..=3 => time.checked_mul(10_i64.pow(3 - digits)),
                _ => Some(time.div_euclid(10_i64.pow(digits - 3))),
            })
        })
    }
}

/// Type, length in bytes and order of a type code such as `<f8`, `|S12`, `<U3` (3 characters), `<M8[ms]`.
fn type_of(code: &str) -> Option<(Item, usize, bool)> {
    let big_endian = code.starts_with('>');
    let code = code.trim_start_matches(['<', '>', '|', '=']);
    let (size, unit) = code.get(1..)?.split_once('[').unwrap_or((code.get(1..)?, ""));
    let size: usize = size.parse().unwrap_or(0);
    let (item, bytes) = match (code.as_bytes()[0], size, unit) {
        (b'b', 1, _) => (Item::Bool, 1),
        (b'i', 1 | 2 | 4 | 8, _) => (Item::Int, size),
        (b'u', 1 | 2 | 4 | 8, _) => (Item::Uint, size),
        (b'f', 4 | 8, _) => (Item::Float, size),
        (b'U', _, _) => (Item::Unicode, size.checked_mul(CHARACTER_BYTES)?),
        (b'S', _, _) => (Item::Bytes, size),
        (b'M', 8, "s]") => (Item::Time(0), 8),
        (b'M', 8, "ms]") => (Item::Time(3), 8),
        (b'M', 8, "us]") => (Item::Time(6), 8),
        (b'M', 8, "ns]") => (Item::Time(9), 8),
        _ => (Item::Other, 0),
    };
    Some((item, bytes, big_endian))
}

/// The number that bytes of a type stand for, the least significant one first; `None` for other types.
pub(super) fn number(item: Item, bytes: &[u8]) -> Option<f64> {
    let mut wide = [0; 8];
    wide.get_mut(..bytes.len())?.copy_from_slice(bytes);
    let unused_bits = 64 - 8 * u32::try_from(bytes.len()).ok()?;
    Some(match (item, bytes.len()) {
        (Item::Bool, _) => f64::from(wide[0] != 0),
        (Item::Uint, _) => u64::from_le_bytes(wide) as f64,
        // Shifted to the left end and back, which repeats the sign.
        (Item::Int, _) => (i64::from_le_bytes(wide) << unused_bits >> unused_bits) as f64,
        (Item::Float, 4) => f64::from(f32::from_le_bytes(bytes.try_into().ok()?)),
        (Item::Float, 8) => f64::from_le_bytes(wide),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each type of number, in both orders of bytes; the bytes are those of `numpy.array([..]).tobytes()`.
    #[test]
    fn numbers_of_every_type_are_read() {
        for (code, bytes, value) in [
            ("|b1", &[1][..], 1.0),
            ("|i1", &[0xfe], -2.0),
            ("|u1", &[0xfe], 254.0),
            ("<i2", &[0xfe, 0xff], -2.0),
            (">i2", &[0xff, 0xfe], -2.0),
            (">u2", &[0xff, 0xfe], 65534.0),
            ("<i4", &[0, 0, 0, 0x80], -2_147_483_648.0),
            ("<u4", &[0, 0, 0, 0x80], 2_147_483_648.0),
            ("<i8", &[0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff], -2.0),
            (">u8", &[0, 0, 0, 0, 0, 0, 1, 0], 256.0),
            ("<f4", &[0, 0, 0xc0, 0x3f], 1.5),
            (">f4", &[0x3f, 0xc0, 0, 0], 1.5),
            (">f8", &[0xbf, 0xf8, 0, 0, 0, 0, 0, 0], -1.5),
        ] {
            let text = format!("{{'descr': '{code}', 'fortran_order': False, 'shape': (), }}");
            let header = Header::parse(&text).unwrap();
            assert_eq!(header.bytes, bytes.len(), "{code}");
            assert_eq!(header.numbers(bytes).next().unwrap().unwrap(), value, "{code}");
        }
    }

    #[test]
    fn texts_and_times_are_read() {
        let of = |code: &str| {
            Header::parse(&format!("{{'shape': (2,), 'fortran_order': True, 'descr': '{code}'}}"))
                .unwrap()
        };
        let unicode = of(">U2");
        assert_eq!((unicode.by_columns, &unicode.dims[..]), (true, &[2][..]));
        let text = unicode.texts(&[0, 0, 0, 0xb5, 0, 0, 0, 0][..]).next().unwrap().unwrap();
        assert_eq!(text, "\u{b5}");
        assert_eq!(of("|S4").texts(&b"ab\0\0"[..]).next().unwrap().unwrap(), "ab");
        for (code, ms) in [("<M8[s]", -7000), ("<M8[ms]", -7), ("<M8[us]", -1), ("<M8[ns]", -1)] {
            let times = of(code).times_ms(&(-7_i64).to_le_bytes()[..]).next().unwrap().unwrap();
            assert_eq!(times, Some(ms), "{code}");
        }
        let none = of("<M8[s]").times_ms(&i64::MIN.to_le_bytes()[..]).next().unwrap().unwrap();
        assert_eq!(none, None);
    }

    #[test]
    fn other_types_are_known_as_such_and_other_headers_refused() {
        for code in ["|O", "<c16", "<M8[D]", "<M8[25s]", "<f2", "<m8[s]"] {
            let text = format!("{{'descr': '{code}', 'fortran_order': False, 'shape': (2, 3), }}");
            assert_eq!(Header::parse(&text).unwrap().item, Item::Other, "{code}");
        }
        let record = "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (2,), }";
        assert_eq!(Header::parse(record).unwrap().item, Item::Other);
        for text in
            ["", "{'descr': '<f8'}", "{'descr': '<f8', 'fortran_order': False, 'shape': ((2,), }"]
        {
            assert_eq!(Header::parse(text), None, "{text}");
        }
        let truncated =
            Header::parse("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}").unwrap();
        assert!(truncated.numbers(&[0; 7][..]).next().unwrap().is_err());
    }
}
