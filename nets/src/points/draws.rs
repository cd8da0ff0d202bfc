//! Contacts of the samples that are simulated while Point-Net trains.
//! PURE. Never: a simulation. A sample is a function of seed and number alone.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::chance::{Purpose, generator};
use crate::error::{RecipeError, require};

/// Distribution of the contacts of samples: as in Sim-Random (paper IV-B), with some lighter ones,
/// since Real-Unseen's weights are 5 to 10 N, and some samples without contact. A net trained
/// without the untouched skin finds contacts on it, in 5 % of its frames; one trained with the
/// untouched skin as often as with each number of contacts finds none, but misses more real ones
/// (right count 44 % instead of 50 %).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Draws {
    /// Smallest and largest number of contacts, each number equally likely.
    pub contacts: [usize; 2],
    /// Smallest and largest force of a contact, N, uniform.
    pub force_n: [f64; 2],
    /// Share of the samples without contact, in addition to those that `contacts` may produce.
    pub untouched_share: f64,
    /// Share of the samples with light contacts only.
    pub light_share: f64,
    /// Smallest and largest force of a light contact, N, uniform.
    pub light_force_n: [f64; 2],
}

impl Default for Draws {
    fn default() -> Self {
        Self {
            contacts: [1, 6],
            force_n: [5.0, 40.0],
            untouched_share: 0.03,
            light_share: 0.25,
            light_force_n: [2.5, 12.0],
        }
    }
}

/// Largest number of contacts of a sample; the model is checked up to it.
const DRAWN_CONTACTS_MAX: usize = 6;

impl Draws {
    pub(crate) fn check(&self) -> Result<(), RecipeError> {
        let [fewest, most] = self.contacts;
        let shown = format!("{:?}", self.contacts);
        let holds = fewest <= most && most <= DRAWN_CONTACTS_MAX;
        require(holds, "net.draws.contacts", shown, "two numbers in order, at most 6")?;
        for (field, share) in [
            ("net.draws.untouched_share", self.untouched_share),
            ("net.draws.light_share", self.light_share),
        ] {
            require((0.0..=1.0).contains(&share), field, share, "0..1")?;
        }
        for (field, [least, largest]) in
            [("net.draws.force_n", self.force_n), ("net.draws.light_force_n", self.light_force_n)]
        {
            let holds = 0.0 < least && least <= largest && largest <= 40.0;
            let limit = "two numbers in order, above 0 and at most 40";
            require(holds, field, format!("{least} {largest}"), limit)?;
        }
        Ok(())
    }

    /// The pressed points of a sample, all different, and their forces in newtons.
    pub(super) fn sample(&self, seed: u64, number: u64, points: usize) -> Vec<(usize, f64)> {
        let mut chance = generator(seed, Purpose::Contacts, number, 0);
        let [fewest, most] = self.contacts;
        let count = chance.random_range(fewest..=most.min(points));
        let light = chance.random_bool(self.light_share);
        if chance.random_bool(self.untouched_share) {
            return Vec::new();
        }
        let [least, largest] = if light { self.light_force_n } else { self.force_n };
        let drawn = rand::seq::index::sample(&mut chance, points, count);
        drawn.into_iter().map(|point| (point, chance.random_range(least..=largest))).collect()
    }
}
