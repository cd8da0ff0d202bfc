//! The skin of a gap file: with the physics of the service's model ([`super::Skin`]), or with another
//! (`laminate`). The rest of the rig does not know which.
//! Uses: `super`, laminate. Never: wires, the clock.

use std::path::Path;

use laminate::readout::DAY_S;
use laminate::{Forces, Laminate, LaminateError, Laws, Plan, Touch};
use serde::Deserialize;
use sim_core::sensor::Sensor;

use super::mechanics::{Mechanics, Stroke, TipPosition};
use super::{Gap, GapError, Readout, Skin, SkinError, TipLoad};

/// A gap file of either physics.
#[derive(Debug, Clone, PartialEq)]
pub enum GapFile {
    /// Deviations from the model of the service.
    Model(Gap),
    /// Laws of another physics.
    Laminate(Laws),
}

/// A gap file of another physics.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LaminateFile {
    #[serde(rename = "name")]
    _name: String,
    laminate: Laws,
}

impl GapFile {
    /// Parses a gap file: one with a table `laminate` has another physics.
    ///
    /// # Errors
    /// `GapError` if the text is not a valid gap file.
    pub fn from_toml(text: &str) -> Result<Self, GapError> {
        let is_laminate =
            text.parse::<toml::Table>().is_ok_and(|file| file.contains_key("laminate"));
        if is_laminate {
            let file: LaminateFile = toml::from_str(text)?;
            return Ok(Self::Laminate(file.laminate));
        }
        Gap::from_toml(text).map(Self::Model)
    }
}

/// Numbers of the sensor file for a skin of another physics.
fn plan(sensor: &Sensor) -> Plan {
    let file = &sensor.file;
    Plan {
        size_mm: [file.width_mm, file.height_mm],
        electrodes_mm: sensor.electrodes_mm().to_vec(),
        tip_diameter_mm: file.tip_diameter_mm,
        foam_mm: file.layers.foam.thickness_mm,
        sheet_ohm_per_sq: file.circuit.sheet_ohm_per_sq,
        source_v: file.circuit.source_v * file.circuit.gain,
    }
}

/// A skin under held loads. `Send + Sync`.
#[derive(Debug)]
pub enum AnySkin {
    /// The service's model with deviations.
    Model(Box<Skin>),
    /// Skin of `laminate`: another physics than that of `sim-core`.
    Laminate(Box<Laminate>),
}

impl AnySkin {
    /// Builds the skin of a seed. A skin of the service's physics reads its unit responses from
    /// `cache_dir` if they are there, and leaves them there if they are not.
    ///
    /// # Errors
    /// `SkinError` if the skin cannot be built.
    pub fn new(
        sensor: Sensor,
        gap: GapFile,
        seed: u64,
        cache_dir: Option<&Path>,
    ) -> Result<Self, SkinError> {
        Ok(match gap {
            GapFile::Model(gap) => Self::Model(Box::new(Skin::new(sensor, gap, seed, cache_dir)?)),
            GapFile::Laminate(laws) => {
                Self::Laminate(Box::new(Laminate::new(&plan(&sensor), &laws, seed)?))
            }
        })
    }

    /// Static voltages of a held load, V after gain, injection-major, electrodes squared.
    ///
    /// # Errors
    /// `LaminateError` if the skin has no equilibrium under the load.
    pub fn solve(&self, tips: &[TipLoad]) -> Result<Vec<f64>, LaminateError> {
        match self {
            Self::Model(skin) => Ok(skin.solve(tips)),
            Self::Laminate(skin) => {
                let touch = |t: &TipLoad| Touch {
                    arm: t.arm,
                    at_mm: [t.x_mm, t.y_mm],
                    force_n: t.force_n,
                    stroke: t.stroke,
                };
                skin.voltages(&tips.iter().map(touch).collect::<Vec<_>>())
            }
        }
    }
}

/// The readout of a skin that has been connected for some days.
#[derive(Debug, Clone)]
pub struct AnyReadout {
    kind: ReadoutKind,
    age_s: f64,
}

#[derive(Debug, Clone)]
enum ReadoutKind {
    Model(Readout),
    Laminate(laminate::Readout),
}

impl AnyReadout {
    /// Creates the readout of a seed, `age_days` after its first day.
    pub fn new(sensor: &Sensor, gap: &GapFile, seed: u64, age_days: f64) -> Self {
        let kind = match gap {
            GapFile::Model(gap) => ReadoutKind::Model(Readout::new(gap, seed)),
            GapFile::Laminate(laws) => ReadoutKind::Laminate(laminate::Readout::new(
                laws,
                seed,
                sensor.electrodes_mm().len(),
            )),
        };
        Self { kind, age_s: DAY_S * age_days }
    }

    /// One frame of a held load at a process time, V.
    pub fn frame(&mut self, static_v: &[f64], process_time_s: f64, out: &mut [f32]) {
        let at_s = process_time_s + self.age_s;
        match &mut self.kind {
            ReadoutKind::Model(readout) => readout.frame(static_v, at_s, out),
            ReadoutKind::Laminate(readout) => readout.frame(static_v, at_s, out),
        }
    }
}

/// The forces of the tips of a rig on a skin.
#[derive(Debug)]
pub enum AnyMechanics {
    /// Fitted to the paper's Table I.
    Model(Mechanics),
    /// From the mechanics of another physics.
    Laminate(Box<Forces>),
}

impl AnyMechanics {
    /// Creates the mechanics of a seed.
    ///
    /// # Errors
    /// `SkinError` if the mechanics of another physics cannot be solved.
    pub fn new(sensor: &Sensor, gap: &GapFile, seed: u64) -> Result<Self, SkinError> {
        Ok(match gap {
            GapFile::Model(gap) => Self::Model(Mechanics::new(&gap.mechanics, seed)),
            GapFile::Laminate(laws) => {
                Self::Laminate(Box::new(Forces::new(&plan(sensor), laws, seed)?))
            }
        })
    }

    /// Force of a tip, N, >= 0. `z_below_surface_mm`: how far the stage is below the nominal surface.
    pub fn force_n(&self, at: &TipPosition, z_below_surface_mm: f64, stroke: Stroke) -> f64 {
        match self {
            Self::Model(mechanics) => mechanics.force_n(at, z_below_surface_mm, stroke),
            Self::Laminate(forces) => forces.force_n(at.arm, at.tip_mm, z_below_surface_mm, stroke),
        }
    }
}
