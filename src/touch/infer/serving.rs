//! The serving models: the promoted ones, combined, and replaced without losing a frame.
//! Uses: `infer::{registry, pipeline, slot}`, the skins of `exact`, `store` (promotions). Never:
//! HTTP, training.
//!
//! A pipeline is immutable: a caller uses the one that was current when the frame arrived; a
//! promotion builds a new one, loads and warms it, and replaces the current one.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use parking_lot::RwLock;
use sim_core::sensor::Sensor;
use tokio::sync::watch;

use super::error::{InferError, InferResult};
use super::methods::Method;
use super::methods::exact::ExactSkin;
use super::methods::exact::skins::Skins;
use super::pipeline::Pipeline;
use super::registry::Registry;
use super::slot::Slot;
use crate::ids::{CalibrationId, PromotedId};
use crate::store::{NewPromotion, PromotionRow, Store};

/// All promotions, newest first, each with its sensor.
#[derive(Debug, Clone)]
pub struct Promotions(Vec<PromotionRow>);

impl Promotions {
    /// Id of the promoted model or calibration of a sensor's slot; `None` if it is empty.
    pub fn serving(&self, sensor: &str, slot: Slot) -> Option<PromotedId> {
        self.of(sensor, slot).next()?.what.clone()
    }

    /// What a roll-back of a slot restores; `None` if it leaves the slot empty, or if there is nothing to roll back.
    pub fn restores(&self, sensor: &str, slot: Slot) -> Option<PromotedId> {
        self.earlier(sensor, slot).flatten()
    }

    /// The sensors of the promotions, each once.
    pub fn sensors(&self) -> BTreeSet<&str> {
        self.0.iter().filter_map(|row| row.sensor.as_deref()).collect()
    }

    /// The promotions, newest first.
    pub fn into_rows(self) -> Vec<PromotionRow> {
        self.0
    }

    fn earlier(&self, sensor: &str, slot: Slot) -> Option<Option<PromotedId>> {
        let served = self.of(sensor, slot).map(|row| (row.what.clone(), row.rolled_back));
        earlier(&served.collect::<Vec<_>>())
    }

    fn of(&self, sensor: &str, slot: Slot) -> impl Iterator<Item = &PromotionRow> {
        let is_of = move |row: &&PromotionRow| {
            row.slot == slot.name() && row.sensor.as_deref() == Some(sensor)
        };
        self.0.iter().filter(is_of)
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
    sensor: Sensor,
    sensor_text: String,
    skins: Skins,
    current: RwLock<Arc<Pipeline>>,
    /// The skin of the calibration that was named last, also by a request: its preparation takes most of a
    /// minute.
    named: tokio::sync::Mutex<Option<Arc<ExactSkin>>>,
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
        sensor: Sensor,
        sensor_text: String,
        data: &Path,
    ) -> Self {
        let (current, named, changing) =
            (RwLock::default(), tokio::sync::Mutex::default(), tokio::sync::Mutex::default());
        let skins = Skins::new(store.clone(), sensor.clone(), data);
        let restored = watch::Sender::new(Vec::new());
        let inner =
            Inner { store, models, sensor, sensor_text, skins, current, named, restored, changing };
        Self { inner: Arc::new(inner) }
    }

    /// Id of the promoted calibration.
    ///
    /// # Errors
    /// `InferError::Store` if the store fails.
    pub async fn promoted_skin(&self) -> InferResult<Option<CalibrationId>> {
        let promoted = self.promotions().await?.serving(self.rig(), Slot::Skin);
        Ok(promoted.and_then(|what| match what {
            PromotedId::Calibration(id) => Some(id),
            PromotedId::Model(_) => None,
        }))
    }

    /// Name of the sensor of this rig.
    pub fn rig(&self) -> &str {
        &self.inner.sensor.file.name
    }

    /// Sensor of this rig.
    pub fn sensor(&self) -> &Sensor {
        &self.inner.sensor
    }

    /// Text of the file of this rig's sensor.
    pub fn sensor_text(&self) -> &str {
        &self.inner.sensor_text
    }

    /// The calibrations of this rig's sensor, with their models.
    pub fn skins(&self) -> &Skins {
        &self.inner.skins
    }

    /// The current pipeline.
    pub fn current(&self) -> Arc<Pipeline> {
        self.inner.current.read().clone()
    }

    /// Waits until the slots of a method are restored after a restart, and returns the pipeline:
    /// seconds, with a skin most of a minute. Without a method: until all slots are restored.
    pub async fn once_restored(&self, method: Option<Method>) -> Arc<Pipeline> {
        let needed = method.map_or(Slot::ALL, Method::slots);
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
        let promotions = match self.promotions().await {
            Ok(promotions) => promotions,
            Err(error) => return tracing::error!(%error, "the promotions could not be read"),
        };
        for &slot in Slot::ALL {
            if let Some(what) = promotions.serving(self.rig(), slot) {
                match self.with(self.rig(), slot, Some(&what)).await {
                    Ok(next) => *self.inner.current.write() = next,
                    Err(error) => {
                        let slot = slot.name();
                        let what = what.as_str();
                        tracing::error!(%error, slot, what, "a promotion was not restored");
                    }
                }
            }
            self.inner.restored.send_modify(|up| up.push(slot));
        }
    }

    /// All promotions.
    ///
    /// # Errors
    /// `InferError::Store` if the store fails.
    pub async fn promotions(&self) -> InferResult<Promotions> {
        let mut rows = self.inner.store.promotions().await?;
        rows.iter_mut().for_each(|row| row.sensor = row.sensor.take().or(Some(self.rig().into())));
        Ok(Promotions(rows))
    }

    /// Loads a model or calibration, warms it, and makes it the serving one of the slot of its sensor. Returns both.
    ///
    /// A model of another sensor than the rig's answers requests that name its slot and sensor (`registry`).
    ///
    /// # Errors
    /// `InferError` if it does not exist, has other channels than the sensor, or cannot be stored.
    pub async fn promote(
        &self,
        id_or_name: &str,
        who: &str,
        why: Option<&str>,
    ) -> InferResult<(String, Slot)> {
        // A name that does not exist is refused at once, also while the promotions before a restart are restored.
        let (sensor, slot, what) = if let Ok(id) = id_or_name.parse::<CalibrationId>() {
            self.inner.skins.stored(&id)?;
            (self.rig().to_owned(), Slot::Skin, PromotedId::Calibration(id))
        } else {
            let model = self.inner.models.load(id_or_name).await?;
            let facts = &model.manifest;
            (facts.model.sensor.clone(), model.slot(), PromotedId::Model(facts.id.clone()))
        };
        let _one_at_a_time = self.inner.changing.lock().await;
        // It serves once the promotion is stored, not before.
        let next = self.with(&sensor, slot, Some(&what)).await?;
        let (name, what) = (slot.name(), Some(&what));
        let new = NewPromotion { slot: name, sensor: &sensor, what, rolled_back: false, who, why };
        self.inner.store.promote(new).await?;
        *self.inner.current.write() = next;
        Ok((sensor, slot))
    }

    /// Restores the previous promotion of the slot of a sensor, which may be empty.
    ///
    /// # Errors
    /// `InferError::NoEarlier` if there is none; other variants if it cannot be loaded or stored.
    pub async fn roll_back(
        &self,
        sensor: &str,
        slot: Slot,
        who: &str,
        why: Option<&str>,
    ) -> InferResult<()> {
        let _one_at_a_time = self.inner.changing.lock().await;
        let earlier = self.promotions().await?.earlier(sensor, slot);
        let earlier = earlier.ok_or(InferError::NoEarlier(slot.name()))?;
        let next = self.with(sensor, slot, earlier.as_ref()).await?;
        let (name, what) = (slot.name(), earlier.as_ref());
        let new = NewPromotion { slot: name, sensor, what, rolled_back: true, who, why };
        self.inner.store.promote(new).await?;
        *self.inner.current.write() = next;
        Ok(())
    }

    /// What serves on the rig with a model or a skin in the slot of a sensor, or with the slot empty.
    async fn with(
        &self,
        sensor: &str,
        slot: Slot,
        what: Option<&PromotedId>,
    ) -> InferResult<Arc<Pipeline>> {
        let current = self.current().as_ref().clone();
        let next = match what {
            Some(PromotedId::Model(id)) if sensor != self.rig() => {
                self.inner.models.load(id.as_str()).await?;
                current
            }
            _ if sensor != self.rig() => current,
            None => current.without(slot),
            Some(PromotedId::Calibration(id)) => {
                current.with_skin(Some(self.skin(Some(id)).await?))
            }
            Some(PromotedId::Model(id)) => {
                let model = self.inner.models.load(id.as_str()).await?;
                let sensor = &self.inner.sensor;
                model.is_for(&sensor.file.name, sensor.channels())?;
                current.with(model)?
            }
        };
        Ok(Arc::new(next))
    }

    /// Returns the skin of a stored calibration, or the nominal one; the serving one or the last one that
    /// a caller named, if it has that calibration. One is prepared at a time.
    ///
    /// # Errors
    /// `InferError` if there is no such calibration or the skin cannot be prepared.
    pub async fn skin(&self, calibration: Option<&CalibrationId>) -> InferResult<Arc<ExactSkin>> {
        if let Some(serves) = self.current().skin()
            && serves.calibration() == calibration
        {
            return Ok(serves.clone());
        }
        let mut named = self.inner.named.lock().await;
        // The nominal skin has the errors of the newest run, which may be another one now.
        let is_named =
            |skin: &&Arc<ExactSkin>| calibration.is_some() && skin.calibration() == calibration;
        if let Some(skin) = named.as_ref().filter(is_named) {
            return Ok(skin.clone());
        }
        let skin = Arc::new(self.inner.skins.ready(calibration).await?);
        *named = Some(skin.clone()).filter(|_| calibration.is_some());
        Ok(skin)
    }
}

/// The earlier promotion to restore, from the promotions of a slot, newest first, each with whether
/// it was a roll-back. A second roll-back goes one promotion further back.
fn earlier(served: &[(Option<PromotedId>, bool)]) -> Option<Option<PromotedId>> {
    let mut stack: Vec<&Option<PromotedId>> = Vec::new();
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
    use std::time::Duration;

    use super::*;
    use crate::clock::Clock;

    const SENSOR: &str = include_str!("../../../experiments/sensors/ert-28.toml");

    #[tokio::test]
    async fn an_unknown_name_is_refused_while_earlier_promotions_load() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path();
        let store = Store::open(&data.join("palpate.db"), Clock::new(1.0)).await.unwrap();
        let models = Registry::open(store.clone(), data, Clock::new(1.0)).unwrap();
        let sensor = Sensor::from_toml(SENSOR).unwrap();
        let serving = Serving::new(store.clone(), models, sensor, SENSOR.into(), data);
        let _loading = serving.inner.changing.lock().await;
        for (name, words) in [("net", "no model net: "), ("cal-00", "no calibration cal-00: ")] {
            let promotion = serving.promote(name, "Ada", None);
            let refused = tokio::time::timeout(Duration::from_secs(60), promotion).await.unwrap();
            assert!(refused.unwrap_err().to_string().starts_with(words), "{name}");
        }
        store.close().await;
    }

    #[test]
    fn going_back_twice_does_not_come_back_and_promoting_again_is_no_going_back() {
        // "-a": rolled back to a.
        let id = |text: &str| PromotedId::from(text.to_owned());
        let of = |ids: &[&str]| -> Vec<(Option<PromotedId>, bool)> {
            let one = |text: &&str| (Some(id(text.trim_start_matches('-'))), text.starts_with('-'));
            ids.iter().rev().map(one).collect()
        };
        assert_eq!(earlier(&of(&[])), None);
        assert_eq!(earlier(&of(&["a"])), Some(None));
        assert_eq!(earlier(&of(&["a", "b"])), Some(Some(id("a"))));
        assert_eq!(earlier(&of(&["a", "b", "c", "-b"])), Some(Some(id("a"))));
        assert_eq!(earlier(&of(&["a", "b", "-a"])), Some(None));
        assert_eq!(earlier(&of(&["a", "b", "a"])), Some(Some(id("b"))));
        assert_eq!(earlier(&of(&["a", "b", "a", "-b"])), Some(Some(id("a"))));
        assert_eq!(earlier(&of(&["a", "a"])), Some(None));
    }
}
