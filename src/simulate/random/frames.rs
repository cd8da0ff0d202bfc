//! Frames of many trials at once, in f32.
//! Uses: sim-core's exact forward model. Never: chance, files.

use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};

/// The frames of a model.
#[derive(Debug, Clone, Copy)]
pub struct Frames<'a>(&'a ForwardModel);

/// Memory of a thread that makes frames.
#[derive(Debug, Default)]
pub struct FramesWork(Workspace);

impl<'a> Frames<'a> {
    /// Frames of this model.
    pub fn new(model: &'a ForwardModel) -> Self {
        Self(model)
    }

    /// Name of the arithmetic.
    pub fn kernel() -> &'static str {
        "f64"
    }

    /// Writes the frame of each trial to `out_v`, V: channels x trials.
    pub fn voltages(
        &self,
        trials: &[&[Contact]],
        out_v: &mut [f32],
        work: &mut FramesWork,
    ) -> Result<(), ContactError> {
        let channels = self.0.sensor().channels();
        for (contacts, out_v) in trials.iter().zip(out_v.chunks_exact_mut(channels)) {
            let frame_v = self.0.voltages(contacts, &mut work.0)?;
            for (out, v) in out_v.iter_mut().zip(frame_v) {
                *out = *v as f32;
            }
        }
        Ok(())
    }
}
