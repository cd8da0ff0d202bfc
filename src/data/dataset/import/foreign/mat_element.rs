//! Elements of a MAT file: tags, headers of matrices, numbers and texts, read as a stream.
//! Uses: flate2, `npy` (its numbers). Never: an allocation of a size that only the file states.
//!
//! Source: MathWorks, "MAT-File Format", version 5 (R2024b): a header of 128 bytes, then elements, each a tag
//! of type and length and its data, padded to 8 bytes; compressed elements are not padded. Values are stored
//! column by column. No library is used: of those in the registry, one is alpha and reads no int32, the others
//! have one author and no bound of memory.

use std::io::{self, Read};

use flate2::read::ZlibDecoder;

use super::invalid;
use super::npy::{Item, number};

const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Largest length of the dimensions or the name of a matrix, bytes.
const SHORT_MAX_BYTES: u64 = 1024;

/// Class of a cell array.
pub(super) const CELL: u8 = 1;
/// Class of a char array.
pub(super) const CHAR: u8 = 4;
/// Class of objects, such as string arrays: their headers have no dimensions.
const OPAQUE: u8 = 17;
/// First and last class of numbers.
pub(super) const NUMBERS: std::ops::RangeInclusive<u8> = 6..=15;

/// Header of a matrix.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Matrix {
    /// Class of the values, by its number in the format.
    pub class: u8,
    /// Whether it has an imaginary part.
    pub is_complex: bool,
    /// Lengths of the dimensions; empty for objects.
    pub dims: Vec<usize>,
    /// Name; empty within a cell array.
    pub name: String,
}

impl Matrix {
    /// Number of values; the largest number if it is not representable.
    pub(super) fn count(&self) -> usize {
        self.dims.iter().fold(1, |all: usize, n| all.saturating_mul(*n))
    }
}

/// Type and length of an element; short data are part of its tag.
struct Tag {
    kind: u32,
    bytes: u64,
    short: Option<[u8; 4]>,
}

/// A stream of elements.
pub(super) struct Elements<'r> {
    inner: &'r mut dyn Read,
    big_endian: bool,
}

/// Calls `visit` with the header of each matrix of a file, and the stream after it.
///
/// # Errors
/// The file has another structure, or `visit` fails.
pub(super) fn each(
    file: &mut dyn Read,
    mut visit: impl FnMut(&Matrix, &mut Elements<'_>) -> io::Result<()>,
) -> io::Result<()> {
    let mut header = [0; 128];
    file.read_exact(&mut header)?;
    let big_endian = match &header[126..] {
        b"IM" => false,
        b"MI" => true,
        _ => return Err(invalid("its header lacks the mark of the order of bytes")),
    };
    loop {
        let Some(Tag { kind, bytes, short }) =
            (Elements { inner: &mut *file, big_endian }).tag()?
        else {
            return Ok(());
        };
        if short.is_some() {
            continue;
        }
        let mut body = (&mut *file).take(bytes);
        match kind {
            MATRIX => {
                let mut elements = Elements { inner: &mut body, big_endian };
                let matrix = elements.matrix()?;
                visit(&matrix, &mut elements)?;
            }
            COMPRESSED => {
                let mut inflated = io::BufReader::new(ZlibDecoder::new(&mut body));
                let mut elements = Elements { inner: &mut inflated, big_endian };
                if elements.tag()?.is_some_and(|tag| tag.kind == MATRIX) {
                    let matrix = elements.matrix()?;
                    visit(&matrix, &mut elements)?;
                }
            }
            _ => {}
        }
        io::copy(&mut body, &mut io::sink())?;
        if body.limit() > 0 {
            return Err(invalid("it ends within an array"));
        }
        if kind != COMPRESSED {
            io::copy(&mut (&mut *file).take(padding(bytes)), &mut io::sink())?;
        }
    }
}

fn padding(bytes: u64) -> u64 {
    (8 - bytes % 8) % 8
}

impl Elements<'_> {
    fn u32(&self, bytes: [u8; 4]) -> u32 {
        if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    /// Reads a tag; `None` at the end.
    fn tag(&mut self) -> io::Result<Option<Tag>> {
        let mut bytes = [0; 8];
        match self.inner.read(&mut bytes[..1])? {
            0 => return Ok(None),
            _ => self.inner.read_exact(&mut bytes[1..])?,
        }
        let [a, b, c, d, short @ ..] = bytes;
        let first = self.u32([a, b, c, d]);
        Ok(Some(match first >> 16 {
            0 => Tag { kind: first, bytes: u64::from(self.u32(short)), short: None },
            length @ 1..=4 => {
                Tag { kind: first & 0xFFFF, bytes: u64::from(length), short: Some(short) }
            }
            length => return Err(invalid(format!("a short element of {length} bytes"))),
        }))
    }

    fn needed(&mut self) -> io::Result<Tag> {
        self.tag()?.ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
    }

    /// Reads an element of few bytes.
    fn short(&mut self) -> io::Result<Vec<u8>> {
        let tag = self.needed()?;
        if let Some(short) = tag.short {
            return Ok(short[..tag.bytes as usize].to_vec());
        }
        if tag.bytes > SHORT_MAX_BYTES {
            return Err(invalid(format!("a name of {} bytes, limit {SHORT_MAX_BYTES}", tag.bytes)));
        }
        let mut data = vec![0; (tag.bytes + padding(tag.bytes)) as usize];
        self.inner.read_exact(&mut data)?;
        data.truncate(tag.bytes as usize);
        Ok(data)
    }

    /// Reads the header of a matrix, after its tag.
    fn matrix(&mut self) -> io::Result<Matrix> {
        let flags = self.short()?;
        let flags: [u8; 4] = flags
            .get(..4)
            .and_then(|flags| flags.try_into().ok())
            .ok_or_else(|| invalid("a matrix without flags"))?;
        let flags = self.u32(flags);
        let class = (flags & 0xFF) as u8;
        let mut dims = Vec::new();
        if class != OPAQUE {
            let lengths = self.short()?;
            for length in lengths.chunks_exact(4) {
                let length = self.u32([length[0], length[1], length[2], length[3]]);
                let length = i32::try_from(length).ok().and_then(|n| usize::try_from(n).ok());
                dims.push(length.ok_or_else(|| invalid("a dimension below 0"))?);
            }
        }
        let name = self.short()?;
        let name = String::from_utf8_lossy(&name).trim_end_matches('\0').to_owned();
        Ok(Matrix { class, is_complex: flags & 0x0800 != 0, dims, name })
    }

    /// Reads the real part of a matrix of numbers, or the codes of a char array, in the order of the file.
    ///
    /// # Errors
    /// The element holds another number of values, or no numbers; an item is an error if the file ends.
    pub(super) fn numbers(
        &mut self,
        count: usize,
    ) -> io::Result<impl Iterator<Item = io::Result<f64>>> {
        let tag = self.needed()?;
        let (item, width) = match tag.kind {
            1 => (Item::Int, 1),
            2 | 16 => (Item::Uint, 1),
            3 => (Item::Int, 2),
            4 | 17 => (Item::Uint, 2),
            5 => (Item::Int, 4),
            6 | 18 => (Item::Uint, 4),
            7 => (Item::Float, 4),
            9 => (Item::Float, 8),
            12 => (Item::Int, 8),
            13 => (Item::Uint, 8),
            kind => return Err(invalid(format!("an element of type {kind} instead of numbers"))),
        };
        let wanted = count.saturating_mul(width) as u64;
        if tag.bytes != wanted {
            let words = format!(
                "has {} bytes instead of {wanted}; only ASCII characters are read",
                tag.bytes
            );
            return Err(invalid(words));
        }
        let mut short = tag.short;
        let big_endian = self.big_endian;
        let inner = &mut *self.inner;
        let mut pad = if short.is_some() { 0 } else { padding(tag.bytes) };
        let mut left = count;
        Ok(std::iter::from_fn(move || {
            left = left.checked_sub(1)?;
            let mut bytes = [0; 8];
            let read = match &mut short {
                Some(data) => {
                    bytes[..width].copy_from_slice(&data[..width]);
                    data.rotate_left(width);
                    Ok(())
                }
                None => inner.read_exact(&mut bytes[..width]),
            };
            if left == 0 && pad > 0 {
                io::copy(&mut (&mut *inner).take(std::mem::take(&mut pad)), &mut io::sink()).ok();
            }
            if big_endian {
                bytes[..width].reverse();
            }
            let value = || number(item, &bytes[..width]).ok_or_else(|| invalid("holds no number"));
            Some(read.and_then(|()| value()))
        }))
    }

    /// Reads the texts of a cell array of char arrays; `most` is the largest number of characters.
    ///
    /// # Errors
    /// A cell holds something else, or a longer text.
    pub(super) fn texts(&mut self, count: usize, most: usize) -> io::Result<Vec<String>> {
        let mut texts = Vec::new();
        for _ in 0..count {
            let tag = self.needed()?;
            if tag.kind != MATRIX {
                return Err(invalid("a cell that is no matrix"));
            }
            if tag.bytes == 0 || tag.short.is_some() {
                texts.push(String::new());
                continue;
            }
            let mut body = (&mut *self.inner).take(tag.bytes);
            let mut cell = Elements { inner: &mut body, big_endian: self.big_endian };
            let matrix = cell.matrix()?;
            let count = matrix.count();
            let is_text = matrix.class == CHAR && matrix.dims.first().is_none_or(|n| *n <= 1);
            if count > 0 && (!is_text || count > most) {
                return Err(invalid(format!(
                    "each cell must be a text of at most {most} characters"
                )));
            }
            let mut text = String::new();
            if count > 0 {
                for code in cell.numbers(count)? {
                    text.push(character(code?));
                }
            }
            texts.push(text);
            io::copy(&mut body, &mut io::sink())?;
        }
        Ok(texts)
    }
}

pub(super) fn character(code: f64) -> char {
    char::from_u32(code as u32).unwrap_or(char::REPLACEMENT_CHARACTER)
}
