//! Manual actions of a person on the bench: tips, cables, weights.
//! PURE. Uses: `bench`. Never: registers, wires.

use super::contact::Weight;
use super::{Bench, Peaks};
use crate::config::{ARMS, AxisName};

/// Reason why an action of the operator was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum Refusal {
    #[error("tips are pressing: raise z first")]
    Pressing,
    #[error("tips must be 0 to 6")]
    Tips,
    #[error("powered must be from tips to 6")]
    Powered,
    #[error("a weight must be on the skin")]
    OffSkin,
    #[error("a weight's force_n must be positive and at most 1000")]
    Force,
}

impl Bench {
    /// Attaches tips to arms 1 to `tips` and connects the cells of arms 1 to `powered`; absent:
    /// those of the tips.
    ///
    /// # Errors
    /// The numbers are not valid, or tips are in contact.
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

    /// Places weights instead of the present ones.
    ///
    /// # Errors
    /// A weight is off the skin, or its force is not from above 0 to 1000 N.
    pub fn place(&mut self, weights: Vec<Weight>) -> Result<(), Refusal> {
        for w in &weights {
            if !self.indenter.on_skin([w.x_mm, w.y_mm]) {
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

    /// Resets the largest force and the deepest z.
    pub fn clear_peaks(&mut self) {
        let pose = self.pose(self.now_s);
        let forces = self.indenter.forces_n(&pose, self.stroke(pose.z_mm));
        let force_n = forces.iter().copied().fold(0.0, f64::max);
        self.peaks = Peaks { force_n, z_mm: self.drive(AxisName::Z).position(self.now_s) };
    }
}
