//! One frame's answer compared with the truth: matched contacts and their errors.
//! PURE. Uses: `store::Contact`, `infer::{answer, matching}`. Never: maps, averages over frames, a 0 for
//! an unknown.

use strum::VariantArray;

use crate::infer::answer::FoundContact;
use crate::infer::matching::{Match, closest_mm, distance_mm, matched};
use crate::store::Contact;

/// Why a contact cannot be scored.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("contact {index}: {field} is {value}; it must be finite, or absent")]
pub struct TouchError {
    /// Index of the contact among the true ones, or among the estimates.
    pub index: usize,
    /// Name of the field that is not finite.
    pub field: &'static str,
    /// Value of the field.
    pub value: f64,
}

/// A true contact and the estimate assigned to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Distance between the two, mm.
    pub distance_mm: f64,
    /// (estimated - true) / true force, %; absent if one of them is absent, or the true one is not
    /// above 0.
    pub force_percent: Option<f64>,
    /// (estimated - true) / true diameter, %; absent likewise.
    pub diameter_percent: Option<f64>,
    /// Whether the estimate's 95 % regions hold the true value; absent if it states no standard deviations.
    pub in_95: In95,
}

/// Whether the 95 % regions of an estimate hold the true values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct In95 {
    /// Ellipse of the position.
    pub place: Option<bool>,
    /// Interval of the force.
    pub force: Option<bool>,
}

impl In95 {
    fn of(truth: &Contact, found: &FoundContact) -> Self {
        let place = truth.x_mm.zip(truth.y_mm).and_then(|(x, y)| found.place_in_95(x, y));
        let force = truth.force_n.and_then(|force_n| found.force_in_95(force_n));
        Self { place: place.map(|part| part <= 1.0), force: force.map(|part| part <= 1.0) }
    }
}

/// Comparison of one frame's answer with the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Touch {
    /// Number of true contacts.
    pub contacts: u32,
    /// Number of estimated contacts.
    pub estimates: u32,
    /// Distance between the two closest true contacts, mm, rounded to 0.1 mm; absent with fewer than two, or if
    /// the position of one is unknown.
    pub spacing_mm: Option<f64>,
    /// Results that need positions; absent if the position of a contact is unknown.
    pub places: Option<Places>,
}

/// Results from the positions of a frame's contacts.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// Hungarian pairs, in the order of the true contacts: as many as the smaller number of
    /// contacts.
    pub pairs: Vec<Pair>,
    /// From each true contact to its closest estimate, mm: one per true contact, or empty without
    /// estimates.
    pub closest_mm: Vec<f64>,
    /// Whether the distance within each pair is at most that of a ghost.
    pub all_near: bool,
    /// Estimates farther than the distance of a ghost from every true contact: all, on an untouched skin.
    pub ghosts: u32,
}

/// Metric of a frame's answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, VariantArray)]
pub enum Metric {
    /// (estimated - true) / true number of contacts, %; absent on an untouched skin.
    Number,
    /// Distance within each Hungarian pair, mm; not affected by misses.
    Location,
    /// Distance from each true contact to its closest estimate, mm; increased by misses.
    Closest,
    /// Relative error of each pair's force, %.
    Force,
    /// Relative error of each pair's diameter, %.
    Diameter,
    /// 1 if the number is right (none, on an untouched skin), else 0.
    Exact,
    /// Number of ghosts.
    Ghosts,
    /// 1 for each pair whose 95 % region of the position holds the true one, else 0.
    PlaceIn95,
    /// 1 for each pair whose 95 % interval of the force holds the true one, else 0.
    ForceIn95,
}

impl Metric {
    /// All metrics, in the order of tables.
    pub const ALL: &[Self] = Self::VARIANTS;
}

impl Touch {
    /// Compares the estimates of a frame with its true contacts. `ghost_mm`: distance of a ghost, mm
    /// (`evaluate::distances`).
    ///
    /// # Errors
    /// `TouchError` with the first value that is not finite.
    pub fn of(
        truths: &[Contact],
        estimates: &[Contact],
        ghost_mm: f64,
    ) -> Result<Self, TouchError> {
        Self::compared(truths, estimates, ghost_mm, |_, _| In95::default())
    }

    /// Compares the contacts of an answer with the true ones, and its 95 % regions if it has some; `ghost_mm` as
    /// of [`Self::of`].
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn of_found(
        truths: &[Contact],
        found: &[FoundContact],
        ghost_mm: f64,
    ) -> Result<Self, TouchError> {
        let estimates: Vec<Contact> = found.iter().map(Contact::from).collect();
        Self::compared(truths, &estimates, ghost_mm, |truth, estimate| {
            In95::of(&truths[truth], &found[estimate])
        })
    }

    /// Whether the answer is right: the right number of contacts, each within the distance of a ghost of its
    /// estimate; `None` if a position is unknown.
    pub fn is_right(&self) -> Option<bool> {
        let places = self.places.as_ref()?;
        Some(self.contacts == self.estimates && places.all_near)
    }

    fn compared(
        truths: &[Contact],
        estimates: &[Contact],
        ghost_mm: f64,
        in_95: impl Fn(usize, usize) -> In95,
    ) -> Result<Self, TouchError> {
        let truth_places = places_mm(truths)?;
        let estimate_places = places_mm(estimates)?;
        let spacing_mm = truth_places.as_deref().and_then(least_mm);
        let places = truth_places.zip(estimate_places).map(|(true_mm, estimated_mm)| {
            let pair = |found: Match| {
                let (truth, estimate) = (&truths[found.truth], &estimates[found.estimate]);
                Pair {
                    distance_mm: found.distance_mm,
                    force_percent: percent(truth.force_n, estimate.force_n),
                    diameter_percent: percent(truth.diameter_mm, estimate.diameter_mm),
                    in_95: in_95(found.truth, found.estimate),
                }
            };
            let far = |closest: &Option<f64>| closest.is_none_or(|mm| mm > ghost_mm);
            let pairs: Vec<Pair> = matched(&true_mm, &estimated_mm).into_iter().map(pair).collect();
            Places {
                all_near: pairs.iter().all(|pair| pair.distance_mm <= ghost_mm),
                pairs,
                closest_mm: closest_mm(&true_mm, &estimated_mm).into_iter().flatten().collect(),
                ghosts: closest_mm(&estimated_mm, &true_mm).iter().filter(|c| far(c)).count()
                    as u32,
            }
        });
        let (contacts, estimates) = (truths.len() as u32, estimates.len() as u32);
        Ok(Self { contacts, estimates, spacing_mm, places })
    }

    /// The frame's values of a metric: one for the frame (number, exact, ghosts), one per pair, one
    /// per true contact, or none.
    pub fn values(&self, metric: Metric) -> Vec<f64> {
        let pairs = || self.places.iter().flat_map(|p| &p.pairs);
        let difference = f64::from(self.estimates) - f64::from(self.contacts);
        match metric {
            Metric::Number if self.contacts == 0 => Vec::new(),
            Metric::Number => vec![100.0 * difference / f64::from(self.contacts)],
            Metric::Location => pairs().map(|pair| pair.distance_mm).collect(),
            Metric::Closest => self.places.as_ref().map_or_else(Vec::new, |p| p.closest_mm.clone()),
            Metric::Force => pairs().filter_map(|pair| pair.force_percent).collect(),
            Metric::Diameter => pairs().filter_map(|pair| pair.diameter_percent).collect(),
            Metric::Exact => vec![f64::from(difference == 0.0)],
            Metric::Ghosts => self.places.iter().map(|p| f64::from(p.ghosts)).collect(),
            Metric::PlaceIn95 => {
                pairs().filter_map(|pair| pair.in_95.place).map(f64::from).collect()
            }
            Metric::ForceIn95 => {
                pairs().filter_map(|pair| pair.in_95.force).map(f64::from).collect()
            }
        }
    }

    /// Values with each contact as a separate sample, as in the paper's ANOVA (V-C2): a value of
    /// the frame is repeated for each of its true contacts.
    pub fn values_by_contact(&self, metric: Metric) -> Vec<f64> {
        match metric {
            Metric::Number | Metric::Exact | Metric::Ghosts => {
                let frame = self.values(metric);
                frame.iter().flat_map(|v| (0..self.contacts).map(|_| *v)).collect()
            }
            Metric::Location
            | Metric::Closest
            | Metric::Force
            | Metric::Diameter
            | Metric::PlaceIn95
            | Metric::ForceIn95 => self.values(metric),
        }
    }
}

fn percent(truth: Option<f64>, estimate: Option<f64>) -> Option<f64> {
    let truth = truth.filter(|truth| *truth > 0.0)?;
    Some(100.0 * (estimate? - truth) / truth)
}

/// The least distance between two of these positions, mm; `None` with fewer than two. Rounded to 0.1 mm: places are
/// rounded to 0.01 mm, and distances on the lattice that are equal must not be on both sides of a limit.
fn least_mm(places_mm: &[[f64; 2]]) -> Option<f64> {
    let from = |(at, place): (usize, &[f64; 2])| {
        let later = places_mm[at + 1..].iter();
        later.map(|other| distance_mm(*place, *other)).min_by(f64::total_cmp)
    };
    let least_mm = places_mm.iter().enumerate().filter_map(from).min_by(f64::total_cmp);
    least_mm.map(|mm| (10.0 * mm).round() / 10.0)
}

/// The positions of all contacts, unless one is unknown. Fails if a value is not finite.
fn places_mm(contacts: &[Contact]) -> Result<Option<Vec<[f64; 2]>>, TouchError> {
    for (index, contact) in contacts.iter().enumerate() {
        let fields = [
            ("x_mm", contact.x_mm),
            ("y_mm", contact.y_mm),
            ("force_n", contact.force_n),
            ("diameter_mm", contact.diameter_mm),
        ];
        for (field, value) in fields {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return Err(TouchError { index, field, value });
            }
        }
    }
    Ok(contacts.iter().map(|contact| Some([contact.x_mm?, contact.y_mm?])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::distances::Distances;

    /// Distance of a ghost on the paper's skin, mm.
    const PAPER_MM: f64 = Distances::PAPER.ghost_mm;

    fn touch_of(truths: &[Contact], estimates: &[Contact]) -> Result<Touch, TouchError> {
        Touch::of(truths, estimates, PAPER_MM)
    }

    fn contact(x_mm: f64, y_mm: f64, force_n: f64, diameter_mm: f64) -> Contact {
        let (x_mm, y_mm) = (Some(x_mm), Some(y_mm));
        Contact { x_mm, y_mm, force_n: Some(force_n), diameter_mm: Some(diameter_mm) }
    }

    /// Values of all metrics except those of 95 % regions, which need standard deviations.
    fn values(touch: &Touch) -> [Vec<f64>; 7] {
        assert!(touch.values(Metric::PlaceIn95).is_empty());
        assert!(touch.values(Metric::ForceIn95).is_empty());
        std::array::from_fn(|metric| touch.values(Metric::ALL[metric]))
    }

    #[test]
    fn misses_and_ghosts_are_seen_by_the_metrics_that_say_so() {
        let truths = [contact(0.0, 0.0, 10.0, 20.0), contact(100.0, 0.0, 20.0, 20.0)];
        let one = touch_of(&truths, &[contact(0.0, 5.0, 12.0, 15.0)]).unwrap();
        let far = 100.0_f64.hypot(5.0);
        let expected =
            [vec![-50.0], vec![5.0], vec![5.0, far], vec![20.0], vec![-25.0], vec![0.0], vec![0.0]];
        assert_eq!(values(&one), expected);
        let ghost = contact(300.0, 300.0, 6.0, 20.0);
        let three = touch_of(&truths, &[truths[1], ghost, truths[0]]).unwrap();
        let right = [0.0, 0.0].to_vec();
        assert_eq!(three.values(Metric::Location), right);
        assert_eq!(three.values(Metric::Force), right);
        assert_eq!(three.values(Metric::Number), [50.0]);
        assert_eq!(three.values(Metric::Ghosts), [1.0]);
        assert_eq!(three.values_by_contact(Metric::Number), [50.0, 50.0]);
        assert_eq!(three.values_by_contact(Metric::Force), right);
        // At 40 mm it is still a poor estimate; beyond, it is a ghost.
        for (x_mm, ghosts) in [(40.0, 0.0), (40.1, 1.0)] {
            let near = touch_of(&truths[..1], &[contact(x_mm, 0.0, 6.0, 20.0)]).unwrap();
            assert_eq!(near.values(Metric::Ghosts), [ghosts]);
        }
    }

    #[test]
    fn an_untouched_skin_has_no_number_error_and_every_answer_to_it_is_a_ghost() {
        let quiet = touch_of(&[], &[]).unwrap();
        let none = Vec::new;
        assert_eq!(values(&quiet), [none(), none(), none(), none(), none(), vec![1.0], vec![0.0]]);
        let invented = touch_of(&[], &[contact(0.0, 0.0, 6.0, 20.0); 2]).unwrap();
        let expected = [none(), none(), none(), none(), none(), vec![0.0], vec![2.0]];
        assert_eq!(values(&invented), expected);
        let blind = touch_of(&[contact(0.0, 0.0, 6.0, 20.0)], &[]).unwrap();
        let expected = [vec![-100.0], none(), none(), none(), none(), vec![0.0], vec![0.0]];
        assert_eq!(values(&blind), expected);
    }

    #[test]
    fn what_is_not_known_is_absent_and_what_is_no_number_is_refused() {
        let estimate = contact(3.0, 4.0, 6.0, 20.0);
        let pattern = Contact { force_n: None, diameter_mm: None, ..contact(0.0, 0.0, 0.0, 0.0) };
        let touch = touch_of(&[pattern], &[estimate]).unwrap();
        assert_eq!(touch.values(Metric::Location), [5.0]);
        assert!(
            touch.values(Metric::Force).is_empty() && touch.values(Metric::Diameter).is_empty()
        );
        let resting = touch_of(&[contact(0.0, 0.0, 0.0, 20.0)], &[estimate]).unwrap();
        assert!(resting.values(Metric::Force).is_empty(), "nothing is relative to 0 N");

        let nowhere = Contact { x_mm: None, ..estimate };
        let touch = touch_of(&[nowhere, estimate], &[estimate]).unwrap();
        assert_eq!(touch.places, None);
        assert_eq!(touch.values(Metric::Number), [-50.0]);
        assert!(touch.values(Metric::Ghosts).is_empty());

        let broken = Contact { force_n: Some(f64::NAN), ..estimate };
        let refused = touch_of(&[estimate], &[estimate, broken]).unwrap_err();
        assert_eq!((refused.index, refused.field), (1, "force_n"));
        let endless = Contact { y_mm: Some(f64::INFINITY), ..estimate };
        assert!(touch_of(&[endless], &[]).unwrap_err().to_string().contains("y_mm is inf"));
    }

    #[test]
    fn the_spacing_is_the_distance_of_the_two_closest_true_contacts() {
        let truths = [0.0, 300.0, 180.0, 250.0].map(|x_mm| contact(x_mm, 0.0, 10.0, 20.0));
        let spacing = |truths: &[Contact], estimates: &[Contact]| {
            touch_of(truths, estimates).unwrap().spacing_mm
        };
        assert_eq!(spacing(&truths, &truths[..1]), Some(50.0));
        assert_eq!(spacing(&truths[..3], &[]), Some(120.0));
        assert_eq!(spacing(&truths[..1], &truths), None);
        assert_eq!(spacing(&[], &truths), None);
        let nowhere = Contact { x_mm: None, ..truths[0] };
        assert_eq!(spacing(&[nowhere, truths[1], truths[2]], &truths), None);
        assert_eq!(spacing(&truths, &[nowhere]), Some(50.0));
        // Four rows of the lattice apart, in each direction.
        for [x_mm, y_mm] in [[0.0, 60.0], [51.96, 30.0], [51.97, 30.0]] {
            let other = contact(x_mm, y_mm, 10.0, 20.0);
            assert_eq!(spacing(&[truths[0], other], &[]), Some(60.0));
        }
    }

    #[test]
    fn regions_hold_what_is_within_their_standard_deviations() {
        let truths = [contact(0.0, 0.0, 10.0, 20.0), contact(100.0, 0.0, 20.0, 20.0)];
        let found = |x_mm: f64, y_mm: f64, force_n: f64| FoundContact {
            x_mm,
            y_mm,
            force_n: Some(force_n),
            x_sd_mm: Some(4.0),
            y_sd_mm: Some(2.0),
            force_sd_n: Some(1.0),
            ..FoundContact::default()
        };
        // 2.4 and 2.5 standard deviations along x; 1.9 and 2.1 of the force.
        let answer = [found(9.6, 0.0, 11.9), found(110.0, 0.0, 17.9)];
        let touch = Touch::of_found(&truths, &answer, PAPER_MM).unwrap();
        assert_eq!(touch.values(Metric::PlaceIn95), [1.0, 0.0]);
        assert_eq!(touch.values(Metric::ForceIn95), [1.0, 0.0]);
        assert_eq!(touch.values(Metric::Location), [9.6, 10.0]);
        let place = FoundContact { force_sd_n: None, ..answer[0] };
        let touch = Touch::of_found(&truths, &[place], PAPER_MM).unwrap();
        assert_eq!(touch.values(Metric::PlaceIn95), [1.0]);
        assert!(touch.values(Metric::ForceIn95).is_empty());
        // 1.5 along both: 4.5 of 5.99; 1.8 along both: 6.48.
        for (times, holds) in [(1.5, 1.0), (1.8, 0.0)] {
            let both = found(4.0 * times, 2.0 * times, 10.0);
            let touch = Touch::of_found(&truths[..1], &[both], PAPER_MM).unwrap();
            assert_eq!(touch.values(Metric::PlaceIn95), [holds], "{times}");
        }
    }

    #[test]
    fn an_answer_is_right_if_its_number_and_places_are() {
        let truths = [contact(0.0, 0.0, 10.0, 20.0), contact(100.0, 0.0, 20.0, 20.0)];
        let at = |x_mm: f64| contact(x_mm, 0.0, 10.0, 20.0);
        let right = |estimates: &[Contact]| touch_of(&truths, estimates).unwrap().is_right();
        assert_eq!(right(&[at(140.0), at(10.0)]), Some(true));
        assert_eq!(right(&[at(141.0), at(10.0)]), Some(false));
        assert_eq!(right(&[at(50.0)]), Some(false));
        assert_eq!(touch_of(&[], &[]).unwrap().is_right(), Some(true));
        let nowhere = Contact { x_mm: None, ..truths[0] };
        assert_eq!(touch_of(&[nowhere], &truths[..1]).unwrap().is_right(), None);
    }

    #[test]
    fn on_a_small_skin_ghosts_and_right_answers_are_judged_by_a_smaller_distance() {
        let ghost_mm = Distances::on_skin([60.0, 100.0]).ghost_mm;
        let truth = [contact(20.0, 20.0, 10.0, 5.0)];
        for (off_mm, ghosts) in [(7.1, 0.0), (7.2, 1.0)] {
            let answer = [contact(20.0 + off_mm, 20.0, 10.0, 5.0)];
            let touch = Touch::of(&truth, &answer, ghost_mm).unwrap();
            assert_eq!(touch.values(Metric::Ghosts), [ghosts], "{off_mm} mm");
            assert_eq!(touch.is_right(), Some(ghosts == 0.0), "{off_mm} mm");
            let of_paper = touch_of(&truth, &answer).unwrap();
            assert_eq!(of_paper.values(Metric::Ghosts), [0.0], "{off_mm} mm");
        }
    }
}
