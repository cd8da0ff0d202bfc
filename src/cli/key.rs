//! The API key of the commands: of the environment, or of a file that it names.
//! Uses: the environment, the file system. Never: a key in a message.

use std::path::Path;

use super::error::{CliError, CliResult};
use crate::api::warn_if_others_may_read;

/// Environment variable with the API key.
pub const KEY_VARIABLE: &str = "PALPATE_KEY";
/// Environment variable with the path of a file with the API key, if the other one is not set.
const KEY_FILE_VARIABLE: &str = "PALPATE_KEY_FILE";

/// Returns the key of the environment, or of the file that it names.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or has no key.
pub fn key() -> CliResult<Option<String>> {
    let of = |variable| std::env::var_os(variable).filter(|value| !value.is_empty());
    if let Some(key) = of(KEY_VARIABLE) {
        return Ok(key.into_string().ok());
    }
    of(KEY_FILE_VARIABLE).map(|path| key_of(Path::new(&path))).transpose()
}

/// The key in a file: its first line.
///
/// # Errors
/// `CliError::Problems` if the file cannot be read or has no key.
pub fn key_of(path: &Path) -> CliResult<String> {
    let text = std::fs::read_to_string(path).map_err(CliError::input(path))?;
    warn_if_others_may_read(path);
    match text.lines().next().map(str::trim) {
        Some(key) if !key.is_empty() => Ok(key.into()),
        _ => Err(CliError::in_file(path, "must have the key in its first line")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_the_first_line_of_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        for (text, key) in [("palpate_0\n", Some("palpate_0")), ("k", Some("k")), ("\nk", None)] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(key_of(&path).ok().as_deref(), key, "{text:?}");
        }
    }
}
