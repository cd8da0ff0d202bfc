//! The exact model as a descent needs it: projected and whitened frames with their slopes.
//! Uses: `jacobian` (one factor for a frame and all its slopes), `basis`. Never: the table of
//! shapes.

use super::basis::Basis;
use super::descent::{DescentWork, EACH, Predict};
use super::shapes::{Place, contact};
use super::whitener::Whitener;
use crate::forward::{Contact, ContactResult, ForwardModel};
use crate::jacobian::JacobianWork;

/// Memory of exact frames and of descents on them.
#[derive(Debug, Default)]
pub(super) struct ExactWork {
    descent: DescentWork,
    memory: Memory,
}

#[derive(Debug, Default)]
struct Memory {
    jacobian: JacobianWork,
    contacts: Vec<Contact>,
    scratch: Vec<f64>,
}

pub(super) struct Exact<'a> {
    model: &'a ForwardModel,
    basis: &'a Basis,
    whitener: &'a Whitener,
    memory: &'a mut Memory,
}

impl ExactWork {
    /// Returns the model on this memory, and the memory of descents.
    pub fn model<'a>(
        &'a mut self,
        model: &'a ForwardModel,
        basis: &'a Basis,
        whitener: &'a Whitener,
    ) -> (Exact<'a>, &'a mut DescentWork) {
        (Exact { model, basis, whitener, memory: &mut self.memory }, &mut self.descent)
    }

    /// The memory of descents.
    pub fn descent(&mut self) -> &mut DescentWork {
        &mut self.descent
    }
}

impl Predict for Exact<'_> {
    fn predict(
        &mut self,
        places: &[Place],
        z: &mut Vec<f64>,
        slopes: &mut Vec<f64>,
    ) -> ContactResult<()> {
        let Memory { jacobian, contacts, scratch } = &mut *self.memory;
        contacts.clear();
        contacts.extend(places.iter().map(|&place| contact(place)));
        let mut at = self.model.linearise(contacts, jacobian)?;
        self.basis.project_frame(at.frame_v(), scratch, z);
        self.basis.project(at.contacts(), slopes);
        let width = z.len();
        for (column, contact) in slopes.chunks_exact_mut(width).skip(2).step_by(EACH).zip(contacts)
        {
            column.iter_mut().for_each(|s| *s *= contact.force_n);
        }
        self.whitener.apply(z);
        self.whitener.apply(slopes);
        Ok(())
    }
}
