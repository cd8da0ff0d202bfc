//! The memory of reductions, for the lanes that they run in.
//! Uses: `lane`, `reduce`. Never: a kind of lanes by name.

use std::any::Any;

use super::lane::Lane32;
use super::reduce::ReduceWork;

/// Memory for each kind of lanes that has been used.
#[derive(Default)]
pub(crate) struct LaneWork {
    kinds: Vec<Box<dyn Any + Send + Sync>>,
}

impl LaneWork {
    /// The memory that belongs to these lanes.
    pub(crate) fn of<L: Lane32>(&mut self) -> &mut ReduceWork<L> {
        let found = self.kinds.iter().position(|kind| kind.is::<ReduceWork<L>>());
        let at = found.unwrap_or(self.kinds.len());
        if found.is_none() {
            self.kinds.push(Box::new(ReduceWork::<L>::default()));
        }
        self.kinds[at].downcast_mut().expect("it was found or added by its type")
    }
}
