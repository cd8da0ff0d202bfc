//! What an import understood of a file: rows, columns, and ranges of the values.
//! PURE. Uses: `store`'s imported trial. Never: a value that a trial does not have.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::store::ImportedTrial;

/// Distance from the corner of the skin within which positions may be metres, mm: all of them are within 1 m.
const METRES_WITHIN_MM: f64 = 1.0;
/// Shortest side of a skin on which positions within this distance are improbable, mm.
const METRES_SIDE_MIN_MM: f64 = 10.0;

/// Summary of the trials of a file.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Number of trials.
    pub rows: u64,
    /// Columns that are read.
    pub columns: Vec<String>,
    /// Columns that are ignored.
    pub columns_left_out: Vec<String>,
    /// Number of voltages of a frame.
    pub channels: usize,
    /// Number of raw frames of all trials.
    pub raw_frames: u64,
    /// Number of voltages without a value, of all frames.
    pub missing_voltages: u64,
    /// Smallest and largest voltage, V; absent without a value.
    pub voltages_v: Option<[f64; 2]>,
    /// Number of trials by number of contacts.
    pub contact_counts: BTreeMap<usize, u64>,
    /// Smallest and largest x of the contacts, skin coordinates, mm.
    pub x_mm: Option<[f64; 2]>,
    /// Smallest and largest y of the contacts, skin coordinates, mm.
    pub y_mm: Option<[f64; 2]>,
    /// Smallest and largest force of the contacts, N.
    pub force_n: Option<[f64; 2]>,
    /// Number of contacts without a force.
    pub contacts_without_force: u64,
    /// Number of contacts of 0 N: untouched skins that are stated as a contact.
    pub contacts_of_0_n: u64,
    /// Number of trials by the part that the file states.
    pub splits: BTreeMap<String, u64>,
    /// Number of trials by the tag that the file states.
    pub tags: BTreeMap<String, u64>,
}

fn extend(range: &mut Option<[f64; 2]>, value: f64) {
    let [least, most] = range.unwrap_or([value; 2]);
    *range = Some([least.min(value), most.max(value)]);
}

impl Summary {
    /// Whether the positions may be metres: all of them are within 1 mm of the corner of a skin with sides of this
    /// length, mm, and not all in it.
    pub fn may_be_metres(&self, sides_mm: [f64; 2]) -> bool {
        let (Some(x_mm), Some(y_mm)) = (self.x_mm, self.y_mm) else { return false };
        let largest_mm = x_mm.into_iter().chain(y_mm).map(f64::abs).fold(0.0, f64::max);
        let is_near = largest_mm > 0.0 && largest_mm < METRES_WITHIN_MM;
        is_near && sides_mm.iter().all(|side| *side >= METRES_SIDE_MIN_MM)
    }

    /// Adds a trial.
    pub fn add(&mut self, trial: &ImportedTrial) {
        self.rows += 1;
        self.channels = trial.voltages_v.len();
        self.raw_frames += trial.frames_v.len() as u64;
        for volts in &trial.voltages_v {
            match volts.is_nan() {
                true => self.missing_voltages += 1,
                false => extend(&mut self.voltages_v, f64::from(*volts)),
            }
        }
        *self.contact_counts.entry(trial.contacts.len()).or_default() += 1;
        for contact in &trial.contacts {
            contact.x_mm.into_iter().for_each(|x| extend(&mut self.x_mm, x));
            contact.y_mm.into_iter().for_each(|y| extend(&mut self.y_mm, y));
            match contact.force_n {
                Some(force) => {
                    extend(&mut self.force_n, force);
                    self.contacts_of_0_n += u64::from(force == 0.0);
                }
                None => self.contacts_without_force += 1,
            }
        }
        if let Some(part) = &trial.split {
            *self.splits.entry(part.clone()).or_default() += 1;
        }
        if let Some(tag) = &trial.tag {
            *self.tags.entry(tag.clone()).or_default() += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Contact;

    #[test]
    fn ranges_hold_what_is_known_and_nothing_else() {
        let mut summary = Summary::default();
        let mut trial = ImportedTrial { voltages_v: vec![f32::NAN, -2.0], ..Default::default() };
        summary.add(&trial);
        assert_eq!((summary.voltages_v, summary.x_mm), (Some([-2.0, -2.0]), None));
        let force = Contact { force_n: Some(4.0), ..Contact::default() };
        let place = Contact { x_mm: Some(3.0), y_mm: Some(1.0), ..Contact::default() };
        trial.contacts = vec![force, place];
        trial.voltages_v = vec![1.5, 0.0];
        trial.frames_v = vec![vec![1.0, 0.0], vec![2.0, 0.0]];
        trial.split = Some("test".into());
        trial.tag = Some("A3".into());
        summary.add(&trial);
        assert_eq!((summary.rows, summary.channels, summary.missing_voltages), (2, 2, 1));
        assert_eq!((summary.voltages_v, summary.raw_frames), (Some([-2.0, 1.5]), 2));
        assert_eq!((summary.x_mm, summary.force_n), (Some([3.0, 3.0]), Some([4.0, 4.0])));
        assert_eq!((summary.contacts_without_force, summary.contacts_of_0_n), (1, 0));
        assert_eq!(summary.contact_counts, BTreeMap::from([(0, 1), (2, 1)]));
        assert_eq!(summary.splits, BTreeMap::from([("test".to_owned(), 1)]));
        assert_eq!(summary.tags, BTreeMap::from([("A3".to_owned(), 1)]));
        trial.contacts = vec![Contact { force_n: Some(0.0), ..place }];
        summary.add(&trial);
        assert_eq!((summary.contacts_of_0_n, summary.force_n), (1, Some([0.0, 4.0])));
    }

    #[test]
    fn positions_within_1_mm_of_a_corner_may_be_metres() {
        let of = |x: [f64; 2], y: [f64; 2]| {
            let summary = Summary { x_mm: Some(x), y_mm: Some(y), ..Summary::default() };
            [[540.0, 380.0], [540.0, 5.0]].map(|sides| summary.may_be_metres(sides))
        };
        assert_eq!(of([0.02, 0.51], [0.01, 0.37]), [true, false]);
        assert_eq!(of([0.02, 1.0], [0.01, 0.37]), [false; 2]);
        assert_eq!(of([0.0, 0.0], [0.0, 0.0]), [false; 2]);
        assert!(!Summary::default().may_be_metres([540.0, 380.0]), "no position is known");
    }
}
