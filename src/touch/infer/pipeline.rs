//! The models that serve, by slot, and the methods that are ready with them.
//! Uses: `infer::{slot, methods, registry}`. Never: the store, a change while a frame is answered.

use std::sync::Arc;

use super::answer::Reading;
use super::error::{InferError, InferResult};
use super::maps::{ForceMaps, draw};
use super::methods::exact::{ExactSkin, Tracked};
use super::methods::fast::PointPipeline;
use super::methods::{Frames, Method, Models, ReadyMethod};
use super::quantity::QuantityAnswer;
use super::registry::Model;
use super::slot::Slot;
use crate::learn::task::Reads;

/// The models of all methods, and the nets of quantities; a method without its models returns an error that
/// names them.
#[derive(Debug, Clone, Default)]
pub struct Pipeline {
    models: Models,
    /// At most one net for each quantity.
    quantities: Vec<Arc<Model>>,
}

/// Answers, and the models that determined them.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// One reading per frame.
    pub readings: Vec<Reading>,
    /// Id of the model, or ids joined with `+`; for `exact` that of the calibration, and that of
    /// the Point-Net with its proposals.
    pub model: String,
}

/// Quantities of one frame of a stream, and the nets that determined them.
#[derive(Debug, Clone, PartialEq)]
pub struct AnsweredQuantities {
    /// The answers of all nets.
    pub answer: QuantityAnswer,
    /// Ids of the nets, joined with `+`.
    pub model: String,
}

/// Answer to one frame of a stream, and the models that determined it.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Contacts and, for a net of maps, the map of the frame.
    pub reading: Reading,
    /// Id of the model, as in [`Answered`].
    pub model: String,
}

impl Pipeline {
    /// Returns the pipeline with a net in its slot.
    ///
    /// # Errors
    /// `InferError::OtherTask` if the net does not fit its slot.
    pub fn with(mut self, model: Arc<Model>) -> InferResult<Self> {
        let slot = model.slot();
        match slot {
            Slot::Transfer => self.models.transfer = Some(model),
            Slot::Points => self.models.points = Some(PointPipeline::new(model)?),
            Slot::Map | Slot::Skin => self.models.map = Some(model),
            Slot::Position | Slot::Pattern | Slot::Count | Slot::Force => {
                self = self.without(slot);
                self.quantities.push(model);
            }
        }
        Ok(self)
    }

    /// Returns the pipeline with a skin, or without one.
    pub fn with_skin(mut self, skin: Option<Arc<ExactSkin>>) -> Self {
        self.models.skin = skin;
        self
    }

    /// The skin that serves.
    pub fn skin(&self) -> Option<&Arc<ExactSkin>> {
        self.models.skin.as_ref()
    }

    /// Returns the pipeline with an empty slot.
    pub fn without(mut self, slot: Slot) -> Self {
        match slot {
            Slot::Transfer => self.models.transfer = None,
            Slot::Map => self.models.map = None,
            Slot::Points => self.models.points = None,
            Slot::Skin => self.models.skin = None,
            Slot::Position | Slot::Pattern | Slot::Count | Slot::Force => {
                self.quantities.retain(|net| net.slot() != slot);
            }
        }
        self
    }

    /// Whether a Transfer-Net has a use: an end-to-end net reads measured frames itself.
    pub fn uses_transfer(&self) -> bool {
        let reads = self.models.map.as_ref().map(|map| map.manifest.model.task.reads());
        reads != Some(Reads::Measured)
    }

    /// Returns a method with its models, for measured frames.
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; `Map` if a map does not fit the skin.
    pub fn ready(&self, method: Method) -> InferResult<Box<dyn ReadyMethod>> {
        let mut models = self.models.clone();
        // The Transfer-Net remains promoted while an end-to-end net serves, which does not use it.
        models.transfer = models.transfer.filter(|_| self.uses_transfer());
        let ready = method.ready(&models)?;
        if ready.reads() == Reads::Simulated {
            return Err(InferError::NotServed { method: method.name(), needs: "transfer-net" });
        }
        Ok(ready)
    }

    /// The best method for which models serve, if any.
    pub fn best(&self) -> Option<Method> {
        Method::served().rev().find(|method| self.ready(*method).is_ok())
    }

    /// Answers frames one by one.
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; other variants if a frame cannot be answered.
    pub fn answer(
        &self,
        method: Method,
        frames: &Frames<'_>,
        maps: ForceMaps,
    ) -> InferResult<Answered> {
        let ready = self.ready(method)?;
        let mut readings = ready.read(frames, maps)?;
        let limitation = ready.skin().and_then(|skin| skin.limitation);
        readings.iter_mut().for_each(|reading| reading.notes.extend(limitation.clone()));
        if maps == ForceMaps::With {
            draw(&mut readings, ready.size_mm())?;
        }
        Ok(Answered { readings, model: ready.id() })
    }

    /// Whether nets of quantities serve.
    ///
    /// # Errors
    /// `InferError::NotServed` if none does.
    pub fn has_quantities(&self) -> InferResult<()> {
        match self.quantities.is_empty() {
            true => Err(InferError::NotServed {
                method: "quantities",
                needs: "net of a position, pattern, count or force",
            }),
            false => Ok(()),
        }
    }

    /// Answers the next frame of a stream (V) by all nets of quantities.
    ///
    /// # Errors
    /// `InferError::NotServed` if none serves; `Plan` if the frame is incomplete or not finite.
    pub fn quantities(&self, frame: &[f32]) -> InferResult<AnsweredQuantities> {
        self.has_quantities()?;
        let mut all = QuantityAnswer::default();
        for net in &self.quantities {
            let answers = net.quantities(frame)?;
            all = answers.into_iter().fold(all, QuantityAnswer::and);
        }
        let ids: Vec<&str> = self.quantities.iter().map(|net| net.manifest.id.as_str()).collect();
        Ok(AnsweredQuantities { answer: all, model: ids.join("+") })
    }

    /// Answers the next frame of a stream (V).
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; other variants if the frame cannot be
    /// answered.
    pub fn follow(
        &self,
        method: Method,
        frame: &[f32],
        maps: ForceMaps,
        tracked: &mut Tracked,
    ) -> InferResult<Followed> {
        let ready = self.ready(method)?;
        let mut reading = ready.follow(frame, maps, tracked)?;
        if maps == ForceMaps::With {
            draw(std::slice::from_mut(&mut reading), ready.size_mm())?;
        }
        Ok(Followed { reading, model: ready.id() })
    }
}
