//! sha256 over numbers and words, for the keys and hashes of this crate.
//! Uses: sha2. Never: anything that differs between machines (all little-endian bits).

use sha2::{Digest as _, Sha256};

/// A running digest.
pub(crate) struct Digest(Sha256);

impl Digest {
    /// Starts with a word that names the content and its version.
    pub(crate) fn new(name: &str) -> Self {
        let mut digest = Self(Sha256::new());
        digest.word(name);
        digest
    }

    /// Adds a word, with its length.
    pub(crate) fn word(&mut self, word: &str) {
        self.count(word.len());
        self.0.update(word.as_bytes());
    }

    /// Adds a count.
    pub(crate) fn count(&mut self, count: usize) {
        self.0.update((count as u64).to_le_bytes());
    }

    /// Adds numbers, with their count.
    pub(crate) fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        let mut count = 0;
        for number in numbers {
            self.0.update(number.to_le_bytes());
            count += 1;
        }
        self.count(count);
    }

    /// Adds raw bytes.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// Returns the digest.
    pub(crate) fn finish(self) -> [u8; 32] {
        self.0.finalize().into()
    }
}
