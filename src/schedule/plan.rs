//! The plan: every step of a run in its order, with every position, depth and wait decided.
//! PURE. Uses: `experiment`, `configuration`, `order`, `manual`, `problem`. Never: the rig, the
//! clock. The same experiment, seed and sensor give the same bytes.
//!
//! An honest order: configurations are drawn independently and from one distribution, so any
//! stretch of the drawn order is a random sample. A block is such a stretch; inside it the order is
//! a short tour, and blocks follow each other as drawn. So where the indenter stands says nothing
//! about when in the campaign it stood there, beyond the length of one block.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use sim_core::mesh::Mesh;
use sim_core::sensor::Sensor;

use super::chance::Chance;
use super::configuration::{Configuration, Lattice, Stand, draw};
use super::experiment::{Experiment, Limits, Measure, Policy, RealHex, RealRandom};
use super::manual::{PlannedPlacement, placements};
use super::order::{Place, tour};
use crate::problem::Problem;

/// Where a touch-off looks for the surface, as shares of the skin's width and height: the middle,
/// then one place in each quarter, since neither skin nor stage is quite flat.
const TOUCH_OFF_AT: [[f64; 2]; 5] =
    [[0.5, 0.5], [0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]];

/// A run, decided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the experiment.
    pub experiment: String,
    /// Which of Table I's experiments it is.
    pub kind: Kind,
    /// Seed of everything drawn.
    pub seed: u64,
    /// Name of the sensor.
    pub sensor: String,
    /// Voltages in a frame.
    pub channels: u32,
    /// Nodes of the skin's mesh; 0 where it has none, and no twins therefore.
    pub skin_nodes: u32,
    /// Depths of every configuration in the order of pressing, mm below `standoff_mm` above the
    /// surface. Empty when weights are placed by hand.
    pub depths_mm: Vec<f64>,
    /// Height of depth 0 above the surface found by touch-off, mm.
    pub standoff_mm: f64,
    /// How a trial is measured: waits, samples, frames.
    pub measure: Measure,
    /// What happens when something fails.
    pub policy: Policy,
    /// Limits of the experiment.
    pub limits: Limits,
    /// Settings in the order in which they are mounted; empty when weights are placed by hand.
    pub settings: Vec<Setting>,
    /// What to do, in order.
    pub steps: Vec<Step>,
}

/// The experiments of Table I that touch a real skin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The multi-point indenter.
    RealHex,
    /// Weights placed by hand.
    RealRandom,
}

/// A stretch of the plan with one number of tips mounted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Attached arms: 1 to this.
    pub tips: u8,
    /// Index of its first configuration.
    pub first: u32,
    /// Configurations in it.
    pub configurations: u32,
    /// Configurations that could have been drawn.
    pub pool: u32,
}

/// One thing to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    /// A person mounts this number of tips, on arms 1 to `tips`.
    TipChange {
        /// Position in `settings`.
        setting: u32,
        /// Tips to mount.
        tips: u8,
    },
    /// The surface and each tip's length are found by touching at these places.
    TouchOff {
        /// Position in `settings`.
        setting: u32,
        /// Where to touch, with every attached tip on a point.
        places: Vec<Stand>,
    },
    /// The same press at stated intervals, to tell drift from position. Not a trial.
    Reference(ReferencePress),
    /// One configuration: tare, then every depth, then raise.
    Configuration(PlannedConfiguration),
    /// A trial placed by hand.
    Manual(PlannedPlacement),
}

/// A reference press.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReferencePress {
    /// Position in `settings`.
    pub setting: u32,
    /// Attached tips.
    pub tips: u8,
    /// Index of the configuration that follows it in the plan; at the end, their number.
    pub before_configuration: u32,
    /// Where: the same in a whole setting, and where it can be in a whole run.
    #[serde(flatten)]
    pub stand: Stand,
    /// How deep, mm, counted as `depths_mm` are.
    pub depth_mm: f64,
}

/// A configuration in its place in the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedConfiguration {
    /// Position in the run's plan across its settings: the key of its trials.
    pub index: u32,
    /// Position in `settings`.
    pub setting: u32,
    /// Attached tips.
    pub tips: u8,
    /// Position in the drawn order of its setting.
    pub draw: u32,
    /// Block in its setting.
    pub block: u32,
    /// Where the indenter stands.
    #[serde(flatten)]
    pub stand: Stand,
    /// Index of the first configuration in the plan that equals this one (itself, if none did
    /// before): repeats are trials of their own, but a split keeps them together.
    pub group: u32,
}

impl Stand {
    /// The place that travel is counted from and to.
    pub fn place(&self) -> Place {
        Place { x_mm: self.centre_mm[0], y_mm: self.centre_mm[1], radius_mm: self.radius_mm }
    }
}

impl Plan {
    /// Decides a run. `file` names the experiment file in the problems.
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

    /// The planned configurations in order.
    pub fn configurations(&self) -> impl Iterator<Item = &PlannedConfiguration> {
        self.steps.iter().filter_map(|step| match step {
            Step::Configuration(configuration) => Some(configuration),
            _ => None,
        })
    }

    /// The trials placed by hand in order.
    pub fn placements(&self) -> impl Iterator<Item = &PlannedPlacement> {
        self.steps.iter().filter_map(|step| match step {
            Step::Manual(placement) => Some(placement),
            _ => None,
        })
    }

    /// Trials that the plan asks for.
    pub fn trials(&self) -> u64 {
        let pressed = self.configurations().count() * self.depths_mm.len();
        (pressed + self.placements().count()) as u64
    }

    /// Deepest position that is pressed, mm, counted as `depths_mm` are.
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
                problems.push(Problem::new(
                    file,
                    "real_hex.radius_pitches",
                    format!("[{low}, {high}]"),
                    format!("leaves no place where {tips} tips stand on points"),
                ));
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

/// Places of a setting that do not depend on the draw.
struct FixedPlaces {
    reference: Stand,
    touch_off: Vec<Stand>,
}

impl FixedPlaces {
    /// The reference stands nearest to the skin's middle at the middle radius; the touch-off at the
    /// smallest radius, so that the tips of one place share a patch of skin. None in an empty pool.
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
