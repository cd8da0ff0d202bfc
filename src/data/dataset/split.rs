//! Division of rows into train, validation and test (paper V-A: 3:1:1) without leaks.
//! PURE. Uses: sha2. Never: rows, files, a random generator (the order is that of hashes of seed
//! and key).
//!
//! A group holds rows that must be in the same part. Groups are sorted by their hashes, and the
//! order is cut at the shares of rows. All trials of the runs take part, including those that the
//! dataset excludes later: `real` and `r2s-transfer` of the same runs therefore have the same
//! split.

use sha2::{Digest, Sha256};

use super::definition::Split;

/// Part of a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// Rows that a net is trained on.
    Train,
    /// Rows that select the best epoch.
    Validation,
    /// Rows that a net is evaluated on.
    Test,
}

impl Part {
    /// All parts, in the order of their shares.
    pub const ALL: [Self; 3] = [Self::Train, Self::Validation, Self::Test];

    /// The part with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|part| part.name() == name)
    }

    /// Name of the part in the column `split`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

/// Rows that must be in the same part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Position in the order: see [`place`].
    pub place: u128,
    /// Number of rows.
    pub rows: u64,
    /// Stratum: the groups of each stratum are divided separately.
    pub stratum: u32,
}

/// Returns the position of a key in the order: the start of a sha256 over seed and key.
pub fn place(seed: u64, key: &[u8]) -> u128 {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(key);
    let digest: [u8; 32] = hash.finalize().into();
    u128::from_be_bytes(std::array::from_fn(|at| digest[at]))
}

/// Returns the part of each group, in the order of `groups`.
pub fn divide(groups: &[Group], split: &Split) -> Vec<Part> {
    let mut order: Vec<usize> = (0..groups.len()).collect();
    order.sort_by_key(|&at| (groups[at].stratum, groups[at].place, at));
    let mut parts = vec![Part::Train; groups.len()];
    for stratum in order.chunk_by(|&a, &b| groups[a].stratum == groups[b].stratum) {
        let rows: u64 = stratum.iter().map(|&at| groups[at].rows).sum();
        let mut before = 0;
        for &at in stratum {
            // The middle of the group decides: the cut is at the nearest border between groups.
            parts[at] = part_of(2 * before + groups[at].rows, 2 * rows, split.drawn_ratio());
            before += groups[at].rows;
        }
    }
    parts
}

/// The part that holds position `at` of `all`.
fn part_of(at: u64, all: u64, ratio: [u32; 3]) -> Part {
    let whole: u64 = ratio.iter().map(|&share| u64::from(share)).sum();
    let mut end = 0;
    for (part, share) in Part::ALL.into_iter().zip(ratio) {
        end += u64::from(share);
        if share > 0 && u128::from(at) * u128::from(whole) < u128::from(end) * u128::from(all) {
            return part;
        }
    }
    Part::Train
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::definition::SplitBy;
    use proptest::prelude::*;

    fn split(ratio: [u32; 3], seed: u64) -> Split {
        Split { by: SplitBy::Configuration, ratio, seed, stratify: true, test_runs: Vec::new() }
    }

    fn rows_of(groups: &[Group], parts: &[Part], part: Part) -> u64 {
        groups.iter().zip(parts).filter(|(_, p)| **p == part).map(|(g, _)| g.rows).sum()
    }

    #[test]
    fn single_rows_divide_exactly() {
        let groups: Vec<Group> = (0..1000u64)
            .map(|n| Group { place: place(1, &n.to_le_bytes()), rows: 1, stratum: 0 })
            .collect();
        let parts = divide(&groups, &split([3, 1, 1], 1));
        let shares = Part::ALL.map(|part| rows_of(&groups, &parts, part));
        assert_eq!(shares, [600, 200, 200]);
        let none = divide(&groups, &split([1, 0, 0], 1));
        assert!(none.iter().all(|&part| part == Part::Train));
    }

    proptest! {
        #[test]
        fn shares_are_met_within_a_group_and_the_order_of_rows_does_not_matter(
            sizes in prop::collection::vec(1u64..12, 1..200),
            ratio in prop::array::uniform3(0u32..5),
            seed: u64,
        ) {
            prop_assume!(ratio[0] > 0);
            let split = split(ratio, seed);
            let groups: Vec<Group> = sizes
                .iter()
                .zip(0u64..)
                .map(|(&rows, n)| Group { place: place(seed, &n.to_le_bytes()), rows, stratum: n as u32 % 2 })
                .collect();
            let parts = divide(&groups, &split);
            for stratum in 0..2 {
                let of = |g: &Group| g.stratum == stratum;
                let all: u64 = groups.iter().filter(|g| of(g)).map(|g| g.rows).sum();
                for (part, share) in Part::ALL.into_iter().zip(ratio) {
                    let rows: u64 = groups.iter().zip(&parts)
                        .filter(|(g, p)| of(g) && **p == part).map(|(g, _)| g.rows).sum();
                    let wanted = all as f64 * f64::from(share) / f64::from(ratio.iter().sum::<u32>());
                    prop_assert!((rows as f64 - wanted).abs() <= 11.0);
                }
            }
            let mut turned = groups.clone();
            turned.reverse();
            let mut again = divide(&turned, &split);
            again.reverse();
            prop_assert_eq!(parts, again);
        }
    }
}
