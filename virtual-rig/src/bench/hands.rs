//! What a person does to the bench with their hands: tips, cables, weights.
//! PURE. Uses: `bench`. Never: registers, wires.

use super::contact::Weight;
use super::{Bench, Peaks};
use crate::config::{ARMS, AxisName};

/// Why the operator's hand was held back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Tips are pressing.
    #[error("tips are pressing: raise z first")]
    Pressing,
    /// More tips than arms.
    #[error("tips must be 0 to 6")]
    Tips,
    /// Fewer cells on their cables than tips, or more than arms.
    #[error("powered must be from tips to 6")]
    Powered,
    /// A weight beside the skin.
    #[error("a weight must stand on the skin")]
    OffSkin,
    /// A weight without weight.
    #[error("a weight's force_n must be positive and at most 1000")]
    Force,
}

impl Bench {
    /// The operator attaches tips to arms 1 to `tips`, and leaves the cells of arms 1 to `powered`
    /// on their cables; only those of the tips if absent.
    pub fn mount(&mut self, tips: usize, powered: Option<usize>) -> Result<(), Refusal> {
        if tips > ARMS {
            return Err(Refusal::Tips);
        }
        let powered = powered.unwrap_or(tips);
        if !(tips..=ARMS).contains(&powered) {
            return Err(Refusal::Powered);
        }
        let pose = self.pose(self.now_s);
        if self.indenter.touches(&pose) {
            return Err(Refusal::Pressing);
        }
        let before = self.indenter.mounted();
        self.indenter.mount(tips);
        if self.indenter.touches(&pose) {
            self.indenter.mount(before);
            return Err(Refusal::Pressing);
        }
        self.powered = powered;
        self.cells.forget();
        Ok(())
    }

    /// The operator puts weights down, in place of those that stood there.
    pub fn place(&mut self, weights: Vec<Weight>) -> Result<(), Refusal> {
        for w in &weights {
            if !self.indenter.on_skin(w.x_mm, w.y_mm) {
                return Err(Refusal::OffSkin);
            }
            if !(w.force_n > 0.0 && w.force_n <= 1000.0) {
                return Err(Refusal::Force);
            }
        }
        self.weights = weights;
        self.load = None;
        self.frames.spoil();
        Ok(())
    }

    /// Forgets the largest force and the deepest z: from now on those that come.
    pub fn clear_peaks(&mut self) {
        let pose = self.pose(self.now_s);
        let forces = self.indenter.forces_n(&pose, self.unloading(pose.z_mm));
        let force_n = forces.iter().copied().fold(0.0, f64::max);
        self.peaks = Peaks { force_n, z_mm: self.drive(AxisName::Z).position(self.now_s) };
    }
}
