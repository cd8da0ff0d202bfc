//! Measured frames of single contacts, and the difference of the model's voltages from them.
//! PURE. Uses: sim-core's forward model. Never: fitting (the voltages are for validation only).
//!
//! JSON lines: `{"contacts":[{"x_mm":..,"y_mm":..,"force_n":..}],"voltages_v":[..]}`, with any
//! further keys. `GET /api/v1/trials?voltages=true` returns this form as `application/x-ndjson`;
//! two lines of pandas write it. Lines with no contact or several are skipped and counted.

use serde::Deserialize;
use sim_core::calibration::Accuracy;
use sim_core::forward::{Contact, ForwardModel, Workspace};

use super::{CalibrateError, accuracy};
use crate::problem::Problem;

/// A measured frame of one contact.
#[derive(Debug, Clone, PartialEq)]
pub struct SingleContact {
    /// Line in the file, from 1.
    pub line: usize,
    /// The single contact of the line.
    pub contact: Contact,
    /// The frame, V after gain, injection-major.
    pub voltages_v: Vec<f64>,
}

/// The frames of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frames {
    /// Frames with exactly one contact.
    pub single: Vec<SingleContact>,
    /// Number of frames with no contact or several.
    pub left_out: usize,
}

#[derive(Deserialize)]
struct Line {
    contacts: Vec<LineContact>,
    voltages_v: Option<Vec<f64>>,
}

#[derive(Deserialize)]
struct LineContact {
    x_mm: f64,
    y_mm: f64,
    force_n: f64,
}

/// Reads frames of `channels` voltages.
///
/// # Errors
/// `CalibrateError::Measurements` if a line is invalid, or none has exactly one contact.
pub fn read(file: &str, text: &str, channels: usize) -> Result<Frames, CalibrateError> {
    let (mut frames, mut problems) = (Frames::default(), Vec::new());
    for (n, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        match read_line(file, n + 1, line, channels) {
            Ok(Some(frame)) => frames.single.push(frame),
            Ok(None) => frames.left_out += 1,
            Err(problem) => problems.push(problem),
        }
    }
    if !problems.is_empty() {
        return Err(CalibrateError::Measurements(problems));
    }
    if frames.single.is_empty() {
        let words = "no line with exactly one contact: voltages of single contacts are compared";
        return Err(CalibrateError::undetermined(file, words));
    }
    Ok(frames)
}

/// The frame of a line; `None` unless it has exactly one contact.
fn read_line(
    file: &str,
    line: usize,
    text: &str,
    channels: usize,
) -> Result<Option<SingleContact>, Problem> {
    let problem = |key: &str, value: String, limit: String| {
        Problem::new(file, &format!("line {line}, {key}"), value, limit)
    };
    let parsed: Line = serde_json::from_str(text)
        .map_err(|e| problem("JSON", "not a trial".into(), e.to_string()))?;
    let [LineContact { x_mm, y_mm, force_n }] = parsed.contacts[..] else { return Ok(None) };
    if force_n < 0.0 {
        return Err(problem("force_n", force_n.to_string(), "must be a number >= 0".into()));
    }
    let voltages_v = parsed.voltages_v.unwrap_or_default();
    if voltages_v.len() != channels {
        let limit =
            format!("this sensor has {channels} voltages (request trials with voltages=true)");
        return Err(problem("voltages_v", format!("{} numbers", voltages_v.len()), limit));
    }
    Ok(Some(SingleContact { line, contact: Contact { x_mm, y_mm, force_n }, voltages_v }))
}

/// Compares voltages of the model with the measured ones, over all values of all frames.
///
/// # Errors
/// `CalibrateError::Measurements` if the model rejects a contact, or all voltages are equal.
pub fn voltage_accuracy(
    file: &str,
    frames: &Frames,
    model: &ForwardModel,
) -> Result<Accuracy, CalibrateError> {
    let mut work = Workspace::default();
    let (mut measured, mut modelled) = (Vec::new(), Vec::new());
    for frame in &frames.single {
        let simulated = model.voltages(&[frame.contact], &mut work).map_err(|error| {
            let Contact { x_mm, y_mm, force_n } = frame.contact;
            let (key, value) = (
                format!("line {}, contacts", frame.line),
                format!("{force_n} N at ({x_mm}, {y_mm}) mm"),
            );
            let problem = Problem::new(file, &key, value, error.to_string());
            CalibrateError::Measurements(vec![problem])
        })?;
        measured.extend_from_slice(&frame.voltages_v);
        modelled.extend_from_slice(simulated);
    }
    accuracy(&measured, &modelled)
        .ok_or_else(|| CalibrateError::undetermined(file, "all voltages are the same"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_contacts_are_kept_and_others_counted() {
        let text = r#"{"contacts":[{"x_mm":1,"y_mm":2,"force_n":3,"diameter_mm":20}],"voltages_v":[0.1,0.2],"run":"a"}

{"contacts":[],"voltages_v":[0,0]}
{"contacts":[{"x_mm":1,"y_mm":2,"force_n":3},{"x_mm":1,"y_mm":2,"force_n":3}]}
"#;
        let frames = read("f.jsonl", text, 2).unwrap();
        assert_eq!((frames.single.len(), frames.left_out), (1, 2));
        assert_eq!(frames.single[0].contact.force_n, 3.0);
        assert_eq!(frames.single[0].voltages_v, [0.1, 0.2]);
    }

    #[test]
    fn wrong_lines_are_named_with_field_and_limit() {
        let text = "{\"contacts\":[{\"x_mm\":1,\"y_mm\":2,\"force_n\":-3}],\"voltages_v\":[0,0]}\n\
                    {\"contacts\":[{\"x_mm\":1,\"y_mm\":2,\"force_n\":3}],\"voltages_v\":[0]}\n\
                    {\"contacts\":[{\"x_mm\":1,\"y_mm\":2}],\"voltages_v\":[0,0]}\n";
        let error = read("f.jsonl", text, 2).unwrap_err().to_string();
        let lines: Vec<&str> = error.lines().collect();
        assert_eq!(lines[0], "f.jsonl: line 1, force_n = -3: must be a number >= 0");
        assert!(lines[1].starts_with("f.jsonl: line 2, voltages_v = 1 numbers: this sensor has 2"));
        assert!(lines[2].contains("line 3") && lines[2].contains("force_n"), "{error}");
        let none = read("f.jsonl", "\n", 2).unwrap_err().to_string();
        assert!(none.contains("no line with exactly one contact"), "{none}");
    }
}
