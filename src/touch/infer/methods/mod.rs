//! The methods from a frame to contacts, one folder each, their list, and their common parts.
//! Uses: `infer::{answer, maps, registry, slot, untouched_frame}`. Never: what serves (`pipeline`), HTTP.

pub mod paper;
pub mod fast;
pub mod exact;
pub mod one_step;

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sim_core::forward::ForwardModel;
use sim_core::inverse::linear::Regularisation;
use strum::IntoStaticStr;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use self::exact::{ExactPipeline, ExactSkin, Tracked};
use self::fast::PointPipeline;
use self::one_step::OneStepPipeline;
use self::paper::MapPipeline;
use super::answer::Reading;
use super::error::{InferError, InferResult};
use super::maps::{ForceMaps, MAP_1};
use super::registry::Model;
use super::slot::Slot;
use super::untouched_frame::UntouchedBefore;
use crate::dataset::force_map::ForceMapSpec;
use crate::dataset::force_map::peaks::THRESHOLD_N;
use crate::ids::CalibrationId;
use crate::learn::task::Reads;

/// Method from frames to contacts. As JSON and in `openapi.yaml`: one that serves; evaluations read
/// all (`evaluate::request::Scored`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, IntoStaticStr)]
#[serde(try_from = "String", into = "&'static str")]
#[strum(serialize_all = "lowercase")]
pub enum Method {
    /// The paper's method: Transfer-Net, Recon-Net, peaks of the map (V-C).
    Paper,
    /// Candidates of Point-Net.
    Fast,
    /// Contacts fitted to the frame through the exact model.
    Exact,
    /// Peaks of the one-step reconstruction with Tikhonov's regularisation.
    Tikhonov,
    /// Peaks of the one-step reconstruction with NOSER's.
    Noser,
}

/// A row of the list of methods.
struct Row {
    about: &'static str,
    /// Slots that it uses.
    slots: &'static [Slot],
    /// Slots whose model an evaluation must name. A skin that is not named is the serving one.
    named: &'static [Slot],
    serves: bool,
}

/// Models for a method. It uses those of its slots.
#[derive(Debug, Clone, Default)]
pub struct Models {
    /// A Transfer-Net.
    pub transfer: Option<Arc<Model>>,
    /// A net with force maps as answers.
    pub map: Option<Arc<Model>>,
    /// A Point-Net.
    pub points: Option<PointPipeline>,
    /// A skin that is ready for fits.
    pub skin: Option<Arc<ExactSkin>>,
    /// The exact model of a skin, for methods that use the skin without fits.
    pub forward: Option<Arc<ForwardModel>>,
    /// Least force of a peak, N; that of the method if absent.
    pub threshold_n: Option<f64>,
}

impl Method {
    /// All methods; those that serve in the order of their quality, the best last.
    pub const ALL: [Self; 5] = [Self::Paper, Self::Fast, Self::Exact, Self::Tikhonov, Self::Noser];

    /// The list of methods. Commands, HTTP, evaluations and `openapi.yaml` follow from it.
    fn row(self) -> Row {
        use Slot::{Map, Points, Skin, Transfer};
        match self {
            Self::Paper => Row {
                about: "the paper's: Transfer-Net, Recon-Net, peaks of the force map",
                slots: &[Transfer, Map],
                named: &[Map],
                serves: true,
            },
            Self::Fast => Row {
                about: "candidates of Point-Net",
                slots: &[Points],
                named: &[Points],
                serves: true,
            },
            Self::Exact => Row {
                about: "contacts fitted to the frame through the exact model",
                slots: &[Points, Skin],
                named: &[],
                serves: true,
            },
            Self::Tikhonov => Row {
                about: "peaks of the one-step reconstruction with Tikhonov's regularisation",
                slots: &[Skin],
                named: &[],
                serves: false,
            },
            Self::Noser => Row {
                about: "peaks of the one-step reconstruction with NOSER's regularisation",
                slots: &[Skin],
                named: &[],
                serves: false,
            },
        }
    }

    /// Returns the method with its models, for serving and for evaluations. Takes up to about 1 s.
    ///
    /// # Errors
    /// `InferError::NotServed` if a model is missing; `Problems` if a model has no use, `OtherTask`
    /// if it has another task; `Map` if a map does not fit the skin.
    pub fn ready(self, models: &Models) -> InferResult<Box<dyn ReadyMethod>> {
        let lacks = |needs| InferError::NotServed { method: self.name(), needs };
        let one_step = |kind| {
            let model = models.forward.as_ref().ok_or_else(|| lacks("skin"))?;
            OneStepPipeline::new(model, kind, models.threshold_n.unwrap_or(THRESHOLD_N))
        };
        Ok(match self {
            Self::Paper => {
                let map = models.map.clone().ok_or_else(|| lacks("recon-net or end-to-end net"))?;
                Box::new(MapPipeline::new(models.transfer.clone(), map, models.threshold_n)?)
            }
            Self::Fast => Box::new(models.points.clone().ok_or_else(|| lacks("point-net"))?),
            Self::Exact => {
                let skin = models.skin.clone().ok_or_else(|| lacks("skin"))?;
                Box::new(ExactPipeline { skin, points: models.points.clone() })
            }
            Self::Tikhonov => Box::new(one_step(Regularisation::Tikhonov)?),
            Self::Noser => Box::new(one_step(Regularisation::Noser)?),
        })
    }

    /// The methods that serve, the best last.
    pub fn served() -> impl DoubleEndedIterator<Item = Self> {
        Self::ALL.into_iter().filter(|method| method.serves())
    }

    /// The method by which a model of a slot answers if no method is named; `None` for quantities.
    pub fn of(slot: Slot) -> Option<Self> {
        match slot {
            Slot::Transfer | Slot::Map => Some(Self::Paper),
            Slot::Points => Some(Self::Fast),
            Slot::Skin => Some(Self::Exact),
            Slot::Position | Slot::Pattern | Slot::Count | Slot::Force => None,
        }
    }

    /// The method of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }

    /// Name in commands and answers.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Description in one line.
    pub fn about(self) -> &'static str {
        self.row().about
    }

    /// The slots that it uses.
    pub fn slots(self) -> &'static [Slot] {
        self.row().slots
    }

    /// The slots whose model an evaluation must name.
    pub fn named_slots(self) -> &'static [Slot] {
        self.row().named
    }

    /// The slots without which it has no answer.
    pub fn needs(self) -> impl Iterator<Item = Slot> {
        let needs = move |slot: &Slot| self.named_slots().contains(slot) || *slot == Slot::Skin;
        self.slots().iter().copied().filter(needs)
    }

    /// Whether it serves live contacts; all methods can be evaluated.
    pub fn serves(self) -> bool {
        self.row().serves
    }

    /// Whether contacts are fitted: an answer takes a tenth of a second instead of milliseconds.
    pub fn is_fit(self) -> bool {
        self == Self::Exact
    }
}

/// No method of this name serves.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "method = {name}: must be one of {}",
    Method::served().map(Method::name).collect::<Vec<_>>().join(", "),
    name = .0,
)]
pub struct UnknownMethod(String);

impl TryFrom<String> for Method {
    type Error = UnknownMethod;

    fn try_from(name: String) -> Result<Self, UnknownMethod> {
        Self::served().find(|method| method.name() == name).ok_or(UnknownMethod(name))
    }
}

impl PartialSchema for Method {
    fn schema() -> RefOr<Schema> {
        names("Method from frames to contacts.", Self::served().map(Self::name).collect())
    }
}

impl ToSchema for Method {}

/// Schema of one of several names.
pub fn names(about: &str, names: Vec<&'static str>) -> RefOr<Schema> {
    let schema = ObjectBuilder::new().schema_type(Type::String).description(Some(about));
    schema.enum_values(Some(names)).into()
}

/// The exact model of a skin that a method uses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsedSkin<'a> {
    /// Id of the model in messages.
    pub id: &'a str,
    /// Id of its calibration, if any.
    pub calibration: Option<&'a CalibrationId>,
    /// Id of the run that it was calibrated to, if known.
    pub run: Option<&'a str>,
    /// What limits its answers, if anything is known to.
    pub limitation: Option<String>,
}

/// Frames that are read one by one.
#[derive(Debug, Clone, Copy)]
pub struct Frames<'a> {
    /// Voltages, V, one frame after the other.
    pub voltages_v: &'a [f32],
    /// Number of frames that each of them is the mean of, >= 1.
    pub averaged: f64,
    /// The untouched skin before them, if it was measured.
    pub untouched: Option<&'a UntouchedBefore>,
}

impl<'a> Frames<'a> {
    /// Single frames, with the offsets of the calibration.
    pub fn single(voltages_v: &'a [f32]) -> Self {
        Self { voltages_v, averaged: 1.0, untouched: None }
    }
}

/// A method with its models, ready to read frames.
pub trait ReadyMethod: Send + Sync {
    /// Reads frames; `maps`: whether to keep the method's own maps, if it has maps.
    ///
    /// # Errors
    /// `InferError` if a frame cannot be answered.
    fn read(&self, frames: &Frames<'_>, maps: ForceMaps) -> InferResult<Vec<Reading>>;

    /// Reads the next frame of a stream (V).
    ///
    /// # Errors
    /// `InferError` if the frame cannot be answered.
    fn follow(
        &self,
        frame: &[f32],
        maps: ForceMaps,
        _tracked: &mut Tracked,
    ) -> InferResult<Reading> {
        Ok(self.read(&Frames::single(frame), maps)?.into_iter().next().unwrap_or_default())
    }

    /// Its nets, in the order of use.
    fn nets(&self) -> Vec<&Model>;

    /// Id in answers: those of its nets, joined with `+`, if it does not state another.
    fn id(&self) -> String {
        let ids: Vec<&str> = self.nets().iter().map(|net| net.manifest.id.as_str()).collect();
        ids.join("+")
    }

    /// The exact model that it uses, if any.
    fn skin(&self) -> Option<UsedSkin<'_>> {
        None
    }

    /// Whether it takes the offsets of the readout from the untouched skin.
    fn takes_untouched(&self) -> bool {
        false
    }

    /// Frames that it reads.
    fn reads(&self) -> Reads {
        Reads::Measured
    }

    /// Layout of its maps, or of the map in which its contacts are drawn.
    fn map(&self) -> ForceMapSpec {
        MAP_1
    }

    /// Least force of a peak of this map, N.
    fn threshold_n(&self) -> f64 {
        THRESHOLD_N
    }

    /// Width and height of the skin, mm.
    fn size_mm(&self) -> [f64; 2];
}
