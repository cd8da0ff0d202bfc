//! The verdict on a placement: the estimated contacts, compared with the requested ones.
//! PURE. Uses: `infer::{answer, matching}`, sim-core's sensor. Never: a wait, the rig.
//!
//! The thresholds follow from the published accuracy of the serving method on placed weights
//! (`docs/figures.md`: `exact`, mean of 30 frames).

use serde::{Deserialize, Serialize};
use sim_core::sensor::{Point, Sensor};
use utoipa::ToSchema;

use crate::campaign::shown::placement::VerdictKind;
use crate::infer::answer::{FoundContact, Reading};
use crate::infer::matching::{Match, distance_mm, matched};
use crate::record::PlacedContact;

/// Largest distance of a felt contact from the point that was asked, mm. The mean distance is 9 mm, the
/// tip has a diameter of 20 mm, and no two weights are closer than that: a weight that is felt farther
/// away is on another point.
pub const NEAR_MM: f64 = 25.0;
/// Largest relative deviation of a felt force from the weight. The mean deviation is 5 %, its spread is
/// several times that; between neighbouring weights of the paper (4.905, 7.358, 9.810 N) the ratio is 1.5
/// and 1.33, so that the two lighter ones are distinguished, and the two heavier ones are not.
pub const FORCE_TOLERANCE: f64 = 0.35;
/// Force of an additional contact, as a share of the lightest weight, below which it is no object on
/// the skin: the method invents light contacts where its model differs from the skin.
pub const ADDED_SHARE: f64 = 0.5;
/// Distance between two weights below which they may be felt as one contact, and between two contacts as which one
/// weight may be felt, mm: twice `NEAR_MM`. The
/// number of contacts is wrong in 16 % of the trials, nearly always because two are felt as one.
pub const MERGED_MM: f64 = 2.0 * NEAR_MM;
/// A deviation counts as certain beyond this multiple of the standard deviation that the method states.
const CERTAIN_SD: f64 = 3.0;

/// A weight that a person is asked to place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AskedContact {
    /// Number of the weight in this trial, from 1.
    pub number: u32,
    /// x of the point, skin coordinates, mm.
    pub x_mm: f64,
    /// y of the point, skin coordinates, mm.
    pub y_mm: f64,
    /// Force of the weight, N.
    pub force_n: f64,
    /// Name of the point on the printed overlay, such as `R7 C12`.
    pub point: String,
}

impl AskedContact {
    /// The weights of a placement, numbered, with the names of their points.
    pub fn all(contacts: &[PlacedContact], sensor: Option<&Sensor>) -> Vec<Self> {
        let asked = |(number, c): (u32, &PlacedContact)| Self {
            number,
            x_mm: c.x_mm,
            y_mm: c.y_mm,
            force_n: c.force_n,
            point: point(sensor, [c.x_mm, c.y_mm]),
        };
        (1..).zip(contacts).map(asked).collect()
    }

    fn at_mm(&self) -> [f64; 2] {
        [self.x_mm, self.y_mm]
    }
}

/// Verdict on a placement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Verdict {
    /// Whether estimated and requested contacts agree.
    pub kind: VerdictKind,
    /// Its reasons, one sentence each.
    pub words: Vec<String>,
    /// The felt contact of each weight.
    pub matches: Vec<MatchedContact>,
}

/// A weight and the contact that is felt for it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MatchedContact {
    /// Number of the weight, from 1.
    pub asked: u32,
    /// Index of the felt contact, from 0; null if none is felt for it.
    pub felt: Option<u32>,
    /// Distance of the felt contact from the point, mm; null without one.
    pub distance_mm: Option<f64>,
    /// Felt force, N; null without one, or if the method estimates no forces.
    pub force_n: Option<f64>,
}

impl Verdict {
    /// A verdict without a comparison.
    pub fn without(kind: VerdictKind, why: impl Into<String>) -> Self {
        Self { kind, words: vec![why.into()], matches: Vec::new() }
    }
}

/// A deviation: whether it is certain, and a sentence.
type Finding = (bool, String);

/// Compares the estimated contacts with the requested ones. A verdict is `unsure` if the skin is not at rest or
/// the method does not explain the frame.
pub fn judge(
    asked: &[AskedContact],
    reading: &Reading,
    at_rest: bool,
    sensor: Option<&Sensor>,
) -> Verdict {
    let felt = &reading.contacts;
    let asked_mm: Vec<[f64; 2]> = asked.iter().map(AskedContact::at_mm).collect();
    let felt_mm: Vec<[f64; 2]> = felt.iter().map(|c| [c.x_mm, c.y_mm]).collect();
    let pairs = matched(&asked_mm, &felt_mm);
    let case = Case { asked, felt, pairs: &pairs, sensor };
    let findings = case.findings();
    let mut doubts: Vec<String> = reading.outside.clone();
    if !at_rest {
        doubts.insert(0, "the skin is not at rest".into());
    }
    let certain = findings.iter().any(|(certain, _)| *certain);
    let kind = match (findings.is_empty(), doubts.is_empty()) {
        (true, true) => VerdictKind::Right,
        (false, true) if certain => VerdictKind::Wrong,
        _ => VerdictKind::Unsure,
    };
    let mut words = doubts;
    words.extend(findings.into_iter().map(|(_, words)| words));
    if kind == VerdictKind::Right {
        words.push(match asked.len() {
            1 => "the weight is felt where it was asked".into(),
            n => format!("all {n} weights are felt where they were asked"),
        });
    }
    Verdict { kind, words, matches: case.matches() }
}

struct Case<'a> {
    asked: &'a [AskedContact],
    felt: &'a [FoundContact],
    pairs: &'a [Match],
    sensor: Option<&'a Sensor>,
}

impl Case<'_> {
    fn pair_of(&self, asked: usize) -> Option<&Match> {
        self.pairs.iter().find(|pair| pair.truth == asked)
    }

    fn matches(&self) -> Vec<MatchedContact> {
        let one = |(index, asked): (usize, &AskedContact)| {
            let pair = self.pair_of(index);
            MatchedContact {
                asked: asked.number,
                felt: pair.map(|pair| pair.estimate as u32),
                distance_mm: pair.map(|pair| pair.distance_mm),
                force_n: pair.and_then(|pair| self.felt[pair.estimate].force_n),
            }
        };
        self.asked.iter().enumerate().map(one).collect()
    }

    fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut shared: Vec<Option<usize>> = vec![None; self.asked.len()];
        let missing: Vec<usize> =
            (0..self.asked.len()).filter(|index| self.pair_of(*index).is_none()).collect();
        for &index in &missing {
            match self.felt_as_one(index) {
                Some(partner) if shared[partner].is_none() => {
                    shared[partner] = Some(index);
                    let (a, b) = (&self.asked[partner], &self.asked[index]);
                    let (low, high) = (a.number.min(b.number), a.number.max(b.number));
                    let words =
                        format!("weights {low} and {high} are close and are felt as one contact");
                    findings.push((false, words));
                }
                _ => {
                    let weight = self.weight(index);
                    findings.push((true, format!("{weight} and is not felt")));
                }
            }
        }
        let parts: Vec<Option<usize>> =
            self.pairs.iter().map(|pair| self.other_part(pair)).collect();
        for (pair, part) in self.pairs.iter().zip(&parts) {
            if shared[pair.truth].is_none() && part.is_none() {
                findings.extend(self.misplaced(pair));
                findings.extend(self.other_force(pair));
            }
        }
        findings.extend(self.added(&parts));
        findings
    }

    /// The second contact as which a weight is felt: both are close, and together have its place and force.
    fn other_part(&self, pair: &Match) -> Option<usize> {
        let (asked, one) = (&self.asked[pair.truth], &self.felt[pair.estimate]);
        (0..self.felt.len()).filter(|index| !self.is_paired(*index)).find(|&index| {
            let other = &self.felt[index];
            let Some((one_n, other_n)) = one.force_n.zip(other.force_n) else { return false };
            let both_n = one_n + other_n;
            let mean = |a: f64, b: f64| (a * one_n + b * other_n) / both_n;
            let middle_mm = [mean(one.x_mm, other.x_mm), mean(one.y_mm, other.y_mm)];
            distance_mm([one.x_mm, one.y_mm], [other.x_mm, other.y_mm]) <= MERGED_MM
                && distance_mm(asked.at_mm(), middle_mm) <= NEAR_MM
                && (both_n / asked.force_n - 1.0).abs() <= FORCE_TOLERANCE
        })
    }

    fn is_paired(&self, felt: usize) -> bool {
        self.pairs.iter().any(|pair| pair.estimate == felt)
    }

    /// The weight with which a missing one is felt as one contact: close to it, and with the force of
    /// both.
    fn felt_as_one(&self, missing: usize) -> Option<usize> {
        let one = &self.asked[missing];
        self.pairs.iter().map(|pair| (pair.truth, &self.felt[pair.estimate])).find_map(
            |(index, felt)| {
                let other = &self.asked[index];
                let is_close = distance_mm(one.at_mm(), other.at_mm()) <= MERGED_MM;
                let between = [one.at_mm(), other.at_mm()];
                let is_there =
                    between.iter().all(|at| distance_mm(*at, [felt.x_mm, felt.y_mm]) <= MERGED_MM);
                let both_n = one.force_n + other.force_n;
                let is_both =
                    felt.force_n.is_none_or(|f| (f / both_n - 1.0).abs() <= FORCE_TOLERANCE);
                (is_close && is_there && is_both).then_some(index)
            },
        )
    }

    fn misplaced(&self, pair: &Match) -> Option<Finding> {
        let felt = &self.felt[pair.estimate];
        if pair.distance_mm <= NEAR_MM {
            return None;
        }
        let sd_mm = felt.x_sd_mm.zip(felt.y_sd_mm).map_or(0.0, |(x, y)| x.hypot(y));
        let asked = &self.asked[pair.truth];
        let way = direction(felt.x_mm - asked.x_mm, felt.y_mm - asked.y_mm);
        let near = point(self.sensor, [felt.x_mm, felt.y_mm]);
        let words = format!(
            "{} and is felt {:.0} mm {way}, near {near}",
            self.weight(pair.truth),
            pair.distance_mm
        );
        Some((pair.distance_mm > CERTAIN_SD * sd_mm, words))
    }

    fn other_force(&self, pair: &Match) -> Option<Finding> {
        let (asked, felt) = (&self.asked[pair.truth], &self.felt[pair.estimate]);
        let force_n = felt.force_n?;
        let off_n = (force_n - asked.force_n).abs();
        if pair.distance_mm > NEAR_MM || off_n <= FORCE_TOLERANCE * asked.force_n {
            return None;
        }
        let weight = self.weight(pair.truth);
        let words = format!("{weight} and {force_n:.1} N are felt there");
        Some((off_n > CERTAIN_SD * felt.force_sd_n.unwrap_or(0.0), words))
    }

    /// Contacts where no weight was asked, except for `parts` of a weight.
    fn added(&self, parts: &[Option<usize>]) -> Vec<Finding> {
        let lightest_n = self.asked.iter().map(|c| c.force_n).fold(f64::INFINITY, f64::min);
        (0..self.felt.len())
            .filter(|index| !self.is_paired(*index) && !parts.contains(&Some(*index)))
            .map(|index| &self.felt[index])
            .filter(|felt| felt.force_n.is_none_or(|f| f >= ADDED_SHARE * lightest_n))
            .map(|felt| {
                let at_mm = [felt.x_mm, felt.y_mm];
                let near = point(self.sensor, at_mm);
                let force = felt.force_n.map_or(String::new(), |f| format!(" of {f:.1} N"));
                let by = self.asked.iter().find(|c| distance_mm(c.at_mm(), at_mm) <= NEAR_MM);
                match by {
                    Some(weight) => {
                        let number = weight.number;
                        (false, format!("weight {number} is felt as two contacts, one near {near}"))
                    }
                    None => {
                        let words = format!(
                            "a contact{force} is felt near {near}, where no weight was asked"
                        );
                        // Without a force, a net's candidate may be nothing.
                        (felt.force_n.is_some(), words)
                    }
                }
            })
            .collect()
    }

    /// Beginning of a sentence: "weight 2 (7.4 N) was asked at R7 C12".
    fn weight(&self, index: usize) -> String {
        let AskedContact { number, force_n, point, .. } = &self.asked[index];
        format!("weight {number} ({force_n:.1} N) was asked at {point}")
    }
}

/// Name of the point nearest to a position; the position itself if the sensor is unknown.
fn point(sensor: Option<&Sensor>, at_mm: [f64; 2]) -> String {
    match sensor.and_then(|sensor| sensor.nearest_point(at_mm)) {
        Some(point) => Point::label(point),
        None => format!("({:.0}, {:.0}) mm", at_mm[0], at_mm[1]),
    }
}

/// Direction on the skin as seen from above, x to the right and y upward.
pub(super) fn direction(x_mm: f64, y_mm: f64) -> &'static str {
    const WAYS: [&str; 8] = [
        "to the right",
        "up and to the right",
        "up",
        "up and to the left",
        "to the left",
        "down and to the left",
        "down",
        "down and to the right",
    ];
    let eighth = (y_mm.atan2(x_mm) / std::f64::consts::FRAC_PI_4).round() as i64;
    WAYS[eighth.rem_euclid(8) as usize]
}
