//! sha256 of texts and bytes, as hexadecimal digits: how files, plans and secrets are identified.
//! PURE. Uses: no other module. Never: files.

use sha2::{Digest, Sha256};

/// Returns the sha256 of `content` as 64 lowercase hexadecimal digits.
pub fn sha256_hex(content: impl AsRef<[u8]>) -> String {
    hex::encode(Sha256::digest(content))
}
