//! Parts of a file: what a `Range` header selects, and the body with it.
//! Uses: http-range-header. Never: more of a file in memory than a piece.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use axum::body::Body;
use bytes::Bytes;
use futures::stream::try_unfold;
use http_range_header::{EndPosition, StartPosition, parse_range_header};

use super::limits::RANGES_MAX;

/// Length of the pieces in which a file is read, bytes.
const PIECE_BYTES: u64 = 64 << 10;

/// What a `Range` header selects of a file.
#[derive(Debug, PartialEq, Eq)]
pub enum Selected {
    /// All of it: the header is invalid, or selects too many parts.
    Whole,
    /// These parts, in their order in the file, with gaps between them. At least one.
    Parts(Vec<Range<u64>>),
    /// No byte of the file.
    Nothing,
}

impl Selected {
    /// Reads the value of a `Range` header for a file of `size` bytes. Overlapping and adjacent parts
    /// become one.
    pub fn of(range: &str, size: u64) -> Self {
        let Ok(parsed) = parse_range_header(range) else { return Self::Whole };
        let mut parts = Vec::new();
        for part in parsed.ranges {
            let (start, end) = match (part.start, part.end) {
                (StartPosition::FromLast(n), _) => (size.saturating_sub(n), size),
                (StartPosition::Index(start), EndPosition::LastByte) => (start, size),
                (StartPosition::Index(start), EndPosition::Index(last)) if last < start => {
                    return Self::Whole;
                }
                (StartPosition::Index(start), EndPosition::Index(last)) => {
                    (start, last.saturating_add(1).min(size))
                }
            };
            if start < end {
                parts.push(start..end);
            }
        }
        parts.sort_by_key(|part| part.start);
        let mut merged: Vec<Range<u64>> = Vec::new();
        for part in parts {
            match merged.last_mut() {
                Some(last) if part.start <= last.end => last.end = last.end.max(part.end),
                _ => merged.push(part),
            }
        }
        match merged.len() {
            0 => Self::Nothing,
            n if n > RANGES_MAX => Self::Whole,
            _ => Self::Parts(merged),
        }
    }
}

/// Value of the header `Content-Range` for a part of a file of `size` bytes.
pub fn content_range(part: &Range<u64>, size: u64) -> String {
    format!("bytes {}-{}/{size}", part.start, part.end - 1)
}

/// A piece of a body.
enum Piece {
    Text(Bytes),
    Of(Range<u64>),
}

/// Returns the body with one part of a file, and its length.
pub fn one(file: File, part: Range<u64>) -> (Body, u64) {
    body(file, [Piece::Of(part)].into())
}

/// Returns the body `multipart/byteranges` with parts of a file of `size` bytes, and its length.
pub fn several(
    file: File,
    parts: Vec<Range<u64>>,
    size: u64,
    media_type: &str,
    boundary: &str,
) -> (Body, u64) {
    let mut pieces = VecDeque::new();
    for part in parts {
        let range = content_range(&part, size);
        let head = format!(
            "\r\n--{boundary}\r\ncontent-type: {media_type}\r\ncontent-range: {range}\r\n\r\n"
        );
        pieces.extend([Piece::Text(head.into()), Piece::Of(part)]);
    }
    pieces.push_back(Piece::Text(format!("\r\n--{boundary}--\r\n").into()));
    body(file, pieces)
}

fn body(file: File, pieces: VecDeque<Piece>) -> (Body, u64) {
    let length = pieces.iter().map(|piece| match piece {
        Piece::Text(text) => text.len() as u64,
        Piece::Of(part) => part.end - part.start,
    });
    let length = length.sum();
    let read = try_unfold((Arc::new(file), pieces), |(file, mut pieces)| async move {
        let bytes = match pieces.pop_front() {
            None => return Ok::<_, io::Error>(None),
            Some(Piece::Text(text)) => text,
            Some(Piece::Of(part)) => {
                let end = part.end.min(part.start + PIECE_BYTES);
                if end < part.end {
                    pieces.push_front(Piece::Of(end..part.end));
                }
                read(file.clone(), part.start..end).await?
            }
        };
        Ok(Some((bytes, (file, pieces))))
    });
    (Body::from_stream(read), length)
}

/// Reads a part, of at most `PIECE_BYTES` bytes, outside the threads that handle requests.
async fn read(file: Arc<File>, part: Range<u64>) -> io::Result<Bytes> {
    let reading = tokio::task::spawn_blocking(move || {
        let mut bytes = vec![0; usize::try_from(part.end - part.start).map_err(io::Error::other)?];
        file.read_exact_at(&mut bytes, part.start)?;
        Ok(bytes.into())
    });
    reading.await.map_err(io::Error::other)?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_selects_parts_of_the_file_or_is_ignored() {
        let parts = |range: &str| match Selected::of(range, 100) {
            Selected::Parts(parts) => parts.iter().map(|part| (part.start, part.end)).collect(),
            Selected::Whole => vec![(0, 100)],
            Selected::Nothing => vec![],
        };
        let whole = [(0, 100)];
        for (range, expected) in [
            ("bytes=10-19", &[(10, 20)][..]),
            ("bytes=90-", &[(90, 100)]),
            ("bytes=-5", &[(95, 100)]),
            ("bytes=-500", &whole),
            ("bytes=90-500", &[(90, 100)]),
            ("bytes=0-9,20-29", &[(0, 10), (20, 30)]),
            ("bytes=20-29, 0-9", &[(0, 10), (20, 30)]),
            ("bytes=0-9,10-19", &[(0, 20)]),
            ("bytes=0-50,10-19,40-60", &[(0, 61)]),
            ("bytes=0-9,200-", &[(0, 10)]),
            ("bytes=100-", &[]),
            ("bytes=200-300,100-", &[]),
            ("bytes=0-18446744073709551615", &whole),
            ("bytes=abc", &whole),
            ("bytes=5-1", &whole),
            ("bytes=0-9,5-1", &whole),
            ("bytes=", &whole),
            ("rows=0-9", &whole),
            ("", &whole),
        ] {
            assert_eq!(parts(range), expected, "{range}");
        }
        let many =
            |n: usize| (0..n).map(|i| format!("{0}-{0}", 2 * i)).collect::<Vec<_>>().join(",");
        assert_eq!(parts(&format!("bytes={}", many(RANGES_MAX))).len(), RANGES_MAX);
        assert_eq!(parts(&format!("bytes={}", many(RANGES_MAX + 1))), whole);
        assert_eq!(Selected::of("bytes=0-", 0), Selected::Nothing);
    }
}
