//! One way to say that a file, a query or a command holds a value that cannot be used.
//! Uses: nothing. Never: HTTP, exit codes, logging.

use std::fmt;

/// A value outside its limits, named so that a person can mend it without reading code.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, serde::Serialize)]
pub struct Problem {
    /// File or request it was found in.
    pub file: String,
    /// Dotted key, or the empty string when the file as a whole is meant.
    pub key: String,
    /// The value found.
    pub value: String,
    /// What is allowed.
    pub limit: String,
}

impl Problem {
    /// A problem with the value of one key.
    pub fn new(file: &str, key: &str, value: impl fmt::Display, limit: impl Into<String>) -> Self {
        Self { file: file.into(), key: key.into(), value: value.to_string(), limit: limit.into() }
    }

    /// A problem with a file as a whole: it cannot be read, or is not TOML of the right shape.
    pub fn whole(file: &str, limit: impl Into<String>) -> Self {
        Self { file: file.into(), key: String::new(), value: String::new(), limit: limit.into() }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.key.is_empty() {
            write!(f, "{}: {}", self.file, self.limit)
        } else {
            write!(f, "{}: {} = {}: {}", self.file, self.key, self.value, self.limit)
        }
    }
}

/// Checks that collect their problems; a key is given once, a limit is stated in words.
#[derive(Debug)]
pub struct Checks<'a> {
    file: &'a str,
    found: Vec<Problem>,
}

impl<'a> Checks<'a> {
    /// Starts an empty list for one file.
    pub fn of(file: &'a str) -> Self {
        Self { file, found: Vec::new() }
    }

    /// Adds a problem unless `ok`.
    pub fn require(&mut self, ok: bool, key: &str, value: impl fmt::Display, limit: &str) {
        if !ok {
            self.found.push(Problem::new(self.file, key, value, limit));
        }
    }

    /// A finite number within `[min, max]`.
    pub fn within(&mut self, key: &str, value: f64, min: f64, max: f64) {
        let ok = value.is_finite() && (min..=max).contains(&value);
        self.require(ok, key, value, &format!("must be from {min} to {max}"));
    }

    /// The problems found, in the order of the checks.
    pub fn done(self) -> Result<(), Vec<Problem>> {
        if self.found.is_empty() { Ok(()) } else { Err(self.found) }
    }
}
