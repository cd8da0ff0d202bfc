//! The common form of a rejected value in a file, a query or a command.
//! Uses: nothing. Never: HTTP, exit codes, logging.

use std::fmt;
use std::ops::RangeInclusive;

/// A place in a text: line and column from 1, in characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Place {
    /// Line of the text, from 1.
    pub line: u32,
    /// Column of the first character.
    pub column: u32,
    /// Number of characters; the place ends with its line.
    pub length: u32,
}

/// A value outside its limits, with the information that a person needs to correct it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, serde::Serialize, serde::Deserialize)]
pub struct Problem {
    /// File or request that contains the value.
    pub file: String,
    /// Dotted key; empty if the problem concerns the file as a whole.
    pub key: String,
    /// Value that was found.
    pub value: String,
    /// Allowed values.
    pub limit: String,
    /// Place in the file, if it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<Place>,
}

impl Problem {
    /// Creates a problem with the value of one key.
    pub fn new(file: &str, key: &str, value: impl fmt::Display, limit: impl Into<String>) -> Self {
        Self {
            file: file.into(),
            key: key.into(),
            value: value.to_string(),
            limit: limit.into(),
            at: None,
        }
    }

    /// Creates a problem with a whole file: it cannot be read, or its TOML has the wrong structure.
    pub fn whole(file: &str, limit: impl Into<String>) -> Self {
        Self::new(file, "", "", limit)
    }

    /// The same problem, at a place in its file.
    pub fn at(self, at: Option<Place>) -> Self {
        Self { at, ..self }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.key.is_empty() {
            write!(f, "{}: {}", self.file, self.limit)?;
        } else {
            write!(f, "{}: {} = {}: {}", self.file, self.key, self.value, self.limit)?;
        }
        match self.at {
            Some(Place { line, .. }) => write!(f, " (line {line})"),
            None => Ok(()),
        }
    }
}

/// Problems in one line.
pub fn listed(problems: &[Problem]) -> String {
    problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("; ")
}

/// Collects the problems of a file; each check has a key and its limit as text.
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

    /// Adds a problem unless `value` is finite and within the range.
    pub fn within(&mut self, key: &str, value: f64, range: RangeInclusive<f64>) {
        let ok = value.is_finite() && range.contains(&value);
        let (min, max) = range.into_inner();
        self.require(ok, key, value, &format!("must be from {min} to {max}"));
    }

    /// Returns the problems found.
    ///
    /// # Errors
    /// The problems in the order of the checks, if there are any.
    pub fn done(self) -> Result<(), Vec<Problem>> {
        if self.found.is_empty() { Ok(()) } else { Err(self.found) }
    }
}
