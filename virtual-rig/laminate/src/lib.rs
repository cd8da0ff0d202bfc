//! A virtual skin of other physics: what Palpate's methods meet when the skin is not their model.
//!
//! `sim-core` models the skin by linear finite elements under point loads, Eq. 1 of the paper in the
//! compression, a triangular resistor network and point electrodes. Here each of these is another:
//!
//! | part | here |
//! |---|---|
//! | [`press`] | rigid, tilted tips in unilateral contact with a fabric on foam that yields and densifies; Newton's method on 2.5 mm squares |
//! | [`conductance`] | conductance as a law of the local pressure, with hysteresis |
//! | [`sheet`] | finite volumes on 5 mm squares, an anisotropic fabric, disc electrodes with contact impedance |
//! | [`readout`] | 16-bit counts, 1/f noise, mains pickup, crosstalk, drifting offsets, temperature |
//! | [`forces`] | the force of a tip from the mechanics above, tilts, heights and the arm's spring |
//!
//! Sources of laws and parameters: `docs/references.md`, "Skins of other physics". Uses: faer, rand.
//! Never: `sim-core`, files, clocks (process times are passed in), unseeded chance.

pub mod conductance;
pub mod field;
pub mod foam;
pub mod forces;
pub mod laws;
pub mod press;
pub mod readout;
pub mod sheet;

use faer::Par;

use conductance::Conductance;
pub use forces::Forces;
pub use laws::{Laws, ValueError};
use press::{Foundation, Patch};
pub use readout::Readout;
use sheet::Sheet;

/// Numbers of the sensor file that describe the skin.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Size along x and y, mm.
    pub size_mm: [f64; 2],
    /// Nominal centres of the electrodes, mm.
    pub electrodes_mm: Vec<[f64; 2]>,
    /// Diameter of a tip, mm.
    pub tip_diameter_mm: f64,
    /// Thickness of the foam, mm.
    pub foam_mm: f64,
    /// Resistance of the sheet, ohm per square.
    pub sheet_ohm_per_sq: f64,
    /// Source voltage times gain of the readout, V.
    pub source_v: f64,
}

/// Direction in which the depth of a tip in contact changes: the foam is softer while unloading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// Downward, or at the deepest position so far.
    Loading,
    /// Upward from the deepest position.
    Unloading,
}

/// A tip or a weight that presses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Index of the arm, or the number of arms for a weight placed manually.
    pub arm: usize,
    /// Centre of the touch, skin coordinates, mm.
    pub at_mm: [f64; 2],
    /// Normal force, N.
    pub force_n: f64,
    /// Direction in which its depth changes.
    pub stroke: Stroke,
}

/// Why a skin cannot be built or solved.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum LaminateError {
    #[error(transparent)]
    Laws(#[from] ValueError),
    /// A system of equations has no solution.
    #[error("{part}: {why}")]
    Solve { part: &'static str, why: String },
    #[error(
        "press: no equilibrium after {steps} steps: the largest residual is {residual_n} N \
         under {force_n} N"
    )]
    Equilibrium { steps: usize, residual_n: f64, force_n: f64 },
}

/// One skin: laws and a seed.
#[derive(Debug)]
pub struct Laminate {
    foundation: Foundation,
    conductance: Conductance,
    sheet: Sheet,
    untouched_v: Vec<f64>,
}

impl Laminate {
    /// Builds a skin. The same plan, laws and seed give the same skin.
    ///
    /// # Errors
    /// `LaminateError` if a law is not valid, or the sheet cannot be factorised.
    pub fn new(plan: &Plan, laws: &Laws, seed: u64) -> Result<Self, LaminateError> {
        laws.check(plan)?;
        // Results do not depend on the number of threads.
        faer::set_global_parallelism(Par::Seq);
        let foundation = Foundation::new(plan, laws, seed);
        let conductance = Conductance::new(laws, seed, foundation.grid());
        let sheet = Sheet::new(plan, laws, seed)?;
        let mut skin = Self { foundation, conductance, sheet, untouched_v: Vec::new() };
        skin.untouched_v = skin.sheet.frame_v(&skin.leaks_s(&[])?)?;
        Ok(skin)
    }

    /// Static voltages of a held load, V after gain, injection-major, electrodes squared: differences
    /// `V_j - V_(j+1)` while the electrode of the injection is at 0 V and the top layer at the
    /// source's voltage. A touch without a positive force, or off the skin, is ignored.
    ///
    /// # Errors
    /// `LaminateError::Equilibrium` if the mechanics do not converge, `Solve` if the network cannot be
    /// solved.
    pub fn voltages(&self, touches: &[Touch]) -> Result<Vec<f64>, LaminateError> {
        if touches.is_empty() {
            return Ok(self.untouched_v.clone());
        }
        self.sheet.frame_v(&self.leaks_s(touches)?)
    }

    /// Pressure in the foam under touches, MPa, by cell of [`Laminate::grid`], and zero far from them.
    ///
    /// # Errors
    /// As [`Laminate::voltages`].
    pub fn pressures_mpa(&self, touches: &[Touch]) -> Result<Vec<f64>, LaminateError> {
        let mut pressures = vec![0.0; self.grid().cells()];
        for patch in self.press(&self.on_skin(touches))? {
            for (cell, pressure_mpa) in patch.pressures_mpa {
                pressures[cell] = pressure_mpa.max(pressures[cell]);
            }
        }
        Ok(pressures)
    }

    /// The squares of the mechanics.
    pub fn grid(&self) -> &press::Grid {
        self.foundation.grid()
    }

    /// Touches that count.
    fn on_skin(&self, touches: &[Touch]) -> Vec<Touch> {
        let size = self.grid().size_mm;
        let counts = |t: &&Touch| {
            t.force_n > 0.0
                && t.force_n.is_finite()
                && t.at_mm.iter().zip(size).all(|(x, size)| (0.0..=size).contains(x))
        };
        touches.iter().filter(counts).copied().collect()
    }

    fn press(&self, touches: &[Touch]) -> Result<Vec<Patch>, LaminateError> {
        let punches: Vec<_> = touches.iter().map(|t| self.foundation.punch(t)).collect();
        self.foundation.press(&punches)
    }

    /// Conductance from each cell of the sheet to the top layer, S.
    fn leaks_s(&self, touches: &[Touch]) -> Result<Vec<f64>, LaminateError> {
        let touches = self.on_skin(touches);
        let mut per_mm2 = self.conductance.untouched().to_vec();
        for patch in self.press(&touches)? {
            let is_unloading = |&p: &usize| touches[p].stroke == Stroke::Unloading;
            let stroke = match patch.punches.iter().any(is_unloading) {
                true => Stroke::Unloading,
                false => Stroke::Loading,
            };
            for (cell, pressure_mpa) in patch.pressures_mpa {
                let conductance = self.conductance.s_per_mm2(cell, pressure_mpa, stroke);
                per_mm2[cell] = conductance.max(per_mm2[cell]);
            }
        }
        Ok(self.sheet.gather(self.foundation.grid(), &per_mm2))
    }
}
