//! The twin of a trial: the frame of its contacts, the same from every process; and these contacts as text.
//! Uses: sim-core. Never: a measured frame, a store.
//!
//! The service makes twins of stored trials with [`twin_frame`]; `chunks` makes them on any machine, from the text of
//! [`TwinInput::lines`], as a `file`.

use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};

use crate::ids::TrialId;

pub mod file;
pub mod chunks;

/// Stands for contacts of which a position or a force is unknown.
const UNKNOWN_CONTACTS: &str = "?";

/// Why a trial has no simulated frame.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum TwinFailure {
    #[error("a contact has no position or no force")]
    Unknown,
    #[error(transparent)]
    Contact(#[from] ContactError),
}

/// Simulates the frame of a trial, V, injection-major; `None`: its contacts are unknown.
///
/// # Errors
/// `TwinFailure` if contacts are unknown, or the model rejects one.
pub fn twin_frame(
    model: &ForwardModel,
    contacts: Option<&[Contact]>,
    work: &mut Workspace,
) -> Result<Vec<f32>, TwinFailure> {
    let contacts = contacts.ok_or(TwinFailure::Unknown)?;
    let frame_v = model.voltages(contacts, work)?;
    Ok(frame_v.iter().map(|v| *v as f32).collect())
}

/// What the twin of a trial is computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinInput {
    /// Id of the trial.
    pub trial: TrialId,
    /// Its contacts; `None` if the position or the force of one is unknown.
    pub contacts: Option<Vec<Contact>>,
}

impl TwinInput {
    /// Inputs as text, a line each: id of the trial, then after a space `x,y,force` of each contact (mm, N), or `?`
    /// for unknown ones. The numbers are read as they were written, to the last bit.
    pub fn lines(inputs: impl IntoIterator<Item = Self>) -> String {
        let mut text = String::new();
        for Self { trial, contacts } in inputs {
            text += &trial.0.to_string();
            match contacts {
                Some(contacts) => {
                    for Contact { x_mm, y_mm, force_n } in contacts {
                        text += &format!(" {x_mm},{y_mm},{force_n}");
                    }
                }
                None => text += &format!(" {UNKNOWN_CONTACTS}"),
            }
            text.push('\n');
        }
        text
    }

    /// Reads the lines of [`Self::lines`].
    ///
    /// # Errors
    /// The number of the first line that has another form, as text.
    pub fn read(text: &str) -> Result<Vec<Self>, String> {
        let invalid = |at: usize| {
            format!("line {}: must be the id of a trial, and x,y,force of each contact", at + 1)
        };
        let line = |(at, line)| Self::of_line(line).ok_or_else(|| invalid(at));
        text.lines().enumerate().map(line).collect()
    }

    fn of_line(line: &str) -> Option<Self> {
        let mut words = line.split(' ');
        let trial = TrialId(words.next()?.parse().ok()?);
        let contacts: Vec<&str> = words.collect();
        if contacts == [UNKNOWN_CONTACTS] {
            return Some(Self { trial, contacts: None });
        }
        let contacts: Option<Vec<Contact>> = contacts.into_iter().map(contact).collect();
        Some(Self { trial, contacts: Some(contacts?) })
    }
}

/// A contact from `x,y,force`.
fn contact(word: &str) -> Option<Contact> {
    let mut numbers = word.split(',').map(|number| number.parse::<f64>().ok());
    let [x_mm, y_mm, force_n] = [numbers.next()??, numbers.next()??, numbers.next()??];
    numbers.next().is_none().then_some(Contact { x_mm, y_mm, force_n })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_read_to_the_last_bit() {
        let contact = |x_mm, y_mm, force_n| Contact { x_mm, y_mm, force_n };
        let inputs = vec![
            TwinInput {
                trial: TrialId(7),
                contacts: Some(vec![
                    contact(0.1 + 0.2, 1.0 / 3.0, 5e-324),
                    contact(270.0, -0.0, f64::MAX),
                ]),
            },
            TwinInput { trial: TrialId(9), contacts: Some(Vec::new()) },
            TwinInput { trial: TrialId(12), contacts: None },
        ];
        let text = TwinInput::lines(inputs.clone());
        assert!(text.starts_with("7 0.30000000000000004,0.3333333333333333,0"), "{text}");
        assert!(text.ends_with("\n9\n12 ?\n"), "{text}");
        let read = TwinInput::read(&text).unwrap();
        assert_eq!(read, inputs);
        let y_mm = read[0].contacts.as_ref().unwrap()[1].y_mm;
        assert!(y_mm.is_sign_negative(), "{y_mm}");
    }

    #[test]
    fn a_line_of_another_form_is_refused_by_its_number() {
        for line in ["", "x", "1 2", "1 2,3", "1 2,3,4,5", "1 2,3,x", "1 ? 2,3,4", "1  2,3,4"] {
            let error = TwinInput::read(&format!("1 2,3,4\n{line}\n")).unwrap_err();
            assert!(error.starts_with("line 2: "), "{line}: {error}");
        }
    }
}
