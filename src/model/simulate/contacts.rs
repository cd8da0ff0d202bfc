//! Contacts from outside: their limits, and a contacts file, one line of JSON per trial, read one at a
//! time.
//! Uses: sim-core's sensor, `problem`. Never: the model; more of the file in memory than a line.
//!
//! `{"contacts":[{"x_mm":270,"y_mm":280,"force_n":20}]}`; an empty list is an untouched skin.

use std::io::{BufRead, Read as _};

use serde::Deserialize;
use sim_core::forward::Contact;
use sim_core::sensor::Sensor;

use crate::problem::Problem;
use crate::toml_words::{Meaning, meaning};

/// Longest line, bytes: about a thousand contacts; bounds the memory for files of another kind.
const LONGEST_LINE: u64 = 65_536;
/// Largest force of a contact, N; a larger number is assumed to be an error.
pub const FORCE_MAX_N: f64 = 1000.0;

/// Contents of a line.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    contacts: Vec<WrittenContact>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenContact {
    x_mm: f64,
    y_mm: f64,
    force_n: f64,
}

/// How hard a contact presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Load {
    /// Its force, N.
    ForceN(f64),
    /// Compression of the foam under the rim of the tip, mean, mm.
    DepthMm(f64),
}

/// A contact as it is requested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RequestedContact {
    /// Position on the skin along x, mm.
    pub x_mm: f64,
    /// Position on the skin along y, mm.
    pub y_mm: f64,
    /// How hard it presses.
    pub load: Load,
}

/// Limits of contacts.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Largest number of contacts in a trial.
    pub contacts_max: usize,
    /// Range of a tip's centre, mm: `[from, to]` along x and y.
    centre_mm: [[f64; 2]; 2],
    /// Thickness of the foam, mm.
    foam_mm: f64,
}

impl Limits {
    /// Limits of a sensor: tips are wholly on the skin; at most `contacts_max` of them.
    pub fn of(sensor: &Sensor, contacts_max: usize) -> Self {
        let radius = sensor.file.tip_diameter_mm / 2.0;
        let inside = |extent: f64| [radius, extent - radius];
        let centre_mm = [inside(sensor.file.width_mm), inside(sensor.file.height_mm)];
        Self { contacts_max, centre_mm, foam_mm: sensor.file.layers.foam.thickness_mm }
    }

    /// Checks contacts; `file` names them in the problems.
    ///
    /// # Errors
    /// All values outside their limits, each with its field.
    pub fn check(&self, file: &str, contacts: &[RequestedContact]) -> Result<(), Vec<Problem>> {
        if contacts.len() > self.contacts_max {
            let limit = format!("must be at most {} contacts", self.contacts_max);
            let found = format!("{} contacts", contacts.len());
            return Err(vec![Problem::new(file, "contacts", found, limit)]);
        }
        let mut found = Vec::new();
        for (i, c) in contacts.iter().enumerate() {
            let [x, y] = self.centre_mm;
            let skin = " mm: a tip must be wholly on the skin";
            let (field, value, range, unit) = match c.load {
                Load::ForceN(force_n) => ("force_n", force_n, [0.0, FORCE_MAX_N], " N"),
                Load::DepthMm(depth_mm) => {
                    let unit = " mm, the thickness of the foam";
                    ("depth_mm", depth_mm, [0.0, self.foam_mm], unit)
                }
            };
            let checks = [("x_mm", c.x_mm, x, skin), ("y_mm", c.y_mm, y, skin)];
            let checks = checks.into_iter().chain([(field, value, range, unit)]);
            found.extend(checks.filter_map(|check| outside(file, i, check)));
        }
        if found.is_empty() { Ok(()) } else { Err(found) }
    }
}

/// The trials of a contacts file, in order.
#[derive(Debug)]
pub struct ContactLines<R> {
    input: R,
    file: String,
    limits: Limits,
    line: usize,
    bytes: Vec<u8>,
}

impl<R: BufRead> ContactLines<R> {
    /// Trials of an input; `file` is its name in problems.
    pub fn new(input: R, file: &str, limits: Limits) -> Self {
        Self { input, file: file.into(), limits, line: 0, bytes: Vec::new() }
    }

    /// Returns the contacts of the next trial, or `None` at the end of the input.
    ///
    /// # Errors
    /// A problem with file, line, field, value and limit.
    pub fn next_trial(&mut self) -> Result<Option<Vec<Contact>>, Problem> {
        self.bytes.clear();
        self.line += 1;
        let file = self.place();
        let read = (&mut self.input)
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut self.bytes)
            .map_err(|e| Problem::whole(&file, e.to_string()))?;
        if read == 0 {
            return Ok(None);
        }
        if read as u64 == LONGEST_LINE && !self.bytes.ends_with(b"\n") {
            let limit = format!("a line must be at most {LONGEST_LINE} bytes");
            return Err(Problem::whole(&file, limit));
        }
        let text =
            std::str::from_utf8(&self.bytes).map_err(|e| Problem::whole(&file, e.to_string()))?;
        parse(text.trim_end(), &file, &self.limits).map(Some)
    }

    /// The last line that was read, as problems name it.
    pub fn place(&self) -> String {
        format!("{} line {}", self.file, self.line)
    }
}

/// Parses the contacts of one line; `file` names it in problems.
///
/// # Errors
/// A problem with field, value and limit.
pub fn parse(text: &str, file: &str, limits: &Limits) -> Result<Vec<Contact>, Problem> {
    if text.trim().is_empty() {
        let limit = r#"must not be empty; an untouched skin is {"contacts":[]}"#;
        return Err(Problem::whole(file, limit));
    }
    let mut reader = serde_json::Deserializer::from_str(text);
    let line: Line = serde_path_to_error::deserialize(&mut reader)
        .map_err(|e| syntax_problem(text, file, &e.path().to_string(), e.inner()))?;
    reader.end().map_err(|e| syntax_problem(text, file, "", &e))?;
    let placed = |c: &WrittenContact| RequestedContact {
        x_mm: c.x_mm,
        y_mm: c.y_mm,
        load: Load::ForceN(c.force_n),
    };
    let placed: Vec<RequestedContact> = line.contacts.iter().map(placed).collect();
    limits.check(file, &placed).map_err(|mut found| found.swap_remove(0))?;
    let contact = |c: &WrittenContact| Contact { x_mm: c.x_mm, y_mm: c.y_mm, force_n: c.force_n };
    Ok(line.contacts.iter().map(contact).collect())
}

/// The problem of a field whose value is not within its range.
fn outside(
    file: &str,
    contact: usize,
    (field, value, [from, to], unit): (&str, f64, [f64; 2], &str),
) -> Option<Problem> {
    if (from..=to).contains(&value) {
        return None;
    }
    let key = format!("contacts[{contact}].{field}");
    Some(Problem::new(file, &key, value, format!("must be from {from} to {to}{unit}")))
}

/// Converts a parser's error, with the field and the value at which it stopped.
fn syntax_problem(text: &str, file: &str, path: &str, error: &serde_json::Error) -> Problem {
    let message = error.to_string();
    let message = message.split(" at line ").next().unwrap_or_default();
    let column = error.column();
    if error.is_eof() {
        return Problem::whole(
            file,
            format!("the line is cut off after column {column}: {message}"),
        );
    }
    let path = path.trim_matches('.');
    let bytes = text.as_bytes();
    let ends = |b: &u8| b",:{}[]\n\r".contains(b);
    let from = column.saturating_sub(1).min(bytes.len());
    let start = bytes[..from].iter().rposition(ends).map_or(0, |at| at + 1);
    let end = bytes[from..].iter().position(ends).map_or(bytes.len(), |at| from + at);
    let found = text.get(start..end).unwrap_or_default().trim();
    let found = if found.is_empty() { "{..}" } else { found };
    let limit = match meaning(message, found) {
        Meaning::Missing(key) => format!("{key} must be given"),
        // The words for TOML.
        Meaning::Limit(limit) => limit.replace("a table", "an object, in { }"),
    };
    let limit = format!("{limit} (column {column})");
    match path {
        "" | "?" => Problem::whole(file, limit),
        path => Problem::new(file, path, found, limit),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits::of(&crate::calibrate::paper::sensor(), 6)
    }

    fn complaint(text: &str) -> String {
        parse(text, "c.jsonl line 3", &limits()).unwrap_err().to_string()
    }

    const GOOD: &str = r#"{"x_mm":270,"y_mm":280,"force_n":20}"#;

    fn with(contacts: &[&str]) -> String {
        format!("{{\"contacts\":[{}]}}", contacts.join(","))
    }

    #[test]
    fn a_line_gives_its_contacts_in_order_and_an_empty_list_none() {
        let second = r#"{"force_n":0,"y_mm":10,"x_mm":530.0}"#;
        let contacts = parse(&with(&[GOOD, second]), "f", &limits()).unwrap();
        assert_eq!(contacts[0], Contact { x_mm: 270.0, y_mm: 280.0, force_n: 20.0 });
        assert_eq!(contacts[1], Contact { x_mm: 530.0, y_mm: 10.0, force_n: 0.0 });
        assert_eq!(parse("{\"contacts\":[]}\n", "f", &limits()).unwrap(), []);
    }

    #[test]
    fn values_outside_their_limits_are_named() {
        let replaced = |from: &str, to: &str| complaint(&with(&[GOOD, &GOOD.replace(from, to)]));
        let skin = "a tip must be wholly on the skin";
        for (found, words) in [
            (replaced("270", "9.5"), format!("[1].x_mm = 9.5: must be from 10 to 530 mm: {skin}")),
            (replaced("280", "551"), format!("[1].y_mm = 551: must be from 10 to 550 mm: {skin}")),
            (replaced(":20", ":-20"), "[1].force_n = -20: must be from 0 to 1000 N".into()),
            (complaint(&with(&[GOOD; 7])), " = 7 contacts: must be at most 6 contacts".into()),
        ] {
            assert_eq!(found, format!("c.jsonl line 3: contacts{words}"));
        }
    }

    #[test]
    fn broken_json_is_named_with_field_and_column() {
        let replaced = |from: &str, to: &str| complaint(&with(&[GOOD, &GOOD.replace(from, to)]));
        for (found, start) in [
            (replaced("20", "NaN"), "contacts[1].force_n = NaN: expected value"),
            (replaced("20", "null"), "contacts[1].force_n = null: must be a number (column"),
            (replaced("20", "1e999"), "contacts[1].force_n = 1e999: number out of range"),
            (
                replaced("270", "\"270\""),
                "contacts[1].x_mm = \"270\": must be a number, without quotes",
            ),
            (
                replaced("force_n", "force"),
                "contacts[1].force = \"force\": unknown key; the unit is part of the name: force_n",
            ),
            (complaint(&with(&["{}"])), "contacts[0] = {..}: x_mm must be given"),
            (
                complaint("{\"contact\":[]}"),
                "contact = \"contact\": unknown key; did you mean `contacts`?",
            ),
            (complaint(&with(&[GOOD])[..50]), "the line is cut off after column 50: EOF"),
            (complaint(&with(&[GOOD])[..20]), "the line is cut off after column 20: EOF"),
            (complaint("{\"contacts\":[]} {}"), "trailing characters (column 17)"),
            (complaint(" \n"), "must not be empty"),
        ] {
            let wanted = format!("c.jsonl line 3: {start}");
            assert!(found.starts_with(&wanted), "{found}\n{wanted}");
        }
    }

    #[test]
    fn lines_are_read_one_by_one_and_counted() {
        let text = format!("{}\n{}\n{}", with(&[]), with(&[GOOD]), &with(&[GOOD])[..30]);
        let mut lines = ContactLines::new(text.as_bytes(), "c.jsonl", limits());
        assert_eq!(lines.next_trial().unwrap().unwrap().len(), 0);
        assert_eq!(lines.next_trial().unwrap().unwrap().len(), 1);
        assert!(
            lines.next_trial().unwrap_err().to_string().starts_with("c.jsonl line 3: the line")
        );
        assert_eq!(lines.place(), "c.jsonl line 3");
        assert!(lines.next_trial().unwrap().is_none());
    }

    #[test]
    fn a_file_of_another_kind_fills_no_memory() {
        let endless = std::io::BufReader::new(std::io::repeat(b'x'));
        let mut lines = ContactLines::new(endless, "c.jsonl", limits());
        let error = lines.next_trial().unwrap_err().to_string();
        assert_eq!(error, "c.jsonl line 1: a line must be at most 65536 bytes");
    }
}
