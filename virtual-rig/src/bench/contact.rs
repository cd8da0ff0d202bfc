//! Where the tips are and how hard they press: the indenter over the skin.
//! PURE. Uses: `config`, `skin`. Never: time, registers.

use crate::config::{ARMS, Placement, Slot};
use crate::skin::TipLoad;
use crate::skin::mechanics::Mechanics;

/// No unevenness lets a tip touch this far above the nominal surface, mm.
const SURELY_CLEAR_MM: f64 = 5.0;

/// Where the axes stand, with the slot's play taken into account.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Machine x, mm.
    pub x_mm: f64,
    /// Machine y, mm.
    pub y_mm: f64,
    /// Machine z, downward, mm.
    pub z_mm: f64,
    /// Radius of the tips' circle, mm.
    pub radius_mm: f64,
}

/// A weight that the operator has put down.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Weight {
    /// Place from the skin's corner, mm.
    pub x_mm: f64,
    /// Place from the skin's corner, mm.
    pub y_mm: f64,
    /// Its weight, N.
    pub force_n: f64,
}

/// A load that the skin is held under: equal bits are equal loads.
#[derive(Debug, Clone, Default)]
pub struct Load {
    /// What presses, arms first and weights after them.
    pub tips: Vec<TipLoad>,
}

impl PartialEq for Load {
    fn eq(&self, other: &Self) -> bool {
        let bits = |t: &TipLoad| (t.arm, [t.x_mm, t.y_mm, t.force_n].map(f64::to_bits));
        self.tips.len() == other.tips.len()
            && self.tips.iter().zip(&other.tips).all(|(a, b)| bits(a) == bits(b))
    }
}

/// The play of the slot: the tips lag when the angle turns back.
#[derive(Debug, Clone, Copy)]
pub struct Play {
    slot: Slot,
    radius_mm: f64,
}

impl Play {
    /// Tips at rest at an angle.
    pub fn new(slot: Slot, angle_deg: f64) -> Self {
        Self { slot, radius_mm: slot.radius_at_zero_mm + slot.mm_per_deg * angle_deg }
    }

    /// Radius once the angle has gone, without turning on the way, to `angle_deg`: exact after a
    /// growing radius, too large by up to the play after a shrinking one.
    pub fn radius_mm(&self, angle_deg: f64) -> f64 {
        let pushed = self.slot.radius_at_zero_mm + self.slot.mm_per_deg * angle_deg;
        self.radius_mm.clamp(pushed, pushed + self.slot.backlash_mm)
    }

    /// Follows the angle.
    pub fn follow(&mut self, angle_deg: f64) {
        self.radius_mm = self.radius_mm(angle_deg);
    }
}

/// The multi-point indenter with its attached tips, above its skin.
pub struct Indenter {
    placement: Placement,
    size_mm: [f64; 2],
    surface_z_mm: f64,
    mechanics: Mechanics,
    mounted: usize,
    missing: [bool; ARMS],
}

impl Indenter {
    /// Six tips attached, the nominal surface at a machine z.
    pub fn new(
        placement: Placement,
        size_mm: [f64; 2],
        surface_z_mm: f64,
        mechanics: Mechanics,
    ) -> Self {
        let missing = [false; ARMS];
        Self { placement, size_mm, surface_z_mm, mechanics, mounted: ARMS, missing }
    }

    /// Attached tips: arms 1 to n.
    pub fn mounted(&self) -> usize {
        self.mounted
    }

    /// Attaches tips to arms 1 to n.
    pub fn mount(&mut self, tips: usize) {
        self.mounted = tips.min(ARMS);
    }

    /// Arms whose tip has come off.
    pub fn missing(&self) -> [bool; ARMS] {
        self.missing
    }

    /// Takes tips off arms, or puts them back.
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

    /// Whether a place lies on the skin.
    pub fn on_skin(&self, x_mm: f64, y_mm: f64) -> bool {
        (0.0..=self.size_mm[0]).contains(&x_mm) && (0.0..=self.size_mm[1]).contains(&y_mm)
    }

    fn centre(&self, pose: &Pose) -> [f64; 2] {
        [pose.x_mm - self.placement.origin_x_mm, pose.y_mm - self.placement.origin_y_mm]
    }

    /// Place of an arm's tip from the skin's corner, mm.
    pub fn tip(&self, arm: usize, pose: &Pose) -> [f64; 2] {
        let [x, y] = self.centre(pose);
        let angle = (60.0 * arm as f64).to_radians();
        [x + pose.radius_mm * angle.cos(), y + pose.radius_mm * angle.sin()]
    }

    /// Force on each arm, N; zero on the arms without a tip.
    pub fn forces_n(&self, pose: &Pose, unloading: bool) -> [f64; ARMS] {
        let mut forces = [0.0; ARMS];
        if self.surely_clear(pose.z_mm) {
            return forces;
        }
        let (centre, below) = (self.centre(pose), pose.z_mm - self.surface_z_mm);
        for (arm, force) in forces.iter_mut().enumerate().take(self.mounted) {
            let tip = self.tip(arm, pose);
            if !self.missing[arm] && self.on_skin(tip[0], tip[1]) {
                let radius = pose.radius_mm;
                *force = self.mechanics.force_n(arm, centre, radius, tip, below, unloading);
            }
        }
        forces
    }

    /// Whether any tip presses.
    pub fn touches(&self, pose: &Pose) -> bool {
        self.forces_n(pose, false).iter().any(|&f| f > 0.0)
    }

    /// What the skin is under: the pressing tips, then the weights.
    pub fn load(&self, pose: &Pose, unloading: bool, weights: &[Weight]) -> Load {
        let forces = self.forces_n(pose, unloading);
        let pressing = forces.iter().enumerate().filter(|(_, f)| **f > 0.0);
        let mut tips: Vec<TipLoad> = pressing
            .map(|(arm, &force_n)| {
                let [x_mm, y_mm] = self.tip(arm, pose);
                TipLoad { arm, x_mm, y_mm, force_n }
            })
            .collect();
        tips.extend(weights.iter().map(|w| TipLoad {
            arm: ARMS,
            x_mm: w.x_mm,
            y_mm: w.y_mm,
            force_n: w.force_n,
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
        let load =
            |force_n: f64| Load { tips: vec![TipLoad { arm: 0, x_mm: 1.0, y_mm: 2.0, force_n }] };
        assert_eq!(load(5.0), load(5.0));
        assert_ne!(load(5.0), load(5.0 + 1e-12));
        assert_ne!(load(5.0), Load::default());
    }
}
