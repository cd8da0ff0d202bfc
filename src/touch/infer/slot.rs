//! The slots for promotions: each holds a net or a skin that serves.
//! PURE. Uses: `learn::task`. Never: what is in a slot.

use nets::quantity::Quantity;
use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use crate::learn::task::{Answers, NetTask};

/// Slot for promotions.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, VariantArray,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Slot {
    /// The Transfer-Net of `paper`.
    Transfer,
    /// The net of `paper` with force maps as answers: a Recon-Net, or an end-to-end net.
    Map,
    /// The Point-Net of `fast`, which also proposes to `exact`.
    Points,
    /// The calibrated skin of `exact`.
    Skin,
    /// The net that answers the position of the one contact.
    Position,
    /// The net that answers which of the known places are pressed.
    Pattern,
    /// The net that answers the number of contacts.
    Count,
    /// The net that answers the sum of all forces.
    Force,
}

impl Slot {
    /// All slots, in the order in which they are listed.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Name in commands, requests and the store.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Name of the kind of model that it holds, for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Transfer => "Transfer-Net",
            Self::Map => "net with force maps",
            Self::Points => "Point-Net",
            Self::Skin => "calibrated skin",
            Self::Position => "net of the position",
            Self::Pattern => "net of the pattern",
            Self::Count => "net of the count",
            Self::Force => "net of the force",
        }
    }

    /// What it is used for, in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Transfer => "measured to simulated voltages",
            Self::Map => "voltages to a force map",
            Self::Points => "candidates of contacts, from which a fit also starts",
            Self::Skin => "the model of this skin, calibrated to a run",
            Self::Position => "position of one contact, from a whole frame",
            Self::Pattern => "which known places are pressed, from a whole frame",
            Self::Count => "number of contacts, from a whole frame",
            Self::Force => "sum of all forces, from a whole frame",
        }
    }

    /// The slot of models with a task.
    pub fn of(task: NetTask) -> Self {
        match task.answers() {
            Answers::Frame => Self::Transfer,
            Answers::Map => Self::Map,
            Answers::Points => Self::Points,
            Answers::Quantity(Quantity::Position) => Self::Position,
            Answers::Quantity(Quantity::Pattern) => Self::Pattern,
            Answers::Quantity(Quantity::Count) => Self::Count,
            Answers::Quantity(Quantity::Force) => Self::Force,
        }
    }

    /// Whether its nets answer a quantity of a whole frame: no method uses them.
    pub fn is_quantity(self) -> bool {
        matches!(self, Self::Position | Self::Pattern | Self::Count | Self::Force)
    }
}
