//! Force of each tip as a function of the depth of the stage (`docs/references.md`, "Tip forces").
//! Uses: gap, chance, laminate's `Stroke`. Never: the finite elements of the foam (this is a fit to the paper's Table
//! I), voltages.
//!
//! Tip i reaches 5 N at the travel `T_i = mu + c + t_i + o_i` (c per configuration, t_i per tip and
//! place, o_i fixed), after a soft toe `5 N (s / toe)^p`, and then `5 + k (z - T_i)`.
//!
//! **Origin of z.** mu is measured from `travel_starts_above_mm` (1.0) above the surface that a
//! touch-off finds. `z_below_surface_mm` is measured from that surface itself, so the mean of T_i
//! in z is mu - 1.0 = 2.07 mm. A touch-off stops where the first of n attached arms reads 0.5 N,
//! that is at `T_min - toe (1 - 0.1^(1/p))`; with toe 2 mm and p = 1.2 this is 1.71 mm before the T
//! of the earliest tip, and the earliest of n tips is on average (0, .26, .39, .47, .53, .53) mm
//! before the mean for n = 1..6: over the six settings 0.37 mm. 1.71 + 0.37 = 2.07: z = 0 is the
//! surface that touch-offs find, averaged over settings and places. One arm alone finds it 0.37 mm
//! lower, six 0.16 higher.

pub use laminate::Stroke;

use super::chance::{SmoothField, stream};
use super::gap::MechanicsGap;

/// Force at the end of the toe, N.
const TOE_FORCE_N: f64 = 5.0;

/// Position of one tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipPosition {
    /// Index of the arm, 0 to 5.
    pub arm: usize,
    /// Centre of the indenter, skin coordinates, mm.
    pub centre_mm: [f64; 2],
    /// Radius of the circle of tips, mm.
    pub radius_mm: f64,
    /// Centre of the tip, skin coordinates, mm.
    pub tip_mm: [f64; 2],
}

/// The mechanics of one rig on one skin. The unevenness is a smooth function of position: returning
/// within tenths of a millimetre meets the same gap; neighbouring points (17 mm) are nearly
/// independent.
#[derive(Debug, Clone)]
pub struct Mechanics {
    gap: MechanicsGap,
    configuration: SmoothField,
    tips: Vec<SmoothField>,
}

impl Mechanics {
    /// Creates the mechanics of a gap and a seed.
    pub fn new(gap: &MechanicsGap, seed: u64) -> Self {
        let field =
            |name: String| SmoothField::draw(&mut stream(seed, &name), gap.flatness_correlation_mm);
        Self {
            gap: *gap,
            configuration: field("unevenness of configurations".into()),
            tips: (0..gap.tip_offsets_mm.len())
                .map(|arm| field(format!("unevenness under tip {arm}")))
                .collect(),
        }
    }

    /// Depth below the nominal surface at which a tip reaches 5 N, mm.
    pub fn depth_at_5_n_mm(&self, at: &TipPosition) -> f64 {
        let TipPosition { arm, centre_mm: centre, radius_mm, tip_mm: tip } = *at;
        let g = &self.gap;
        let configuration = self.configuration.at([centre[0], centre[1], radius_mm]);
        let under_tip = self.tips.get(arm).map_or(0.0, |field| field.at([tip[0], tip[1], 0.0]));
        g.travel_to_5_n_mm - g.travel_starts_above_mm
            + g.configuration_sd_mm * configuration
            + g.tip_sd_mm * under_tip
            + g.tip_offsets_mm.get(arm).copied().unwrap_or(0.0)
    }

    /// Force of a tip, N, >= 0. `z_below_surface_mm`: how far the stage is below the nominal
    /// surface (see above).
    pub fn force_n(&self, at: &TipPosition, z_below_surface_mm: f64, stroke: Stroke) -> f64 {
        let g = &self.gap;
        let beyond = z_below_surface_mm - self.depth_at_5_n_mm(at);
        let into_toe = beyond + g.toe_mm;
        let loading = if into_toe <= 0.0 {
            0.0
        } else if beyond < 0.0 {
            TOE_FORCE_N * (into_toe / g.toe_mm).powf(g.toe_exponent)
        } else {
            TOE_FORCE_N + g.slope_n_per_mm * beyond
        };
        match stroke {
            Stroke::Loading => loading,
            Stroke::Unloading => loading * (1.0 - g.unloading_softer),
        }
    }
}
