//! Positions and forces of the tips: the indenter over the skin.
//! PURE. Uses: `config`, `skin`. Never: time, registers.

use crate::config::{ARMS, Placement, Slot};
use crate::skin::mechanics::{Stroke, TipPosition};
use crate::skin::{AnyMechanics, TipLoad};

/// Height above the nominal surface at which no unevenness lets a tip touch, mm.
const SURELY_CLEAR_MM: f64 = 5.0;

/// Position of the axes, including the backlash of the slot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Machine x, mm.
    pub x_mm: f64,
    /// Machine y, mm.
    pub y_mm: f64,
    /// Machine z, downward, mm.
    pub z_mm: f64,
    /// Radius of the circle of tips, mm.
    pub radius_mm: f64,
}

/// A weight that the operator has placed.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Weight {
    /// x of its centre, skin coordinates, mm.
    pub x_mm: f64,
    /// y of its centre, skin coordinates, mm.
    pub y_mm: f64,
    /// Force of the weight, N.
    pub force_n: f64,
}

/// A load under which the skin is held. Loads with equal bits are equal.
#[derive(Debug, Clone, Default)]
pub struct Load {
    /// Contacts of the load: arms first, then weights.
    pub tips: Vec<TipLoad>,
}

impl PartialEq for Load {
    fn eq(&self, other: &Self) -> bool {
        let bits = |t: &TipLoad| (t.arm, t.stroke, [t.x_mm, t.y_mm, t.force_n].map(f64::to_bits));
        self.tips.len() == other.tips.len()
            && self.tips.iter().zip(&other.tips).all(|(a, b)| bits(a) == bits(b))
    }
}

/// Backlash of the slot: the tips lag when the angle reverses.
#[derive(Debug, Clone, Copy)]
pub struct Play {
    slot: Slot,
    radius_mm: f64,
}

impl Play {
    /// Creates the state of tips at rest at an angle.
    pub fn new(slot: Slot, angle_deg: f64) -> Self {
        Self { slot, radius_mm: slot.radius_at_zero_mm + slot.mm_per_deg * angle_deg }
    }

    /// Radius after a monotonic motion to `angle_deg`, mm: exact after an increasing radius, too
    /// large by up to the backlash after a decreasing one.
    pub fn radius_mm(&self, angle_deg: f64) -> f64 {
        let pushed = self.slot.radius_at_zero_mm + self.slot.mm_per_deg * angle_deg;
        self.radius_mm.clamp(pushed, pushed + self.slot.backlash_mm)
    }

    /// Updates the state with a new angle.
    pub fn follow(&mut self, angle_deg: f64) {
        self.radius_mm = self.radius_mm(angle_deg);
    }
}

/// The multi-point indenter with its attached tips, above the skin.
pub struct Indenter {
    placement: Placement,
    size_mm: [f64; 2],
    surface_z_mm: f64,
    mechanics: AnyMechanics,
    mounted: usize,
    missing: [bool; ARMS],
}

impl Indenter {
    /// Creates an indenter with six tips and the nominal surface at a machine z.
    pub fn new(
        placement: Placement,
        size_mm: [f64; 2],
        surface_z_mm: f64,
        mechanics: AnyMechanics,
    ) -> Self {
        let missing = [false; ARMS];
        Self { placement, size_mm, surface_z_mm, mechanics, mounted: ARMS, missing }
    }

    /// Number of attached tips, on arms 1 to n.
    pub fn mounted(&self) -> usize {
        self.mounted
    }

    /// Attaches tips to arms 1 to n.
    pub fn mount(&mut self, tips: usize) {
        self.mounted = tips.min(ARMS);
    }

    /// Arms whose tip was lost through a fault.
    pub fn missing(&self) -> [bool; ARMS] {
        self.missing
    }

    /// Removes tips from arms, or puts them back.
    pub fn lose(&mut self, missing: [bool; ARMS]) {
        self.missing = missing;
    }

    /// Machine z of the nominal surface, mm.
    pub fn surface_z_mm(&self) -> f64 {
        self.surface_z_mm
    }

    /// Whether a machine z is too high for any tip to touch.
    pub fn surely_clear(&self, z_mm: f64) -> bool {
        self.mounted == 0 || z_mm < self.surface_z_mm - SURELY_CLEAR_MM
    }

    /// Whether a position (skin coordinates, mm) is on the skin.
    pub fn on_skin(&self, at_mm: [f64; 2]) -> bool {
        (0.0..=self.size_mm[0]).contains(&at_mm[0]) && (0.0..=self.size_mm[1]).contains(&at_mm[1])
    }

    fn centre(&self, pose: &Pose) -> [f64; 2] {
        [pose.x_mm - self.placement.origin_x_mm, pose.y_mm - self.placement.origin_y_mm]
    }

    /// Position of an arm's tip, skin coordinates, mm.
    pub fn tip(&self, arm: usize, pose: &Pose) -> [f64; 2] {
        let [x, y] = self.centre(pose);
        let angle = (60.0 * arm as f64).to_radians();
        [x + pose.radius_mm * angle.cos(), y + pose.radius_mm * angle.sin()]
    }

    /// Force on each arm, N; zero on arms without a tip.
    pub fn forces_n(&self, pose: &Pose, stroke: Stroke) -> [f64; ARMS] {
        let mut forces = [0.0; ARMS];
        if self.surely_clear(pose.z_mm) {
            return forces;
        }
        let (centre_mm, below_mm) = (self.centre(pose), pose.z_mm - self.surface_z_mm);
        for (arm, force) in forces.iter_mut().enumerate().take(self.mounted) {
            let tip_mm = self.tip(arm, pose);
            if !self.missing[arm] && self.on_skin(tip_mm) {
                let at = TipPosition { arm, centre_mm, radius_mm: pose.radius_mm, tip_mm };
                *force = self.mechanics.force_n(&at, below_mm, stroke);
            }
        }
        forces
    }

    /// Whether any tip is in contact.
    pub fn touches(&self, pose: &Pose) -> bool {
        self.forces_n(pose, Stroke::Loading).iter().any(|&f| f > 0.0)
    }

    /// Load of the skin: the tips in contact, then the weights.
    pub fn load(&self, pose: &Pose, stroke: Stroke, weights: &[Weight]) -> Load {
        let forces = self.forces_n(pose, stroke);
        let pressing = forces.iter().enumerate().filter(|(_, f)| **f > 0.0);
        let mut tips: Vec<TipLoad> = pressing
            .map(|(arm, &force_n)| {
                let [x_mm, y_mm] = self.tip(arm, pose);
                TipLoad { arm, x_mm, y_mm, force_n, stroke }
            })
            .collect();
        tips.extend(weights.iter().map(|w| TipLoad {
            arm: ARMS,
            x_mm: w.x_mm,
            y_mm: w.y_mm,
            force_n: w.force_n,
            stroke: Stroke::Loading,
        }));
        Load { tips }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOT: Slot = Slot { radius_at_zero_mm: 30.0, mm_per_deg: 1.0, backlash_mm: 0.3 };

    #[test]
    fn the_radius_lags_by_the_play_when_the_angle_turns_back() {
        let mut play = Play::new(SLOT, 0.0);
        play.follow(50.0);
        assert_eq!(play.radius_mm(50.0), 80.0);
        play.follow(49.9);
        assert_eq!(play.radius_mm(49.9), 80.0);
        play.follow(40.0);
        assert_eq!(play.radius_mm(40.0), 70.3);
        play.follow(40.2);
        assert_eq!(play.radius_mm(40.2), 70.3);
        play.follow(41.0);
        assert_eq!(play.radius_mm(41.0), 71.0);
    }

    #[test]
    fn equal_bits_are_equal_loads() {
        let load = |force_n: f64| Load {
            tips: vec![TipLoad { arm: 0, x_mm: 1.0, y_mm: 2.0, force_n, stroke: Stroke::Loading }],
        };
        assert_eq!(load(5.0), load(5.0));
        assert_ne!(load(5.0), load(5.0 + 1e-12));
        assert_ne!(load(5.0), Load::default());
    }
}
