//! The places of a plan in the order of driving, as pictures show them.
//! PURE. Uses: `plan`. Never: what is measured there.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::configuration::Stand;
use super::manual::PlannedPlacement;
use super::plan::{Plan, Step};

/// Configurations or manual placements of a plan in the order of driving, one entry of each list per
/// configuration. The position in these lists is the index in the tour.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Visits {
    /// Index of the configuration, as in the keys of its trials.
    pub configuration: Vec<u32>,
    /// Number of attached tips or weights.
    pub tips: Vec<u8>,
    /// Places of the tips or weights, skin coordinates, mm, rounded to 0.01 mm.
    pub contacts_mm: Vec<Vec<[f64; 2]>>,
}

/// Place of a configuration or manual placement in the tour of its run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StepOfTour {
    /// Index in the tour, from 0.
    pub index: usize,
    /// Number of configurations or placements of the tour.
    pub of: usize,
}

impl StepOfTour {
    /// Returns the place of a configuration; none if the plan lacks it.
    pub fn of(plan: &Plan, configuration: u32) -> Option<Self> {
        let visited = |step: &Step| match step {
            Step::Configuration(c) => Some(c.index),
            Step::Manual(placement) => Some(placement.index),
            Step::TipChange { .. } | Step::TouchOff { .. } | Step::Reference(_) => None,
        };
        let all = plan.steps.iter().filter_map(visited);
        let index = all.clone().position(|visited| visited == configuration)?;
        Some(Self { index, of: all.count() })
    }
}

/// The part of a stored plan that is read: plans of other versions may differ in the rest.
#[derive(Debug, Deserialize)]
struct KeptPlan {
    depths_mm: Vec<f64>,
    steps: Vec<Step>,
}

impl Visits {
    /// Returns the places of a plan.
    pub fn of(plan: &Plan) -> Self {
        Self::of_steps(&plan.steps)
    }

    /// Returns depths, mm, and places of a plan as it is stored with its run.
    ///
    /// # Errors
    /// The text is not that of a plan.
    pub fn of_text(plan: &str) -> Result<(Vec<f64>, Self), serde_json::Error> {
        let KeptPlan { depths_mm, steps } = serde_json::from_str(plan)?;
        Ok((depths_mm, Self::of_steps(&steps)))
    }

    fn of_steps(steps: &[Step]) -> Self {
        let mut visits = Self::default();
        for step in steps {
            match step {
                Step::Configuration(c) => {
                    let Stand { tips_mm, .. } = &c.stand;
                    visits.push(c.index, tips_mm.iter().copied());
                }
                Step::Manual(PlannedPlacement { index, contacts }) => {
                    visits.push(*index, contacts.iter().map(|c| [c.x_mm, c.y_mm]));
                }
                Step::TipChange { .. } | Step::TouchOff { .. } | Step::Reference(_) => {}
            }
        }
        visits
    }

    fn push(&mut self, configuration: u32, contacts_mm: impl Iterator<Item = [f64; 2]>) {
        let contacts: Vec<[f64; 2]> = contacts_mm.map(|at| at.map(hundredths)).collect();
        self.configuration.push(configuration);
        self.tips.push(contacts.len() as u8);
        self.contacts_mm.push(contacts);
    }
}

/// Rounds to 0.01.
fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::tests::{hex, planned};

    #[test]
    fn a_tour_has_every_configuration_once_in_the_order_of_its_steps() {
        let plan = planned(&hex(3, "tips = [2, 3]\nconfigurations = 7\n"));
        let (depths_mm, visits) = Visits::of_text(&plan.text()).unwrap();
        assert_eq!((&depths_mm, &visits), (&plan.depths_mm, &Visits::of(&plan)));
        let planned: Vec<u32> = plan.configurations().map(|c| c.index).collect();
        assert_eq!(visits.configuration, planned);
        for (n, c) in plan.configurations().enumerate() {
            assert_eq!(usize::from(visits.tips[n]), c.stand.tips_mm.len());
            for (shown, tip) in visits.contacts_mm[n].iter().zip(&c.stand.tips_mm) {
                assert!((shown[0] - tip[0]).abs() <= 0.005 + 1e-9, "{shown:?} {tip:?}");
                assert!((shown[1] - tip[1]).abs() <= 0.005 + 1e-9, "{shown:?} {tip:?}");
            }
        }
        for (index, configuration) in planned.iter().enumerate() {
            let place = StepOfTour::of(&plan, *configuration);
            assert_eq!(place, Some(StepOfTour { index, of: 14 }));
        }
        assert_eq!(StepOfTour::of(&plan, 14), None);
        assert!(Visits::of_text("{}").is_err());
    }
}
