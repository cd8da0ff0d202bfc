//! A short tour of the configurations of one block.
//! PURE. Uses: nothing. Never: an order over the whole run (it would correlate position with
//! drift), more work than its bound.
//!
//! x, y and radius move at the same time, so a step costs the longer of the two motions:
//! max(distance in (x, y), `RADIUS_WEIGHT` x change of radius). The tour starts at the position of
//! the stage and ends anywhere: nearest neighbour, then 2-opt and Or-opt until nothing improves or
//! the bound is reached.

/// Cost of a millimetre of radius, in millimetres of lateral travel. A rotary actuator that spreads
/// arms is slower than a stage, but only the stage wears with its travel.
const RADIUS_WEIGHT: f64 = 1.0;

/// Longest segment that Or-opt moves, places.
const LONGEST_SEGMENT: usize = 3;

/// Largest number of candidate changes for one tour: about 70 sweeps over 100 places.
const WORK: u64 = 2_500_000;

/// Smallest reduction that counts, mm; prevents cycles caused by rounding.
const GAIN: f64 = 1e-9;

/// Position of the indenter, for the travel between positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// x of the centre, mm.
    pub x_mm: f64,
    /// y of the centre, mm.
    pub y_mm: f64,
    /// Radius of the tips, mm.
    pub radius_mm: f64,
}

impl Place {
    /// Euclidean distance in (x, y), mm, reported as travel by a preflight. A plain square root:
    /// `hypot` may differ in its last bit between platforms.
    pub fn travel_mm(&self, to: &Self) -> f64 {
        let (dx, dy) = (to.x_mm - self.x_mm, to.y_mm - self.y_mm);
        (dx * dx + dy * dy).sqrt()
    }

    /// Cost of a step, in mm of lateral travel.
    fn cost(&self, to: &Self) -> f64 {
        self.travel_mm(to).max(RADIUS_WEIGHT * (to.radius_mm - self.radius_mm).abs())
    }
}

/// Order in which to visit `places`, starting from `start`: each index into `places` once.
pub fn tour(start: Place, places: &[Place]) -> Vec<usize> {
    let costs = Costs::between(start, places);
    let mut path = nearest_neighbour(&costs);
    let mut work = WORK;
    loop {
        let shortened =
            two_opt(&mut path, &costs, &mut work) | or_opt(&mut path, &costs, &mut work);
        if !shortened || work == 0 {
            break;
        }
    }
    path.into_iter().skip(1).map(|node| node - 1).collect()
}

/// Costs between nodes: node 0 is the start, node i + 1 is place i.
struct Costs {
    nodes: usize,
    table: Vec<f64>,
}

impl Costs {
    fn between(start: Place, places: &[Place]) -> Self {
        let all: Vec<Place> = std::iter::once(start).chain(places.iter().copied()).collect();
        let table = all.iter().flat_map(|a| all.iter().map(|b| a.cost(b))).collect();
        Self { nodes: all.len(), table }
    }

    fn of(&self, a: usize, b: usize) -> f64 {
        self.table[a * self.nodes + b]
    }

    /// Cost from the node at `at` of a path to the next one; 0 at the open end.
    fn after(&self, path: &[usize], at: usize, from: usize) -> f64 {
        path.get(at + 1).map_or(0.0, |&next| self.of(from, next))
    }
}

fn nearest_neighbour(costs: &Costs) -> Vec<usize> {
    let mut left: Vec<usize> = (1..costs.nodes).collect();
    let mut path = vec![0];
    let mut here = 0;
    while let Some(i) =
        (0..left.len()).min_by(|&a, &b| costs.of(here, left[a]).total_cmp(&costs.of(here, left[b])))
    {
        here = left.remove(i);
        path.push(here);
    }
    path
}

/// Reverses segments where that is shorter. The start is fixed; the end is open.
fn two_opt(path: &mut [usize], costs: &Costs, work: &mut u64) -> bool {
    let mut shortened = false;
    for i in 1..path.len() {
        for j in i + 1..path.len() {
            if *work == 0 {
                return shortened;
            }
            *work -= 1;
            let (before, first, last) = (path[i - 1], path[i], path[j]);
            let old = costs.of(before, first) + costs.after(path, j, last);
            let new = costs.of(before, last) + costs.after(path, j, first);
            if new + GAIN < old {
                path[i..=j].reverse();
                shortened = true;
            }
        }
    }
    shortened
}

/// Moves segments of up to `LONGEST_SEGMENT` places to their cheapest position.
fn or_opt(path: &mut Vec<usize>, costs: &Costs, work: &mut u64) -> bool {
    let mut shortened = false;
    for length in 1..=LONGEST_SEGMENT {
        for i in 1..(path.len() + 1).saturating_sub(length) {
            let spent = path.len() as u64;
            if *work < spent {
                *work = 0;
                return shortened;
            }
            *work -= spent;
            shortened |= move_segment(path, costs, i, length);
        }
    }
    shortened
}

/// Moves the segment of `length` at `i` to its best position, in either direction, if that is
/// shorter.
fn move_segment(path: &mut Vec<usize>, costs: &Costs, i: usize, length: usize) -> bool {
    let last = i + length - 1;
    let (head, tail) = (path[i], path[last]);
    let bridged = costs.after(path, last, path[i - 1]);
    let saved = costs.of(path[i - 1], head) + costs.after(path, last, tail) - bridged;
    let mut best: Option<(f64, usize, bool)> = None;
    for at in (0..path.len()).filter(|at| !(i - 1..=last).contains(at)) {
        let edge = costs.after(path, at, path[at]);
        for (first, end, turned) in [(head, tail, false), (tail, head, true)] {
            let added = costs.of(path[at], first) + costs.after(path, at, end) - edge;
            if added + GAIN < saved && best.is_none_or(|(least, ..)| added < least) {
                best = Some((added, at, turned));
            }
        }
    }
    let Some((_, at, turned)) = best else { return false };
    let mut segment: Vec<usize> = path.drain(i..=last).collect();
    if turned {
        segment.reverse();
    }
    let after = if at < i { at + 1 } else { at + 1 - length };
    path.splice(after..after, segment);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance::Chance;
    use proptest::prelude::*;

    fn places(seed: u64, count: u32) -> Vec<Place> {
        let mut chance = Chance::named(seed, "places");
        let mut mm = |span| f64::from(chance.below(span));
        (0..count).map(|_| Place { x_mm: mm(450), y_mm: mm(450), radius_mm: mm(170) }).collect()
    }

    fn cost(start: Place, places: &[Place], order: &[usize]) -> f64 {
        let path: Vec<Place> =
            std::iter::once(start).chain(order.iter().map(|&i| places[i])).collect();
        path.windows(2).map(|step| step[0].cost(&step[1])).sum()
    }

    const START: Place = Place { x_mm: 0.0, y_mm: 0.0, radius_mm: 30.0 };

    #[test]
    fn small_tours_are_close_to_the_best() {
        for seed in 0..20 {
            let places = places(seed, 7);
            let found = cost(START, &places, &tour(START, &places));
            let best =
                permutations(7).iter().map(|o| cost(START, &places, o)).fold(f64::MAX, f64::min);
            assert!(found <= 1.1 * best, "seed {seed}: {found} against {best}");
        }
    }

    #[test]
    fn a_tour_of_100_is_far_shorter_than_the_drawn_order() {
        let places = places(1, 100);
        let drawn: Vec<usize> = (0..100).collect();
        let ratio = cost(START, &places, &tour(START, &places)) / cost(START, &places, &drawn);
        assert!(ratio < 0.35, "{ratio}");
    }

    proptest! {
        #[test]
        fn a_tour_visits_every_place_once_and_beats_nearest_neighbour(seed: u64, count in 0u32..40) {
            let places = places(seed, count);
            let order = tour(START, &places);
            let mut sorted = order.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..places.len()).collect::<Vec<_>>());
            let greedy: Vec<usize> = nearest_neighbour(&Costs::between(START, &places))[1..]
                .iter()
                .map(|n| n - 1)
                .collect();
            prop_assert!(cost(START, &places, &order) <= cost(START, &places, &greedy) + 1e-6);
        }
    }

    fn permutations(n: usize) -> Vec<Vec<usize>> {
        if n == 0 {
            return vec![Vec::new()];
        }
        permutations(n - 1)
            .into_iter()
            .flat_map(|p| {
                (0..n).map(move |at| {
                    let mut q = p.clone();
                    q.insert(at, n - 1);
                    q
                })
            })
            .collect()
    }
}
