//! The force of each tip as the stage descends: from the mechanics of `press`, not from a fit.
//! Uses: `press`, `laws`, `field`. Never: voltages.
//!
//! The stage's depth is shared by height of the skin, fabric, foam and the spring of the arm:
//! `z = height(place) + offset(arm) + depth(F / s, tilt) + F / k`. The depth at a force is solved once for
//! nominal foam at several tilts; local stiffness s scales all of it. Tips that press together are taken as
//! independent here (rims are 20 mm apart or more); the frame of a load is solved with all of them.

use crate::field::Field;
use crate::laws::Laws;
use crate::press::{Foundation, Punch};
use crate::{LaminateError, Plan, Stroke};

/// Forces at which depths are solved, N.
const FORCES_N: [f64; 15] =
    [0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 7.0, 12.0, 20.0, 32.0, 50.0, 80.0, 160.0];
/// Slopes of a tip at which they are solved.
const SLOPES: [f64; 4] = [0.0, 0.02, 0.04, 0.08];
/// Side of the piece of skin on which they are solved, mm.
const PIECE_MM: f64 = 100.0;

/// Forces of the tips of one rig on one skin.
#[derive(Debug)]
pub struct Forces {
    foundation: Foundation,
    /// Depth at each force, mm, for each slope.
    depths_mm: Vec<Vec<f64>>,
    height: Field,
    arms_mm: Vec<f64>,
    stage: (f64, f64),
    arm_n_per_mm: f64,
    unloading: f64,
}

impl Forces {
    /// Solves the nominal depths and draws the heights of a seed.
    ///
    /// # Errors
    /// `LaminateError` if a law is not valid or the mechanics do not converge.
    pub fn new(plan: &Plan, laws: &Laws, seed: u64) -> Result<Self, LaminateError> {
        laws.check(plan)?;
        let piece = Foundation::nominal(plan, laws, PIECE_MM);
        let depth_mm = |slope: f64, force_n: f64| -> Result<f64, LaminateError> {
            let punch = Punch { at_mm: [PIECE_MM / 2.0; 2], force_n, slope: [slope, 0.0] };
            Ok(piece.press(&[punch])?[0].depths_mm[0])
        };
        let depths_mm = SLOPES
            .iter()
            .map(|&slope| FORCES_N.iter().map(|&force_n| depth_mm(slope, force_n)).collect())
            .collect::<Result<_, _>>()?;
        let stage = &laws.stage;
        Ok(Self {
            foundation: Foundation::new(plan, laws, seed),
            depths_mm,
            height: Field::draw(seed, "height", stage.height_correlation_mm),
            arms_mm: stage.arm_offsets_mm.clone(),
            stage: (stage.height_mm, stage.height_sd_mm),
            arm_n_per_mm: stage.arm_n_per_mm,
            unloading: laws.foam.unloading,
        })
    }

    /// Force of an arm's tip at a place and a depth of the stage below the nominal surface, N, >= 0.
    pub fn force_n(&self, arm: usize, at_mm: [f64; 2], z_mm: f64, stroke: Stroke) -> f64 {
        let (mean_mm, sd_mm) = self.stage;
        let offset_mm = self.arms_mm.get(arm).copied().unwrap_or(0.0);
        let into_mm = z_mm - mean_mm - sd_mm * self.height.at(at_mm) - offset_mm;
        let slope = self.foundation.slope(arm, at_mm);
        let stiffness = self.foundation.stiffness_under(at_mm);
        let tilt = slope[0].hypot(slope[1]);
        let depth_mm =
            |force_n: f64| self.depth_mm(force_n / stiffness, tilt) + force_n / self.arm_n_per_mm;
        // A tilted tip touches with its edge first, above its centre's plane.
        if into_mm <= depth_mm(0.0) {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, 400.0);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if depth_mm(middle) < into_mm { low = middle } else { high = middle }
        }
        let loading_n = 0.5 * (low + high);
        match stroke {
            Stroke::Loading => loading_n,
            Stroke::Unloading => loading_n * (1.0 - self.unloading),
        }
    }

    /// Depth of the centre of a tip at a force, mm, interpolated; a tip without force touches with its edge.
    fn depth_mm(&self, force_n: f64, tilt: f64) -> f64 {
        let at = |depths: &[f64]| {
            let above = FORCES_N.partition_point(|&f| f < force_n).min(FORCES_N.len() - 1);
            let (f0, d0) = match above.checked_sub(1) {
                Some(below) => (FORCES_N[below], depths[below]),
                None => {
                    let rate = (depths[1] - depths[0]) / (FORCES_N[1] - FORCES_N[0]);
                    (0.0, depths[0] - rate * FORCES_N[0])
                }
            };
            d0 + (depths[above] - d0) * (force_n - f0) / (FORCES_N[above] - f0)
        };
        let upper = SLOPES.partition_point(|&s| s < tilt).clamp(1, SLOPES.len() - 1);
        let (a, b) = (SLOPES[upper - 1], SLOPES[upper]);
        let share = ((tilt - a) / (b - a)).clamp(0.0, 1.0);
        (1.0 - share) * at(&self.depths_mm[upper - 1]) + share * at(&self.depths_mm[upper])
    }
}
