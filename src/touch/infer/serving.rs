//! The serving models: the promoted ones, combined, and replaced without losing a frame.
//! Uses: `infer::{registry, maps, points, exact, skins}`, `store` (promotions). Never: HTTP,
//! training.
//!
//! A pipeline is immutable: a caller uses the one that was current when the frame arrived; a
//! promotion builds a new one, loads and warms it, and replaces the current one.

use std::path::Path;
use std::sync::Arc;

use parking_lot::RwLock;
use serde::{Deserialize, Serialize};
use sim_core::forward::ForwardModel;
use sim_core::sensor::Sensor;
use tokio::sync::watch;
use utoipa::ToSchema;

use super::answer::{Method, Reading};
use super::error::InferError;
use super::exact::{ExactPipeline, ExactSkin, Tracked};
use super::maps::{MapPipeline, draw};
use super::points::PointPipeline;
use super::registry::{Model, Registry};
use super::skins::Skins;
use crate::dataset::force_map::peaks::THRESHOLD_N;
use crate::learn::task::NetTask;
use crate::store::{PromotionRow, Store};

/// Slot for promotions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Slot {
    /// The Transfer-Net of `paper`.
    Transfer,
    /// The net of `paper` with force maps as answers: a Recon-Net, or an end-to-end net.
    Map,
    /// The Point-Net of `fast`, which also proposes to `exact`.
    Points,
    /// The calibrated skin of `exact`.
    Skin,
}

impl Slot {
    /// All slots.
    pub const ALL: [Self; 4] = [Self::Transfer, Self::Map, Self::Points, Self::Skin];

    /// Name in commands, requests and the store.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transfer => "transfer",
            Self::Map => "map",
            Self::Points => "points",
            Self::Skin => "skin",
        }
    }

    /// The slots that a method uses.
    pub fn used_by(method: Method) -> &'static [Self] {
        match method {
            Method::Paper => &[Self::Transfer, Self::Map],
            Method::Fast => &[Self::Points],
            Method::Exact => &[Self::Points, Self::Skin],
        }
    }

    /// The slot of models with a task.
    pub fn of(task: NetTask) -> Self {
        match task {
            NetTask::Transfer => Self::Transfer,
            NetTask::Recon | NetTask::EndToEnd => Self::Map,
            NetTask::Points => Self::Points,
        }
    }
}

/// The models of all methods; a method without its models returns an error that names them.
#[derive(Debug, Clone, Default)]
pub struct Pipeline {
    transfer: Option<Arc<Model>>,
    map: Option<Arc<Model>>,
    points: Option<PointPipeline>,
    skin: Option<Arc<ExactSkin>>,
}

/// Answers, and the models that gave them.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// One reading per frame.
    pub readings: Vec<Reading>,
    /// Id of the model, or ids joined with `+`; for `exact` that of the calibration, and that of
    /// the Point-Net with its proposals.
    pub model: String,
}

impl Pipeline {
    /// Returns the pipeline with a net in its slot.
    ///
    /// # Errors
    /// `InferError::OtherTask` if the net does not fit its slot.
    pub fn with(mut self, model: Arc<Model>) -> Result<Self, InferError> {
        match Slot::of(model.manifest.model.task) {
            Slot::Transfer => self.transfer = Some(model),
            Slot::Points => self.points = Some(PointPipeline::new(model)?),
            Slot::Map | Slot::Skin => self.map = Some(model),
        }
        Ok(self)
    }

    /// Returns the pipeline with a skin, or without one.
    pub fn with_skin(mut self, skin: Option<Arc<ExactSkin>>) -> Self {
        self.skin = skin;
        self
    }

    /// Returns the pipeline with an empty slot.
    fn without(mut self, slot: Slot) -> Self {
        match slot {
            Slot::Transfer => self.transfer = None,
            Slot::Map => self.map = None,
            Slot::Points => self.points = None,
            Slot::Skin => self.skin = None,
        }
        self
    }

    /// The pipeline of `paper`.
    ///
    /// # Errors
    /// `InferError::NotServed` if a net is missing; `Map` if the map does not fit the skin.
    pub fn maps(&self, threshold_n: f64) -> Result<MapPipeline, InferError> {
        let lacks = |needs| InferError::NotServed { method: Method::Paper, needs };
        let map = self.map.clone().ok_or_else(|| lacks("recon-net or end-to-end net"))?;
        let transfer = match map.manifest.model.task {
            NetTask::EndToEnd => None,
            _ => Some(self.transfer.clone().ok_or_else(|| lacks("transfer-net"))?),
        };
        MapPipeline::new(transfer, map, threshold_n)
    }

    /// The pipeline of `fast`.
    ///
    /// # Errors
    /// `InferError::NotServed` without a Point-Net.
    pub fn points(&self) -> Result<&PointPipeline, InferError> {
        let lacks = InferError::NotServed { method: Method::Fast, needs: "point-net" };
        self.points.as_ref().ok_or(lacks)
    }

    /// The pipeline of `exact`.
    ///
    /// # Errors
    /// `InferError::NotServed` without a skin.
    pub fn exact(&self) -> Result<ExactPipeline, InferError> {
        let lacks = InferError::NotServed { method: Method::Exact, needs: "skin" };
        let skin = self.skin.clone().ok_or(lacks)?;
        Ok(ExactPipeline { skin, points: self.points.clone() })
    }

    /// Answers frames (V, one after the other), each the mean of `averaged` frames.
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; other variants if a frame cannot be answered.
    pub fn answer(
        &self,
        method: Method,
        frames: &[f32],
        averaged: f64,
        with_map: bool,
    ) -> Result<Answered, InferError> {
        let (mut answered, size_mm) = match method {
            Method::Paper => {
                let maps = self.maps(THRESHOLD_N)?;
                let readings = maps.read(frames, with_map)?;
                return Ok(Answered { readings, model: maps.models().join("+") });
            }
            Method::Fast => {
                let points = self.points()?;
                let (readings, model) = (points.read(frames)?, points.model().into());
                (Answered { readings, model }, points.net().size_mm())
            }
            Method::Exact => {
                let exact = self.exact()?;
                let readings = exact.read(frames, averaged)?;
                (Answered { readings, model: exact.models() }, exact.skin.size_mm())
            }
        };
        if with_map {
            draw(&mut answered.readings, size_mm)?;
        }
        Ok(answered)
    }

    /// Answers the next frame of a stream (V), and returns the id of the models.
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; other variants if the frame cannot be
    /// answered.
    pub fn follow(
        &self,
        method: Method,
        frame: &[f32],
        with_map: bool,
        tracked: &mut Tracked,
    ) -> Result<(Reading, String), InferError> {
        if method == Method::Exact {
            let exact = self.exact()?;
            let mut reading = exact.follow(frame, tracked)?;
            if with_map {
                draw(std::slice::from_mut(&mut reading), exact.skin.size_mm())?;
            }
            return Ok((reading, exact.models()));
        }
        let answered = self.answer(method, frame, 1.0, with_map)?;
        let reading = answered.readings.into_iter().next().unwrap_or_default();
        Ok((reading, answered.model))
    }
}

/// The current pipeline, and its changes. Clones share it.
#[derive(Clone)]
pub struct Serving {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    models: Registry,
    /// Sensor of this rig.
    sensor: Sensor,
    sensor_text: String,
    skins: Skins,
    current: RwLock<Arc<Pipeline>>,
    /// The slots whose promotion before a restart was restored.
    restored: watch::Sender<Vec<Slot>>,
    /// Held during a change: one change at a time.
    changing: tokio::sync::Mutex<()>,
}

impl Serving {
    /// Starts with empty slots; [`Self::restore`] fills them with the earlier promotions.
    pub fn new(
        store: Store,
        models: Registry,
        (sensor, sensor_text): (Sensor, String),
        data: &Path,
    ) -> Self {
        let (current, changing) = (RwLock::default(), tokio::sync::Mutex::default());
        let skins = Skins::new(store.clone(), sensor.clone(), data);
        let restored = watch::Sender::new(Vec::new());
        let inner =
            Inner { store, models, sensor, sensor_text, skins, current, restored, changing };
        Self { inner: Arc::new(inner) }
    }

    /// The sensor of this rig, as text, and the model of its free simulations.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration or its model cannot be built.
    pub async fn simulation(
        &self,
        skin: Option<&str>,
    ) -> Result<(String, ForwardModel), InferError> {
        Ok((self.inner.sensor_text.clone(), self.model(skin).await?))
    }

    /// Id of the promoted calibration.
    ///
    /// # Errors
    /// `InferError::Store` if the store fails.
    pub async fn promoted_skin(&self) -> Result<Option<String>, InferError> {
        let promoted = self.promoted().await?;
        let skin = promoted.into_iter().find(|(slot, _)| *slot == Slot::Skin);
        Ok(skin.and_then(|(_, what)| what))
    }

    /// Sensor of this rig.
    pub fn sensor(&self) -> &Sensor {
        &self.inner.sensor
    }

    /// The current pipeline.
    pub fn current(&self) -> Arc<Pipeline> {
        self.inner.current.read().clone()
    }

    /// Waits until the slots of a method are restored after a restart, and returns the pipeline:
    /// seconds, with a skin most of a minute. Without a method: until all slots are restored.
    pub async fn once_restored(&self, method: Option<Method>) -> Arc<Pipeline> {
        let needed = method.map_or(Slot::ALL.as_slice(), Slot::used_by);
        let mut restored = self.inner.restored.subscribe();
        // `self` owns the sender, so the wait cannot fail.
        let _ = restored.wait_for(|up| needed.iter().all(|slot| up.contains(slot))).await;
        self.current()
    }

    /// Restores the promotions from before a restart. Models that cannot be loaded are skipped and
    /// logged.
    pub async fn restore(&self) {
        self.take_up().await;
        self.inner.restored.send_replace(Slot::ALL.to_vec());
    }

    async fn take_up(&self) {
        let _one_at_a_time = self.inner.changing.lock().await;
        let promoted = match self.promoted().await {
            Ok(promoted) => promoted,
            Err(error) => return tracing::error!(%error, "the promotions could not be read"),
        };
        for (slot, what) in promoted {
            if let Some(what) = what {
                match self.with(slot, Some(&what)).await {
                    Ok(next) => *self.inner.current.write() = next,
                    Err(error) => {
                        let slot = slot.name();
                        tracing::error!(%error, slot, what, "a promotion was not restored");
                    }
                }
            }
            self.inner.restored.send_modify(|up| up.push(slot));
        }
    }

    /// Id of the promoted model or calibration of each slot.
    ///
    /// # Errors
    /// `InferError::Store` if the store fails.
    pub async fn promoted(&self) -> Result<Vec<(Slot, Option<String>)>, InferError> {
        let rows = self.inner.store.promotions().await?;
        let newest = |slot: Slot| rows.iter().find(|row| row.slot == slot.name());
        Ok(Slot::ALL.map(|slot| (slot, newest(slot).and_then(|row| row.what.clone()))).to_vec())
    }

    /// All promotions, newest first.
    ///
    /// # Errors
    /// `InferError::Store` if the store fails.
    pub async fn history(&self) -> Result<Vec<PromotionRow>, InferError> {
        Ok(self.inner.store.promotions().await?)
    }

    /// Loads a model or calibration, warms it, and makes it the serving one of its slot.
    ///
    /// # Errors
    /// `InferError` if it does not exist, does not fit the sensor, or cannot be stored.
    pub async fn promote(
        &self,
        id_or_name: &str,
        who: &str,
        why: Option<&str>,
    ) -> Result<Slot, InferError> {
        let _one_at_a_time = self.inner.changing.lock().await;
        let (slot, what) = if id_or_name.starts_with("cal-") {
            (Slot::Skin, id_or_name.to_owned())
        } else {
            let model = self.inner.models.load(id_or_name).await?;
            (Slot::of(model.manifest.model.task), model.manifest.id.clone())
        };
        // It serves once the promotion is stored, not before.
        let next = self.with(slot, Some(&what)).await?;
        self.inner.store.promote(slot.name(), (Some(&what), false), who, why).await?;
        *self.inner.current.write() = next;
        Ok(slot)
    }

    /// Restores the previous promotion of a slot, which may be empty.
    ///
    /// # Errors
    /// `InferError::NoEarlier` if there is none; other variants if it cannot be loaded or stored.
    pub async fn roll_back(
        &self,
        slot: Slot,
        who: &str,
        why: Option<&str>,
    ) -> Result<Option<String>, InferError> {
        let _one_at_a_time = self.inner.changing.lock().await;
        let rows = self.inner.store.promotions().await?;
        let of_slot = rows.into_iter().filter(|row| row.slot == slot.name());
        let served: Vec<_> = of_slot.map(|row| (row.what, row.rolled_back)).collect();
        let earlier = earlier(&served).ok_or(InferError::NoEarlier(slot.name()))?;
        let next = self.with(slot, earlier.as_deref()).await?;
        self.inner.store.promote(slot.name(), (earlier.as_deref(), true), who, why).await?;
        *self.inner.current.write() = next;
        Ok(earlier)
    }

    /// What serves with a model or a skin in a slot, or with the slot empty.
    async fn with(&self, slot: Slot, what: Option<&str>) -> Result<Arc<Pipeline>, InferError> {
        let current = self.current().as_ref().clone();
        let next = match (slot, what) {
            (slot, None) => current.without(slot),
            (Slot::Skin, Some(id)) => current.with_skin(Some(self.skin(Some(id)).await?)),
            (_, Some(id)) => {
                let model = self.inner.models.load(id).await?;
                self.fits(&model)?;
                current.with(model)?
            }
        };
        Ok(Arc::new(next))
    }

    /// Checks that a model is for this sensor.
    ///
    /// # Errors
    /// `InferError::OtherSensor` if it is not.
    pub fn fits(&self, model: &Model) -> Result<(), InferError> {
        let (facts, sensor) = (&model.manifest.model, &self.inner.sensor);
        let channels = sensor.channels();
        if facts.sensor == sensor.file.name && facts.channels == channels {
            return Ok(());
        }
        Err(InferError::OtherSensor {
            id: model.manifest.id.clone(),
            sensor: facts.sensor.clone(),
            channels: facts.channels,
            here: format!("{} with {channels}", sensor.file.name),
        })
    }

    /// Returns the skin of a stored calibration, or the nominal one; the serving one, if it has
    /// that calibration.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration or the skin cannot be prepared.
    pub async fn skin(&self, calibration: Option<&str>) -> Result<Arc<ExactSkin>, InferError> {
        if let Some(serves) = &self.current().skin
            && serves.calibration() == calibration
        {
            return Ok(serves.clone());
        }
        self.inner.skins.ready(calibration).await.map(Arc::new)
    }

    /// Returns the model of a stored calibration, or the nominal one.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration or the model cannot be built.
    pub async fn model(&self, calibration: Option<&str>) -> Result<ForwardModel, InferError> {
        self.inner.skins.model(calibration).await
    }

    /// Stores a calibration of this sensor; returns its id.
    ///
    /// # Errors
    /// `InferError::Calibration` if it is invalid or of another sensor; `File` if it cannot be
    /// written.
    pub async fn keep_calibration(&self, text: &str) -> Result<String, InferError> {
        self.inner.skins.keep(text)
    }
}

/// The earlier promotion to restore, from the promotions of a slot, newest first, each with whether
/// it was a roll-back. A second roll-back goes one promotion further back.
fn earlier(served: &[(Option<String>, bool)]) -> Option<Option<String>> {
    let mut stack: Vec<&Option<String>> = Vec::new();
    for (what, rolled_back) in served.iter().rev() {
        if *rolled_back {
            stack.pop();
        } else if stack.last() != Some(&what) {
            stack.push(what);
        }
    }
    stack.pop()?;
    Some(stack.pop().cloned().unwrap_or(None))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn going_back_twice_does_not_come_back_and_promoting_again_is_no_going_back() {
        // "-a": rolled back to a.
        let of = |ids: &[&str]| -> Vec<(Option<String>, bool)> {
            let one = |id: &&str| (Some(id.trim_start_matches('-').into()), id.starts_with('-'));
            ids.iter().rev().map(one).collect()
        };
        assert_eq!(earlier(&of(&[])), None);
        assert_eq!(earlier(&of(&["a"])), Some(None));
        assert_eq!(earlier(&of(&["a", "b"])), Some(Some("a".into())));
        assert_eq!(earlier(&of(&["a", "b", "c", "-b"])), Some(Some("a".into())));
        assert_eq!(earlier(&of(&["a", "b", "-a"])), Some(None));
        assert_eq!(earlier(&of(&["a", "b", "a"])), Some(Some("b".into())));
        assert_eq!(earlier(&of(&["a", "b", "a", "-b"])), Some(Some("a".into())));
        assert_eq!(earlier(&of(&["a", "a"])), Some(None));
    }
}
