//! sha256 of texts and bytes, as hexadecimal digits: how files, plans and secrets are identified.
//! PURE. Uses: no other module. Never: files.

use std::io::{self, Write};

use sha2::{Digest, Sha256};

/// Number of hexadecimal digits of a digest in an id, such as `ds-0123456789abcdef`.
pub const ID_DIGITS: usize = 16;

/// Returns the sha256 of `content` as 64 lowercase hexadecimal digits.
pub fn sha256_hex(content: impl AsRef<[u8]>) -> String {
    hex::encode(Sha256::digest(content))
}

/// The sha256 of content that arrives in pieces: a sink that keeps nothing else.
#[derive(Debug, Clone, Default)]
pub struct Hashing(Sha256);

impl Hashing {
    /// Adds a piece.
    pub fn update(&mut self, piece: impl AsRef<[u8]>) {
        self.0.update(piece);
    }

    /// Returns the sha256 of all pieces as 64 lowercase hexadecimal digits.
    pub fn finish(self) -> String {
        hex::encode(self.0.finalize())
    }
}

impl Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_and_its_pieces_have_the_published_sha256() {
        // FIPS 180-2, "abc".
        let known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_hex("abc"), known);
        let mut hashing = Hashing::default();
        hashing.update("a");
        hashing.write_all(b"bc").unwrap();
        assert_eq!(hashing.finish(), known);
    }
}
