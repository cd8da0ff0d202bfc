//! Conductance from the sheet through the foam to the top layer, as a law of the local pressure.
//! Uses: `laws`, `field`. Never: compression, forces.

use crate::Stroke;
use crate::field::{Field, normal, stream};
use crate::laws::{ConductanceLaw, Laws};
use crate::press::Grid;

/// Conductance of each cell as a function of its pressure.
#[derive(Debug)]
pub struct Conductance {
    law: ConductanceLaw,
    series_ohm_mm2: f64,
    unloading: f64,
    factors: Vec<f64>,
    untouched: Vec<f64>,
}

impl Conductance {
    /// Draws the factors of a seed on the law, one for each cell.
    pub fn new(laws: &Laws, seed: u64, grid: &Grid) -> Self {
        let foam = &laws.conductance;
        let smooth = Field::draw(seed, "conductance", foam.correlation_mm);
        let mut rng = stream(seed, "conductance of cells");
        let factors: Vec<f64> = (0..grid.cells())
            .map(|cell| {
                (foam.ln_sd * smooth.at(grid.centre_mm(cell)) + foam.ln_cell_sd * normal(&mut rng))
                    .exp()
            })
            .collect();
        let untouched = factors.iter().map(|factor| factor * foam.untouched_s_per_mm2).collect();
        let (law, series_ohm_mm2) = (foam.law, foam.series_ohm_mm2);
        Self { law, series_ohm_mm2, unloading: foam.unloading, factors, untouched }
    }

    /// Conductance of each cell without load, S/mm^2.
    pub fn untouched(&self) -> &[f64] {
        &self.untouched
    }

    /// Conductance of a cell under a pressure, S/mm^2. While unloading, contacts that have formed remain:
    /// the conductance is larger at the same pressure.
    pub fn s_per_mm2(&self, cell: usize, pressure_mpa: f64, stroke: Stroke) -> f64 {
        let pressure_mpa = pressure_mpa.max(0.0);
        let contacts = match self.law {
            ConductanceLaw::Power { s_per_mm2_at_1_mpa, exponent } => {
                s_per_mm2_at_1_mpa * pressure_mpa.powf(exponent)
            }
            ConductanceLaw::Percolation { s_per_mm2_at_1_mpa, threshold_mpa, exponent } => {
                // Smooth at the threshold: some paths form before it.
                let above = 0.5
                    * ((pressure_mpa - threshold_mpa)
                        + (pressure_mpa - threshold_mpa).hypot(0.5 * threshold_mpa));
                let at_rest = 0.5 * (1.25f64.sqrt() - 1.0) * threshold_mpa;
                s_per_mm2_at_1_mpa * (above.powf(exponent) - at_rest.powf(exponent)).max(0.0)
            }
        };
        let kept = match stroke {
            Stroke::Loading => 1.0,
            Stroke::Unloading => 1.0 + self.unloading,
        };
        let formed = self.factors[cell] * kept * contacts;
        self.untouched[cell] + formed / (1.0 + formed * self.series_ohm_mm2)
    }
}
