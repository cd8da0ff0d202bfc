//! Answers of the service of which the screen reads a part. An older service lacks some of it: every field
//! may be absent.
//! PURE. Uses: serde. Never: an error for a field that is absent.

use serde::Deserialize;

use crate::api::History;
use crate::schedule::visits::Visits;

/// `GET /api/v1/runs/{run}/tour`: where the plan presses, in the planned order.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Tour {
    /// Planned depths of each configuration, mm.
    pub depths_mm: Vec<f64>,
    /// The configurations, in the planned order.
    pub steps: Visits,
}

/// Trials per hour over the last bins of a run, or over all of them.
pub fn per_hour(course: &History, last: Option<usize>) -> Option<f64> {
    let skipped = last.map_or(0, |last| course.trials.len().saturating_sub(last));
    let bins = &course.trials[skipped..];
    let over_s = bins.len() as f64 * course.bin_s?;
    let trials: u32 = bins.iter().sum();
    (over_s > 0.0).then(|| 3600.0 * f64::from(trials) / over_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_pace_of_a_run_is_that_of_all_bins_or_of_the_last_ones() {
        let run = History { bin_s: Some(60.0), trials: vec![10, 0, 5], ..History::default() };
        assert_eq!([None, Some(1)].map(|last| per_hour(&run, last)), [Some(300.0), Some(300.0)]);
        assert_eq!(per_hour(&run, Some(2)), Some(150.0));
        assert_eq!(per_hour(&History::default(), None), None);
    }

    #[test]
    fn a_tour_is_read_with_its_other_fields() {
        let tour: Tour = serde_json::from_value(json!({ "scan_id": 3, "depths_mm": [0.0, 0.5],
            "steps": { "configuration": [7], "tips": [1], "contacts_mm": [[[10.0, 20.0]]] } }))
        .unwrap();
        assert_eq!(tour.steps.contacts_mm[0][0], [10.0, 20.0]);
    }
}
