//! Requirements of an experiment that a bench cannot meet, found before anything moves.
//! PURE. Uses: `experiment`, `configuration`, `reach`, `problem`. Never: the rig, corrections.
//!
//! Checks everything that could be drawn, not only what was drawn: a new seed causes no new
//! problem.

use sim_core::sensor::Sensor;

use super::configuration::Lattice;
use super::experiment::{Experiment, RealHex, RealRandom};
use super::reach::{Reach, StageReach};
use crate::problem::Problem;

/// Problems of an experiment on a bench; none if the bench meets all requirements. `file` is the
/// name of the experiment file.
pub fn lint(file: &str, experiment: &Experiment, sensor: &Sensor, reach: &Reach) -> Vec<Problem> {
    let mut lint = Lint { file, reach, found: Vec::new() };
    lint.readout(experiment, sensor);
    match (&experiment.real_hex, &reach.stage) {
        (Some(hex), Some(stage)) => {
            lint.radii(hex, sensor, stage);
            lint.centres(hex, sensor, stage);
            lint.depths(hex, stage);
            lint.forces(experiment, stage);
            lint.settling(experiment, stage);
        }
        (Some(hex), None) => {
            let limit = format!("needs a stage, which {} does not have", lint.rig());
            lint.add("real_hex.configurations", hex.configurations, limit);
        }
        (None, _) => {}
    }
    if let Some(random) = &experiment.real_random {
        lint.weights(random, experiment);
    }
    lint.found
}

struct Lint<'a> {
    file: &'a str,
    reach: &'a Reach,
    found: Vec<Problem>,
}

impl Lint<'_> {
    fn add(&mut self, key: &str, value: impl std::fmt::Display, limit: String) {
        self.found.push(Problem::new(self.file, key, value, limit));
    }

    fn readout(&mut self, experiment: &Experiment, sensor: &Sensor) {
        let (has, needs) = (self.reach.electrodes, sensor.electrodes_mm().len());
        if has as usize != needs {
            let limit =
                format!("has {needs} electrodes, but ert.electrodes = {has} in {}", self.rig());
            self.add("sensor", &experiment.sensor, limit);
        }
    }

    /// Checks every radius that a setting can draw: within the slot, and approachable from below.
    fn radii(&mut self, hex: &RealHex, sensor: &Sensor, stage: &StageReach) {
        let lattice = Lattice::of(sensor);
        let [low, high] = stage.radius_mm;
        for pitches in hex.radius_pitches[0]..=hex.radius_pitches[1] {
            let mm = sensor.pitch_mm() * f64::from(pitches);
            let drawn = hex.tips.iter().any(|&t| !lattice.pool(t, [pitches, pitches]).is_empty());
            if drawn && !(low..=high).contains(&mm) {
                let rig = self.rig();
                let limit =
                    format!("radius {mm:.2} mm is outside slot.radius_mm [{low}, {high}] of {rig}");
                self.add("real_hex.radius_pitches", pitches, limit);
            } else if drawn && mm - stage.backlash_mm < low {
                let limit = format!(
                    "radius {mm:.2} mm cannot be approached from slot.backlash_mm = {} below within \
                     slot.radius_mm [{low}, {high}] of {}",
                    stage.backlash_mm,
                    self.rig()
                );
                self.add("real_hex.radius_pitches", pitches, limit);
            }
        }
    }

    /// Checks every centre that a setting can draw: within the travel of the stage.
    fn centres(&mut self, hex: &RealHex, sensor: &Sensor, stage: &StageReach) {
        let lattice = Lattice::of(sensor);
        let drawn: Vec<[f64; 2]> = hex
            .tips
            .iter()
            .flat_map(|&tips| lattice.pool(tips, hex.radius_pitches))
            .map(|c| sensor.points()[c.centre as usize])
            .map(|p| [p.x_mm, p.y_mm])
            .collect();
        let travel = [("x", stage.x_travel_mm), ("y", stage.y_travel_mm)];
        for (axis, (name, [low, high])) in travel.into_iter().enumerate() {
            let machine = |c: &[f64; 2]| c[axis] + stage.skin_origin_mm[axis];
            let out = drawn.iter().filter(|&c| !(low..=high).contains(&machine(c))).count();
            if out > 0 {
                let first = drawn.iter().map(machine).fold(f64::INFINITY, f64::min);
                let last = drawn.iter().map(machine).fold(f64::NEG_INFINITY, f64::max);
                let limit = format!(
                    "must hold machine {name} {first:.2} to {last:.2} mm, the positions of {}: \
                     {out} of its {} configurations are out of reach",
                    self.file,
                    drawn.len()
                );
                let key = format!("axes.{name}.travel_mm");
                let shown = format!("[{low}, {high}]");
                self.found.push(Problem::new(&self.reach.file, &key, shown, limit));
            }
        }
    }

    /// Checks that depth 0 is not above the travelling height, and that the deepest press is within
    /// z where the skin is lowest.
    fn depths(&mut self, hex: &RealHex, stage: &StageReach) {
        if hex.standoff_mm > stage.clearance_mm {
            let (clearance, rig) = (stage.clearance_mm, self.rig());
            let limit = format!("must not be above skin.clearance_mm = {clearance} of {rig}");
            self.add("real_hex.standoff_mm", hex.standoff_mm, limit);
        }
        let reference = if hex.reference_every > 0 { hex.reference_depth_mm } else { 0.0 };
        let pressed =
            [("real_hex.depths", hex.deepest_mm()), ("real_hex.reference_depth_mm", reference)];
        let [top, bottom] = stage.z_travel_mm;
        for (key, depth) in pressed {
            let z = stage.surface_z_mm[1] - hex.standoff_mm + depth;
            if z > bottom {
                let limit = format!(
                    "pressing {depth} mm where the skin is lowest needs machine z {z:.2} mm, beyond \
                     axes.z.travel_mm [{top}, {bottom}] of {}",
                    self.rig()
                );
                let value = if key == "real_hex.depths" { f64::from(hex.depths) } else { depth };
                self.add(key, value, limit);
            }
        }
    }

    fn forces(&mut self, experiment: &Experiment, stage: &StageReach) {
        let limits = &experiment.limits;
        for (key, asked, rigs) in [
            ("limits.force_n", limits.force_n, stage.force_n),
            ("limits.force_sum_n", limits.force_sum_n, stage.force_sum_n),
        ] {
            if asked > rigs {
                let limit = format!("must not be above {key} = {rigs} of {}", self.rig());
                self.add(key, asked, limit);
            }
        }
    }

    /// Checks that the longest wait contains two samples of the cells, which settling requires.
    fn settling(&mut self, experiment: &Experiment, stage: &StageReach) {
        let (longest, update) = (experiment.measure.settle_max_ms, stage.cell_update_ms);
        if longest < 2.0 * update {
            let rig = self.rig();
            let limit = format!("must hold two samples of cells.update_ms = {update} of {rig}");
            self.add("measure.settle_max_ms", longest, limit);
        }
    }

    fn weights(&mut self, random: &RealRandom, experiment: &Experiment) {
        let limits = &experiment.limits;
        let heaviest = random.weights_n.iter().copied().fold(0.0, f64::max);
        if heaviest > limits.force_n {
            let limit = format!("must not be above limits.force_n = {}", limits.force_n);
            self.add("real_random.weights_n", heaviest, limit);
        }
        let most = f64::from(random.contacts.iter().copied().max().unwrap_or(0));
        if most * heaviest > limits.force_sum_n {
            let limit = format!(
                "times weights_n = {heaviest} must not be above limits.force_sum_n = {}",
                limits.force_sum_n
            );
            self.add("real_random.contacts", most, limit);
        }
    }

    fn rig(&self) -> String {
        self.reach.file.clone()
    }
}
