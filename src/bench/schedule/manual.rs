//! Trials of Real-Random: which weights a person places on which points (paper II-C, IV-A).
//! PURE. Uses: `chance`, sim-core's sensor. Never: persons (the campaign waits for them).

use serde::{Deserialize, Serialize};
use sim_core::sensor::Sensor;

use super::experiment::RealRandom;
use crate::chance::Chance;

/// Sets of points drawn for one trial before an error is returned. For four tips on the paper's
/// skin, 95 % of the sets have no overlap.
const SETS_TRIED: u32 = 10_000;

/// A weight to be placed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlannedContact {
    /// x of the centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of the centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Force of the weight, N.
    pub force_n: f64,
}

/// One manual trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedPlacement {
    /// Index in the plan: the configuration of the trial's key, with depth index 0.
    pub index: u32,
    /// Weights to be placed.
    pub contacts: Vec<PlannedContact>,
}

/// The skin has no room for this number of tips without overlap, within the number of draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no {contacts} points without overlapping tips in {SETS_TRIED} draws")]
pub struct TooCrowded {
    /// Number of contacts requested.
    pub contacts: u8,
}

/// Draws every trial. Points: uniform over the sets of different points in which no two tips
/// overlap. Weights: uniform and independent. Order: random over all trials, so that the number of
/// contacts is not confounded with drift; this costs no time, since all weights are lifted between
/// trials in any case.
///
/// # Errors
/// `TooCrowded` if no set of points without overlap was found.
pub fn placements(
    random: &RealRandom,
    seed: u64,
    sensor: &Sensor,
) -> Result<Vec<PlannedPlacement>, TooCrowded> {
    let mut drawn = Vec::new();
    for &contacts in &random.contacts {
        let mut chance = Chance::named(seed, &format!("real-random/{contacts}"));
        for _ in 0..random.trials_each {
            drawn.push(contacts_of_one(contacts, &random.weights_n, sensor, &mut chance)?);
        }
    }
    Chance::named(seed, "real-random/order").shuffle(&mut drawn);
    Ok((0..).zip(drawn).map(|(index, contacts)| PlannedPlacement { index, contacts }).collect())
}

fn contacts_of_one(
    contacts: u8,
    weights_n: &[f64],
    sensor: &Sensor,
    chance: &mut Chance,
) -> Result<Vec<PlannedContact>, TooCrowded> {
    let points = sensor.points();
    for _ in 0..SETS_TRIED {
        let set: Vec<[f64; 2]> = (0..contacts)
            .map(|_| {
                let p = points[chance.below(points.len() as u32) as usize];
                [p.x_mm, p.y_mm]
            })
            .collect();
        if !overlap(&set, sensor.file.tip_diameter_mm) {
            return Ok(set
                .into_iter()
                .map(|[x_mm, y_mm]| {
                    let force_n = weights_n[chance.below(weights_n.len() as u32) as usize];
                    PlannedContact { x_mm, y_mm, force_n }
                })
                .collect());
        }
    }
    Err(TooCrowded { contacts })
}

/// Whether two tips of this diameter touch or overlap.
fn overlap(centres_mm: &[[f64; 2]], diameter_mm: f64) -> bool {
    centres_mm.iter().enumerate().any(|(i, a)| {
        centres_mm[..i].iter().any(|b| {
            let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
            dx * dx + dy * dy <= diameter_mm * diameter_mm
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::tests::skin;

    fn papers_trials() -> RealRandom {
        RealRandom {
            contacts: vec![2, 3, 4],
            trials_each: 50,
            weights_n: vec![4.905, 7.358, 9.810],
        }
    }

    #[test]
    fn fifty_of_each_count_on_points_without_overlap() {
        let sensor = skin();
        let trials = placements(&papers_trials(), 5, &sensor).unwrap();
        for count in [2, 3, 4] {
            assert_eq!(trials.iter().filter(|t| t.contacts.len() == count).count(), 50);
        }
        for (i, trial) in trials.iter().enumerate() {
            assert_eq!(trial.index, i as u32);
            for (j, a) in trial.contacts.iter().enumerate() {
                assert!(sensor.point_near([a.x_mm, a.y_mm], 1e-9).is_some());
                for b in &trial.contacts[..j] {
                    assert!((a.x_mm - b.x_mm).hypot(a.y_mm - b.y_mm) > 20.0);
                }
            }
        }
    }

    #[test]
    fn counts_are_mixed_over_the_run() {
        let trials = placements(&papers_trials(), 5, &skin()).unwrap();
        for third in trials.chunks(50) {
            for count in [2, 3, 4] {
                assert!(third.iter().filter(|t| t.contacts.len() == count).count() > 5);
            }
        }
    }

    #[test]
    fn a_skin_too_small_for_the_tips_is_an_error_and_not_a_hang() {
        let mut file = skin().file;
        file.points.rows = 1;
        file.points.columns = 2;
        file.points.left_out.clear();
        file.electrodes.rows_y_mm.clear();
        file.electrodes.columns.clear();
        let sensor = Sensor::new(file).unwrap();
        assert_eq!(
            placements(&papers_trials(), 5, &sensor),
            Err(TooCrowded { contacts: 2 }),
            "two neighbouring points are nearer than a tip's diameter"
        );
    }
}
