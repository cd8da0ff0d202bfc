//! Nested dissection: the order in which the nodes of a plane net are removed.
//! Uses: positions and neighbours only. Never: values (the order is valid for every load).
//!
//! The set is cut by a straight line; the nodes on one side that touch the other are the separator
//! and come last; both sides are cut in turn. The line is the best of six directions and five
//! positions.

/// A group of nodes that are removed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Nodes of the group.
    pub nodes: Vec<u32>,
    /// Parts (indices, all smaller than its own) whose remainders are added to this one.
    pub children: Vec<usize>,
}

/// Sets of at most this size are not divided further.
const LEAF: usize = 14;
/// Number of directions of the cuts.
const DIRECTIONS: usize = 6;
/// Positions of the cut: share of the set on the lower side.
const SHARES: [f64; 5] = [0.40, 0.45, 0.50, 0.55, 0.60];

/// Orders all nodes except the kept ones. `neighbours[i]` are the nodes that share a resistor or a
/// brick with i. Children come before their parent; the last part is the root.
pub fn dissect(places_mm: &[[f64; 2]], neighbours: &[Vec<u32>], kept: &[u32]) -> Vec<Part> {
    let mut side = vec![Side::Outside; places_mm.len()];
    let set: Vec<u32> = (0..places_mm.len() as u32).filter(|n| !kept.contains(n)).collect();
    let mut parts = Vec::new();
    cut(&mut Dissection { places_mm, neighbours, side: &mut side, parts: &mut parts }, set);
    parts
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Outside,
    Lower,
    Upper,
}

struct Dissection<'a> {
    places_mm: &'a [[f64; 2]],
    neighbours: &'a [Vec<u32>],
    side: &'a mut [Side],
    parts: &'a mut Vec<Part>,
}

/// Cuts a set and returns the index of its part.
fn cut(work: &mut Dissection<'_>, set: Vec<u32>) -> usize {
    let mut children = Vec::new();
    let mut nodes = set;
    if nodes.len() > LEAF
        && let Some([lower, separator, upper]) = best_cut(work, &nodes)
    {
        children = vec![cut(work, lower), cut(work, upper)];
        nodes = separator;
    }
    work.parts.push(Part { nodes, children });
    work.parts.len() - 1
}

/// The cut with the smallest separator, with a penalty for unequal sides.
fn best_cut(work: &mut Dissection<'_>, set: &[u32]) -> Option<[Vec<u32>; 3]> {
    let mut best: Option<(f64, [Vec<u32>; 3])> = None;
    for direction in 0..DIRECTIONS {
        let (sin, cos) = (std::f64::consts::PI * direction as f64 / DIRECTIONS as f64).sin_cos();
        let along = |n: u32| {
            let [x, y] = work.places_mm[n as usize];
            cos * x + sin * y
        };
        let mut sorted = set.to_vec();
        sorted.sort_by(|&a, &b| along(a).total_cmp(&along(b)).then(a.cmp(&b)));
        for share in SHARES {
            let at = ((set.len() as f64 * share) as usize).clamp(1, set.len() - 1);
            let [lower, separator, upper] = split(work, &sorted, at);
            if lower.is_empty() || upper.is_empty() {
                continue;
            }
            let lopsided = lower.len().abs_diff(upper.len()) as f64 / set.len() as f64;
            let cost = separator.len() as f64 * (1.0 + 0.5 * lopsided);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, [lower, separator, upper]));
            }
        }
    }
    best.map(|(_, parts)| parts)
}

/// Splits a sorted set; the separator is taken from the lower side.
fn split(work: &mut Dissection<'_>, sorted: &[u32], at: usize) -> [Vec<u32>; 3] {
    for (i, &node) in sorted.iter().enumerate() {
        work.side[node as usize] = if i < at { Side::Lower } else { Side::Upper };
    }
    let touches_upper = |&node: &u32| {
        let side = &work.side;
        work.neighbours[node as usize].iter().any(|&n| side[n as usize] == Side::Upper)
    };
    let (separator, lower) = sorted[..at].iter().partition(|n| touches_upper(n));
    let upper = sorted[at..].to_vec();
    for &node in sorted {
        work.side[node as usize] = Side::Outside;
    }
    [lower, separator, upper]
}
