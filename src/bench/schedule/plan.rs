//! The plan: every step of a run in its order, with every position, depth and wait decided.
//! PURE. Uses: `experiment`, `configuration`, `order`, `manual`, `problem`. Never: the rig, the
//! clock. The same experiment, seed and sensor result in the same bytes.
//!
//! Order: configurations are drawn independently and from one distribution, so any stretch of the
//! drawn order is a random sample. A block is such a stretch. Inside it the order is a short tour,
//! and blocks follow each other as drawn. The position of the indenter is therefore independent of
//! the time in the campaign, beyond the length of one block.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use sim_core::mesh::Mesh;
use sim_core::sensor::Sensor;

use super::configuration::{Configuration, Lattice, Stand, draw};
use super::experiment::{Experiment, Limits, Measure, Policy, RealHex, RealRandom};
use super::manual::{PlannedPlacement, placements};
use super::order::{Place, tour};
use crate::chance::Chance;
use crate::problem::Problem;

/// Places of a touch-off, as fractions of the width and height of the skin: the middle, then one
/// place in each quarter, since neither skin nor stage is completely flat.
const TOUCH_OFF_AT: [[f64; 2]; 5] =
    [[0.5, 0.5], [0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]];

/// A run in which everything is decided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the experiment.
    pub experiment: String,
    /// Kind of the experiment (Table I).
    pub kind: Kind,
    /// Seed of all random draws.
    pub seed: u64,
    /// Name of the sensor.
    pub sensor: String,
    /// Number of voltages in a frame.
    pub channels: u32,
    /// Number of nodes of the skin's mesh; 0 without a mesh, and then without twins.
    pub skin_nodes: u32,
    /// Depths of every configuration in pressing order, mm, measured from `standoff_mm` above the
    /// surface. Empty for manual trials.
    pub depths_mm: Vec<f64>,
    /// Height of depth 0 above the surface found by touch-off, mm.
    pub standoff_mm: f64,
    /// Parameters of the measurement of a trial: waits, samples, frames.
    pub measure: Measure,
    /// Retries, skips and automatic resumes that the run allows.
    pub policy: Policy,
    /// Force limits of the experiment.
    pub limits: Limits,
    /// Settings in mounting order; empty for manual trials.
    pub settings: Vec<Setting>,
    /// Steps in their order.
    pub steps: Vec<Step>,
}

/// The experiments of Table I on a real skin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Presses with the multi-point indenter.
    RealHex,
    /// Weights placed manually.
    RealRandom,
}

/// A stretch of the plan with one number of tips mounted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Number of attached tips, on arms 1 to `tips`.
    pub tips: u8,
    /// Index of the first configuration of the setting.
    pub first: u32,
    /// Number of configurations in the setting.
    pub configurations: u32,
    /// Number of configurations from which they were drawn.
    pub pool: u32,
}

/// One step of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    /// A person mounts this number of tips, on arms 1 to `tips`.
    TipChange {
        /// Index in `settings`.
        setting: u32,
        /// Number of tips to mount.
        tips: u8,
    },
    /// Measures the surface and the relative length of each tip by touching these places.
    TouchOff {
        /// Index in `settings`.
        setting: u32,
        /// Places to touch, with every attached tip on a point.
        places: Vec<Stand>,
    },
    /// A press at a fixed position, repeated at fixed intervals to separate drift from position.
    /// Not a trial.
    Reference(ReferencePress),
    /// One configuration: tare, then every depth, then raise.
    Configuration(PlannedConfiguration),
    /// A manual trial.
    Manual(PlannedPlacement),
}

/// A reference press.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReferencePress {
    /// Index in `settings`.
    pub setting: u32,
    /// Number of attached tips.
    pub tips: u8,
    /// Index of the next configuration in the plan; after the last, the number of configurations.
    pub before_configuration: u32,
    /// Position, the same for all reference presses of a setting, and where possible for a whole
    /// run.
    #[serde(flatten)]
    pub stand: Stand,
    /// Depth, mm, measured like `depths_mm`.
    pub depth_mm: f64,
}

/// A configuration at its position in the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedConfiguration {
    /// Index in the plan across all settings; part of the key of its trials.
    pub index: u32,
    /// Index in `settings`.
    pub setting: u32,
    /// Number of attached tips.
    pub tips: u8,
    /// Index in the drawn order of its setting.
    pub draw: u32,
    /// Index of the block in its setting.
    pub block: u32,
    /// Position of the indenter.
    #[serde(flatten)]
    pub stand: Stand,
    /// Index of the first equal configuration in the plan (its own, if there is none before).
    /// Repeats are separate trials, but a split keeps them together.
    pub group: u32,
}

impl Stand {
    /// Position for the calculation of travel.
    pub fn place(&self) -> Place {
        Place { x_mm: self.centre_mm[0], y_mm: self.centre_mm[1], radius_mm: self.radius_mm }
    }
}

impl Plan {
    /// Decides all steps of a run. `file` is the name of the experiment file in the problems.
    ///
    /// # Errors
    /// A radius range without a valid configuration, a skin too small for the contacts, or not
    /// exactly one of `[real_hex]` and `[real_random]`.
    pub fn of(file: &str, experiment: &Experiment, sensor: &Sensor) -> Result<Self, Vec<Problem>> {
        let mut plan = Self {
            experiment: experiment.name.clone(),
            kind: Kind::RealHex,
            seed: experiment.seed,
            sensor: sensor.file.name.clone(),
            channels: sensor.channels() as u32,
            skin_nodes: Mesh::new(sensor).map_or(0, |mesh| mesh.plane_nodes() as u32),
            depths_mm: Vec::new(),
            standoff_mm: 0.0,
            measure: experiment.measure.clone(),
            policy: experiment.policy.clone(),
            limits: experiment.limits.clone(),
            settings: Vec::new(),
            steps: Vec::new(),
        };
        match (&experiment.real_hex, &experiment.real_random) {
            (Some(hex), None) => plan.add_hex(file, hex, sensor)?,
            (None, Some(random)) => plan.add_random(file, random, sensor)?,
            _ => {
                let limit = "must hold exactly one of [real_hex] and [real_random]";
                return Err(vec![Problem::whole(file, limit)]);
            }
        }
        Ok(plan)
    }

    /// Largest number of tips of a setting.
    pub fn most_tips(&self) -> u8 {
        self.settings.iter().map(|setting| setting.tips).max().unwrap_or(1)
    }

    /// The planned configurations in their order.
    pub fn configurations(&self) -> impl Iterator<Item = &PlannedConfiguration> {
        self.steps.iter().filter_map(|step| match step {
            Step::Configuration(configuration) => Some(configuration),
            _ => None,
        })
    }

    /// The manual trials in their order.
    pub fn placements(&self) -> impl Iterator<Item = &PlannedPlacement> {
        self.steps.iter().filter_map(|step| match step {
            Step::Manual(placement) => Some(placement),
            _ => None,
        })
    }

    /// Number of trials in the plan.
    pub fn trials(&self) -> u64 {
        let pressed = self.configurations().count() * self.depths_mm.len();
        (pressed + self.placements().count()) as u64
    }

    /// Deepest press, mm, measured like `depths_mm`.
    pub fn deepest_mm(&self) -> f64 {
        let references = self.steps.iter().filter_map(|step| match step {
            Step::Reference(press) => Some(press.depth_mm),
            _ => None,
        });
        self.depths_mm.iter().copied().chain(references).fold(0.0, f64::max)
    }

    fn add_random(
        &mut self,
        file: &str,
        random: &RealRandom,
        sensor: &Sensor,
    ) -> Result<(), Vec<Problem>> {
        self.kind = Kind::RealRandom;
        let drawn = placements(random, self.seed, sensor).map_err(|crowded| {
            let shown = crowded.contacts;
            vec![Problem::new(file, "real_random.contacts", shown, crowded.to_string())]
        })?;
        self.steps.extend(drawn.into_iter().map(Step::Manual));
        Ok(())
    }

    fn add_hex(&mut self, file: &str, hex: &RealHex, sensor: &Sensor) -> Result<(), Vec<Problem>> {
        self.depths_mm = hex.depths_mm();
        self.standoff_mm = hex.standoff_mm;
        let lattice = Lattice::of(sensor);
        let mut problems = Vec::new();
        let mut groups = HashMap::new();
        for &tips in &hex.tips {
            let pool = lattice.pool(tips, hex.radius_pitches);
            let Some(fixed) = FixedPlaces::of(&lattice, sensor, &pool, hex) else {
                let [low, high] = hex.radius_pitches;
                let found = format!("[{low}, {high}]");
                let limit = format!("has no position with {tips} tips on points");
                problems.push(Problem::new(file, "real_hex.radius_pitches", found, limit));
                continue;
            };
            self.add_setting(hex, tips, &pool, &lattice, &fixed, &mut groups);
        }
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    fn add_setting(
        &mut self,
        hex: &RealHex,
        tips: u8,
        pool: &[Configuration],
        lattice: &Lattice<'_>,
        fixed: &FixedPlaces,
        groups: &mut HashMap<Configuration, u32>,
    ) {
        let setting = self.settings.len() as u32;
        let first = self.settings.last().map_or(0, |s| s.first + s.configurations);
        self.settings.push(Setting {
            tips,
            first,
            configurations: hex.configurations,
            pool: pool.len() as u32,
        });
        self.steps.push(Step::TipChange { setting, tips });
        self.steps.push(Step::TouchOff { setting, places: fixed.touch_off.clone() });
        let reference = |index| {
            Step::Reference(ReferencePress {
                setting,
                tips,
                before_configuration: index,
                stand: fixed.reference.clone(),
                depth_mm: hex.reference_depth_mm,
            })
        };
        let mut here = fixed.touch_off.last().unwrap_or(&fixed.reference).place();
        if hex.reference_every > 0 {
            self.steps.push(reference(first));
            here = fixed.reference.place();
        }
        let mut chance = Chance::named(self.seed, &format!("real-hex/{tips}/configurations"));
        let drawn = draw(pool, hex.configurations, &mut chance);
        let stands: Vec<Stand> = drawn.iter().filter_map(|&c| lattice.stand(c)).collect();
        let places: Vec<Place> = stands.iter().map(Stand::place).collect();
        let size = hex.block.max(1) as usize;
        let mut index = first;
        for (block, members) in places.chunks(size).enumerate() {
            for member in tour(here, members) {
                let draw = block * size + member;
                self.steps.push(Step::Configuration(PlannedConfiguration {
                    index,
                    setting,
                    tips,
                    draw: draw as u32,
                    block: block as u32,
                    stand: stands[draw].clone(),
                    group: *groups.entry(drawn[draw]).or_insert(index),
                }));
                index += 1;
                here = places[draw];
                if hex.reference_every > 0 && (index - first).is_multiple_of(hex.reference_every) {
                    self.steps.push(reference(index));
                    here = fixed.reference.place();
                }
            }
        }
    }
}

/// Positions of a setting that do not depend on the draw.
struct FixedPlaces {
    reference: Stand,
    touch_off: Vec<Stand>,
}

impl FixedPlaces {
    /// Reference position: closest to the middle of the skin at the middle radius. Touch-off: at
    /// the smallest radius, so that the tips of one place share a small area. Returns none for an
    /// empty pool.
    fn of(
        lattice: &Lattice<'_>,
        sensor: &Sensor,
        pool: &[Configuration],
        hex: &RealHex,
    ) -> Option<Self> {
        let [low, high] = hex.radius_pitches;
        let near = |radius_pitches, share: [f64; 2]| {
            let place = [share[0] * sensor.file.width_mm, share[1] * sensor.file.height_mm];
            lattice.stand(lattice.nearest(pool, radius_pitches, place)?)
        };
        let mut touch_off: Vec<Stand> = Vec::new();
        for share in TOUCH_OFF_AT {
            let stand = near(low, share)?;
            if !touch_off.contains(&stand) {
                touch_off.push(stand);
            }
        }
        Some(Self { reference: near(low.midpoint(high), [0.5, 0.5])?, touch_off })
    }
}
