//! The quantity of a row's contacts as numbers: what a net of other skins is trained on and scored by.
//! PURE. Uses: nets' quantities, the store's contacts. Never: frames, a default for what is not known.

use std::collections::BTreeSet;

pub use nets::quantity::Quantity;

use super::error::LearnError;
use crate::store::Contact;

/// Largest number of known places.
const PLACES_MAX: usize = 4096;
/// Positions that agree to this are one place, mm.
const SAME_TARGET_MM: f64 = 0.1;

/// A quantity, with the places that a pattern knows.
#[derive(Debug, Clone, PartialEq)]
pub struct Targets {
    /// What the net estimates of a whole frame.
    pub quantity: Quantity,
    /// Known places, mm, in the order of a pattern's numbers; empty for other quantities.
    pub places_mm: Vec<[f64; 2]>,
}

/// The pressed ones of the known places, and the number of contacts elsewhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pressed {
    /// For each known place whether a contact is there.
    pub places: Vec<bool>,
    /// Number of contacts at other places.
    pub elsewhere: u32,
}

impl Targets {
    /// A quantity of rows; a pattern knows the places of their contacts, in the order of y, then x.
    ///
    /// # Errors
    /// `LearnError::Problems` if a pattern has no places, or too many.
    pub fn of<'a>(
        quantity: Quantity,
        rows: impl Iterator<Item = &'a [Contact]>,
    ) -> Result<Self, LearnError> {
        if quantity != Quantity::Pattern {
            return Ok(Self { quantity, places_mm: Vec::new() });
        }
        let mut places = BTreeSet::new();
        for [x, y] in rows.flatten().filter_map(place) {
            places.insert([y, x]);
            if places.len() > PLACES_MAX {
                let limit = "has too many places of contacts for a pattern, 4096 at most: answer the \
                             position, or a force map";
                let found = format!("over {PLACES_MAX}");
                return Err(LearnError::value("dataset", "places", found, limit));
            }
        }
        if places.is_empty() {
            let limit = "must have contacts with positions: a pattern is of known places";
            return Err(LearnError::value("dataset", "places", "none", limit));
        }
        let in_mm = |[y, x]: [i64; 2]| [x, y].map(|steps| steps as f64 * SAME_TARGET_MM);
        Ok(Self { quantity, places_mm: places.into_iter().map(in_mm).collect() })
    }

    /// Length of a target.
    pub fn len(&self) -> usize {
        self.quantity.len(self.places_mm.len())
    }

    /// Whether a target has no numbers: never for targets made by [`Self::of`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The target of a row, by its contacts; `None` if it has none: a position of other than one contact,
    /// a force that is not known, a pattern with a place that is not known.
    pub fn of_row(&self, contacts: &[Contact]) -> Option<Vec<f32>> {
        match self.quantity {
            Quantity::Position => match contacts {
                [one] => Some(vec![one.x_mm? as f32, one.y_mm? as f32]),
                _ => None,
            },
            Quantity::Count => Some(vec![contacts.len() as f32]),
            Quantity::Force => {
                let forces = contacts.iter().map(|contact| contact.force_n);
                Some(vec![forces.sum::<Option<f64>>()? as f32])
            }
            Quantity::Pattern => {
                let pressed = self.pressed(contacts)?;
                let numbers = pressed.places.iter().map(|&is| f32::from(is));
                (pressed.elsewhere == 0).then(|| numbers.collect())
            }
        }
    }

    /// The pressed places of a row; `None` if a contact has no position.
    pub fn pressed(&self, contacts: &[Contact]) -> Option<Pressed> {
        let mut pressed = Pressed { places: vec![false; self.places_mm.len()], elsewhere: 0 };
        for contact in contacts {
            let at = place(contact)?;
            match self.places_mm.iter().position(|known| steps(*known) == at) {
                Some(known) => pressed.places[known] = true,
                None => pressed.elsewhere += 1,
            }
        }
        Some(pressed)
    }
}

/// Position of a contact in steps of [`SAME_TARGET_MM`]: x, y.
fn place(contact: &Contact) -> Option<[i64; 2]> {
    Some(steps([contact.x_mm?, contact.y_mm?]))
}

fn steps(place_mm: [f64; 2]) -> [i64; 2] {
    place_mm.map(|mm| (mm / SAME_TARGET_MM).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contact(x_mm: f64, y_mm: f64, force_n: Option<f64>) -> Contact {
        Contact { x_mm: Some(x_mm), y_mm: Some(y_mm), force_n, diameter_mm: None }
    }

    #[test]
    fn a_pattern_knows_the_places_of_its_rows_and_no_others() {
        let rows = [
            vec![contact(20.0, 10.0, None), contact(10.0, 10.04, None)],
            vec![contact(10.0, 30.0, None), contact(9.96, 10.0, None)],
        ];
        let targets = Targets::of(Quantity::Pattern, rows.iter().map(Vec::as_slice)).unwrap();
        assert_eq!(targets.places_mm, [[10.0, 10.0], [20.0, 10.0], [10.0, 30.0]]);
        assert_eq!(targets.of_row(&rows[0]).unwrap(), [1.0, 1.0, 0.0]);
        assert_eq!(targets.of_row(&[]).unwrap(), [0.0; 3]);
        let unknown = [contact(20.0, 10.0, None), contact(50.0, 50.0, None)];
        assert_eq!(targets.of_row(&unknown), None);
        let pressed = targets.pressed(&unknown).unwrap();
        assert_eq!((pressed.places, pressed.elsewhere), (vec![false, true, false], 1));
        let empty = Targets::of(Quantity::Pattern, std::iter::once(&[][..]));
        assert!(empty.unwrap_err().to_string().contains("known places"));
    }

    #[test]
    fn a_row_without_the_quantity_has_no_target() {
        let of = |quantity| Targets { quantity, places_mm: Vec::new() };
        let [one, other] = [contact(3.0, 4.0, Some(5.0)), contact(7.0, 8.0, Some(2.5))];
        assert_eq!(of(Quantity::Position).of_row(&[one]).unwrap(), [3.0, 4.0]);
        assert_eq!(of(Quantity::Position).of_row(&[one, other]), None);
        assert_eq!(of(Quantity::Position).of_row(&[]), None);
        assert_eq!(of(Quantity::Count).of_row(&[one, other]).unwrap(), [2.0]);
        assert_eq!(of(Quantity::Force).of_row(&[one, other]).unwrap(), [7.5]);
        assert_eq!(of(Quantity::Force).of_row(&[]).unwrap(), [0.0]);
        assert_eq!(of(Quantity::Force).of_row(&[one, contact(1.0, 1.0, None)]), None);
    }
}
