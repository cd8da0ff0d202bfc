//! What serves: the promoted models, put together, changed without a frame lost.
//! Uses: `infer::{registry, maps, points, exact, skins}`, `store` (promotions). Never: HTTP, training.
//!
//! A pipeline is a value that is never changed: who answers holds the one that was there when the
//! frame came; a promotion makes a new one, loaded and warmed, and puts it in its place.

use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};

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
use crate::learn::model_file::NetTask;
use crate::store::{PromotionRow, Store};

/// A place that something is promoted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Slot {
    /// The Transfer-Net of `paper`.
    Transfer,
    /// The net of `paper` that gives maps: a Recon-Net, or an end-to-end net.
    Map,
    /// The Point-Net of `fast`, which also proposes to `exact`.
    Points,
    /// The calibrated skin of `exact`.
    Skin,
}

impl Slot {
    /// All slots.
    pub const ALL: [Self; 4] = [Self::Transfer, Self::Map, Self::Points, Self::Skin];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transfer => "transfer",
            Self::Map => "map",
            Self::Points => "points",
            Self::Skin => "skin",
        }
    }

    /// The slots that a method reads from.
    pub fn used_by(method: Method) -> &'static [Self] {
        match method {
            Method::Paper => &[Self::Transfer, Self::Map],
            Method::Fast => &[Self::Points],
            Method::Exact => &[Self::Points, Self::Skin],
        }
    }

    /// The slot for models of a task.
    pub fn of(task: NetTask) -> Self {
        match task {
            NetTask::Transfer => Self::Transfer,
            NetTask::Recon | NetTask::EndToEnd => Self::Map,
            NetTask::Points => Self::Points,
        }
    }
}

/// What answers for each method; a method that lacks something says what.
#[derive(Debug, Clone, Default)]
pub struct Pipeline {
    transfer: Option<Arc<Model>>,
    map: Option<Arc<Model>>,
    points: Option<PointPipeline>,
    skin: Option<Arc<ExactSkin>>,
}

/// Frames answered, and by what.
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// One for each frame.
    pub readings: Vec<Reading>,
    /// The model's id, or ids with a `+` between; a calibration's for `exact`, and the Point-Net's
    /// that proposes to it.
    pub model: String,
}

impl Pipeline {
    /// With this net in its place.
    pub fn with(mut self, model: Arc<Model>) -> Result<Self, InferError> {
        match Slot::of(model.manifest.model.task) {
            Slot::Transfer => self.transfer = Some(model),
            Slot::Points => self.points = Some(PointPipeline::new(model)?),
            Slot::Map | Slot::Skin => self.map = Some(model),
        }
        Ok(self)
    }

    /// With this skin.
    pub fn with_skin(mut self, skin: Option<Arc<ExactSkin>>) -> Self {
        self.skin = skin;
        self
    }

    /// Without what is in a slot.
    fn without(mut self, slot: Slot) -> Self {
        match slot {
            Slot::Transfer => self.transfer = None,
            Slot::Map => self.map = None,
            Slot::Points => self.points = None,
            Slot::Skin => self.skin = None,
        }
        self
    }

    /// What gives maps.
    pub fn maps(&self, threshold_n: f64) -> Result<MapPipeline, InferError> {
        let lacks = |needs| InferError::NotServed { method: Method::Paper, needs };
        let map = self.map.clone().ok_or_else(|| lacks("recon-net or end-to-end net"))?;
        let transfer = match map.manifest.model.task {
            NetTask::EndToEnd => None,
            _ => Some(self.transfer.clone().ok_or_else(|| lacks("transfer-net"))?),
        };
        MapPipeline::new(transfer, map, threshold_n)
    }

    /// What answers for each point.
    pub fn points(&self) -> Result<&PointPipeline, InferError> {
        let lacks = InferError::NotServed { method: Method::Fast, needs: "point-net" };
        self.points.as_ref().ok_or(lacks)
    }

    /// What fits contacts.
    pub fn exact(&self) -> Result<ExactPipeline, InferError> {
        let lacks = InferError::NotServed { method: Method::Exact, needs: "skin" };
        let skin = self.skin.clone().ok_or(lacks)?;
        Ok(ExactPipeline { skin, points: self.points.clone() })
    }

    /// Answers frames (V, one after the other), each the mean of so many.
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

    /// Answers the next frame of a stream (V), and says which model did.
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

/// What serves now. Clones share it.
#[derive(Clone)]
pub struct Serving {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    models: Registry,
    /// The sensor of this rig.
    sensor: Sensor,
    sensor_text: String,
    skins: Skins,
    current: RwLock<Arc<Pipeline>>,
    /// The slots in which what was promoted before a restart was taken up.
    restored: watch::Sender<Vec<Slot>>,
    /// One change at a time.
    changing: tokio::sync::Mutex<()>,
}

impl Serving {
    /// With nothing promoted yet; [`Self::restore`] takes up what was.
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

    /// The sensor of this rig, as text, and the model that its free simulations are made with.
    pub async fn simulation(
        &self,
        skin: Option<&str>,
    ) -> Result<(String, ForwardModel), InferError> {
        Ok((self.inner.sensor_text.clone(), self.model(skin).await?))
    }

    /// Id of the calibration that serves.
    pub async fn promoted_skin(&self) -> Result<Option<String>, InferError> {
        let promoted = self.promoted().await?;
        let skin = promoted.into_iter().find(|(slot, _)| *slot == Slot::Skin);
        Ok(skin.and_then(|(_, what)| what))
    }

    /// The sensor of this rig.
    pub fn sensor(&self) -> &Sensor {
        &self.inner.sensor
    }

    /// What serves at this moment.
    pub fn current(&self) -> Arc<Pipeline> {
        self.inner.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What serves once all that a method needs of what was promoted before a restart does: seconds
    /// after it, with a skin most of a minute. Without a method: once everything does.
    pub async fn once_restored(&self, method: Option<Method>) -> Arc<Pipeline> {
        let needed = method.map_or(Slot::ALL.as_slice(), Slot::used_by);
        let mut restored = self.inner.restored.subscribe();
        // The sender lives as long as this.
        let _ = restored.wait_for(|up| needed.iter().all(|slot| up.contains(slot))).await;
        self.current()
    }

    /// Takes up what was promoted before a restart. What cannot be loaded is left out and said.
    pub async fn restore(&self) {
        self.take_up().await;
        self.inner.restored.send_replace(Slot::ALL.to_vec());
    }

    async fn take_up(&self) {
        let _one_at_a_time = self.inner.changing.lock().await;
        let promoted = match self.promoted().await {
            Ok(promoted) => promoted,
            Err(error) => return tracing::error!(%error, "what serves is not known"),
        };
        for (slot, what) in promoted {
            if let Some(what) = what
                && let Err(error) = self.put(slot, Some(&what)).await
            {
                tracing::error!(%error, slot = slot.name(), what, "it does not serve");
            }
            self.inner.restored.send_modify(|up| up.push(slot));
        }
    }

    /// What is promoted to each slot.
    pub async fn promoted(&self) -> Result<Vec<(Slot, Option<String>)>, InferError> {
        let rows = self.inner.store.promotions().await?;
        let newest = |slot: Slot| rows.iter().find(|row| row.slot == slot.name());
        Ok(Slot::ALL.map(|slot| (slot, newest(slot).and_then(|row| row.what.clone()))).to_vec())
    }

    /// Everything that was promoted, newest first.
    pub async fn history(&self) -> Result<Vec<PromotionRow>, InferError> {
        Ok(self.inner.store.promotions().await?)
    }

    /// Loads a model, warms it, and lets it serve.
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
        self.put(slot, Some(&what)).await?;
        self.inner.store.promote(slot.name(), (Some(&what), false), who, why).await?;
        Ok(slot)
    }

    /// Lets what served before in a slot serve again; where nothing did, nothing does.
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
        self.put(slot, earlier.as_deref()).await?;
        self.inner.store.promote(slot.name(), (earlier.as_deref(), true), who, why).await?;
        Ok(earlier)
    }

    /// Puts a model or a skin, or nothing, into a slot.
    async fn put(&self, slot: Slot, what: Option<&str>) -> Result<(), InferError> {
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
        *self.inner.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(next);
        Ok(())
    }

    /// Refuses a model of another sensor.
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

    /// The skin of a calibration that is kept here, or the nominal one; the one that serves, if it is
    /// that.
    pub async fn skin(&self, calibration: Option<&str>) -> Result<Arc<ExactSkin>, InferError> {
        if let Some(serves) = &self.current().skin
            && serves.calibration() == calibration
        {
            return Ok(serves.clone());
        }
        self.inner.skins.ready(calibration).await.map(Arc::new)
    }

    /// The model of a calibration that is kept here, or the nominal one.
    pub async fn model(&self, calibration: Option<&str>) -> Result<ForwardModel, InferError> {
        self.inner.skins.model(calibration).await
    }

    /// Keeps a calibration of this sensor; returns its id.
    pub async fn keep_calibration(&self, text: &str) -> Result<String, InferError> {
        self.inner.skins.keep(text)
    }
}

/// Of what served, newest first, and whether it was gone back to: the one to go back to. Going back
/// again goes on back.
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
        // "-a": gone back to a.
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
