//! The slots for promotions: each holds a net or a skin that serves.
//! PURE. Uses: `learn::task`. Never: what is in a slot.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::learn::task::{Answers, NetTask};

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
    /// All slots, in the order in which they are listed.
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

    /// What it holds.
    pub fn title(self) -> &'static str {
        match self {
            Self::Transfer => "Transfer-Net",
            Self::Map => "net with force maps",
            Self::Points => "Point-Net",
            Self::Skin => "calibrated skin",
        }
    }

    /// What it is used for, in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Transfer => "measured to simulated voltages",
            Self::Map => "voltages to a force map",
            Self::Points => "candidates of contacts, from which a fit also starts",
            Self::Skin => "the model of this skin, calibrated to a run",
        }
    }

    /// The slot of models with a task; `None`: models of the task do not serve.
    pub fn of(task: NetTask) -> Option<Self> {
        match task.answers() {
            Answers::Frame => Some(Self::Transfer),
            Answers::Map => Some(Self::Map),
            Answers::Points => Some(Self::Points),
            Answers::Quantity(_) => None,
        }
    }
}
