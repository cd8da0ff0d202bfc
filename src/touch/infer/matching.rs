//! Assignment of estimated to true contacts (paper V-B2: Hungarian matching).
//! PURE. Uses: pathfinding (Kuhn and Munkres). Never: a limit on the distance, forces.

use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;

/// Integer units of distance in the matching, per mm: micrometres.
const UNITS_PER_MM: f64 = 1e3;
/// Distances beyond this count as equal in the matching, mm: their sums must fit into 64 bits.
const FARTHEST_MM: f64 = 1e12;

/// An estimate and the true contact to which it is assigned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Index of the true contact.
    pub truth: usize,
    /// Index of the estimate.
    pub estimate: usize,
    /// Distance between the two, mm.
    pub distance_mm: f64,
}

/// Distance between two positions, mm.
pub fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Returns the largest number of pairs with the least total distance (rounded to a micrometre
/// each), in the order of the truths. Each contact is in at most one pair. Positions (mm) must be
/// finite.
pub fn matched(truths_mm: &[[f64; 2]], estimates_mm: &[[f64; 2]]) -> Vec<Match> {
    // The library requires at most as many rows as columns, and at least one row.
    let swapped = truths_mm.len() > estimates_mm.len();
    let (rows, columns) =
        if swapped { (estimates_mm, truths_mm) } else { (truths_mm, estimates_mm) };
    if rows.is_empty() {
        return Vec::new();
    }
    let cost = Matrix::from_fn(rows.len(), columns.len(), |(row, column)| {
        let units = distance_mm(rows[row], columns[column]).min(FARTHEST_MM) * UNITS_PER_MM;
        units.round() as i64
    });
    let (_, column_of) = kuhn_munkres_min(&cost);
    let mut matches: Vec<Match> = column_of
        .into_iter()
        .enumerate()
        .map(|(row, column)| if swapped { (column, row) } else { (row, column) })
        .map(|(truth, estimate)| {
            let distance_mm = distance_mm(truths_mm[truth], estimates_mm[estimate]);
            Match { truth, estimate, distance_mm }
        })
        .collect();
    matches.sort_by_key(|pair| pair.truth);
    matches
}

/// Distance from each position to the closest of `others_mm`, mm; `None` if there are no others.
pub fn closest_mm(places_mm: &[[f64; 2]], others_mm: &[[f64; 2]]) -> Vec<Option<f64>> {
    let closest = |place: &[f64; 2]| {
        others_mm.iter().map(|other| distance_mm(*place, *other)).min_by(f64::total_cmp)
    };
    places_mm.iter().map(closest).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{Match, closest_mm, distance_mm, matched};

    #[test]
    fn the_closest_pair_is_given_up_where_that_makes_the_total_less() {
        // A greedy matching would choose 4 mm and then need 20; the sum of the others is 6 + 6.
        let (truths, estimates) = ([[0.0, 0.0], [10.0, 0.0]], [[6.0, 0.0], [-10.0, 0.0]]);
        let pairs = matched(&truths, &estimates);
        let expected = [
            Match { truth: 0, estimate: 1, distance_mm: 10.0 },
            Match { truth: 1, estimate: 0, distance_mm: 4.0 },
        ];
        assert_eq!(pairs, expected);
        let crossed = matched(&[[0.0, 0.0], [4.0, 3.0]], &[[4.0, 3.0], [0.0, 0.0]]);
        let order: Vec<(usize, usize)> = crossed.iter().map(|p| (p.truth, p.estimate)).collect();
        assert_eq!(order, [(0, 1), (1, 0)]);
    }

    #[test]
    fn what_is_left_over_has_no_pair() {
        let places = [[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]];
        let missed = matched(&places, &[[90.0, 0.0]]);
        assert_eq!(missed, [Match { truth: 1, estimate: 0, distance_mm: 10.0 }]);
        let invented = matched(&[[0.0, 95.0]], &places);
        assert_eq!(invented, [Match { truth: 0, estimate: 2, distance_mm: 5.0 }]);
        assert!(matched(&places, &[]).is_empty() && matched(&[], &places).is_empty());
        let far = [[1e300, 0.0], [-1e300, 0.0]];
        assert_eq!(matched(&far, &far).len(), 2, "no sum overflows");
    }

    #[test]
    fn closest_counts_an_estimate_for_as_many_as_it_is_closest_to() {
        let closest = closest_mm(&[[0.0, 0.0], [30.0, 40.0]], &[[0.0, 5.0], [900.0, 0.0]]);
        assert_eq!(closest[0], Some(5.0));
        assert!((closest[1].unwrap() - 30.0_f64.hypot(35.0)).abs() < 1e-12);
        assert_eq!(closest_mm(&[[1.0, 1.0]], &[]), [None]);
    }

    /// Least total over all assignments of rows to different columns.
    fn least(rows: &[[f64; 2]], columns: &[[f64; 2]], used: &mut Vec<bool>) -> f64 {
        let Some((first, rest)) = rows.split_first() else { return 0.0 };
        let mut best = f64::INFINITY;
        for column in 0..columns.len() {
            if !used[column] {
                used[column] = true;
                let total = distance_mm(*first, columns[column]) + least(rest, columns, used);
                used[column] = false;
                best = best.min(total);
            }
        }
        best
    }

    fn places(most: usize) -> impl Strategy<Value = Vec<[f64; 2]>> {
        prop::collection::vec([0.0..540.0_f64, 0.0..560.0_f64], 1..=most)
    }

    proptest! {
        #[test]
        fn no_other_matching_has_a_smaller_total(a in places(6), b in places(6)) {
            let pairs = matched(&a, &b);
            prop_assert_eq!(pairs.len(), a.len().min(b.len()));
            let total: f64 = pairs.iter().map(|p| p.distance_mm).sum();
            let (rows, columns) = if a.len() <= b.len() { (&a, &b) } else { (&b, &a) };
            let best = least(rows, columns, &mut vec![false; columns.len()]);
            prop_assert!(total - best < 6e-3 && best - total < 1e-9, "{total} against {best} mm");
        }
    }
}
