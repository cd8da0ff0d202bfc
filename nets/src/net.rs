//! The nets that a recipe can name. A new net is a folder, a module of this crate, and a row here.
//! Uses: the folders of the nets. Never: the parameters of one net, training.

use serde::{Deserialize, Serialize};

use crate::architecture::{Answer, Architecture, Frames};
use crate::input::Input;
use crate::mlp::Mlp;
use crate::points::PointNet;
use crate::recon::ReconNet;
use crate::ridge::{KernelRidge, Ridge};
use crate::transfer::TransferNet;

/// The nets of the paper (V), Point-Net, and those that answer a quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Net {
    /// Real voltages to simulated ones (paper V-A).
    TransferNet(TransferNet),
    /// Simulated voltages to a force map (paper V-B).
    ReconNet(ReconNet),
    /// Real voltages to a force map (paper V-D): Recon-Net's layers on other data.
    EndToEnd(ReconNet),
    /// Voltages to presence and force at each point.
    PointNet(PointNet),
    /// Measured voltages to a quantity.
    Mlp(Mlp),
    /// Voltages to a quantity, to simulated voltages or to a force map, linear.
    Ridge(Ridge),
    /// Voltages to a quantity, to simulated voltages or to a force map, by their likeness to training rows.
    KernelRidge(KernelRidge),
}

impl Net {
    /// The list: of each net its frames and its architecture.
    fn row(&self) -> (Frames, &dyn Architecture) {
        match self {
            Self::TransferNet(net) => (Frames::Measured, net),
            Self::ReconNet(net) => (Frames::Simulated, net),
            Self::EndToEnd(net) => (Frames::Measured, net),
            Self::PointNet(net) => (Frames::Simulated, net),
            Self::Mlp(net) => (Frames::Measured, net),
            Self::Ridge(net) => (net.answers.frames(), net),
            Self::KernelRidge(net) => (net.answers.frames(), net),
        }
    }

    /// What it is to its training.
    pub fn architecture(&self) -> &dyn Architecture {
        self.row().1
    }

    /// Frames that it reads in training.
    pub fn frames(&self) -> Frames {
        self.row().0
    }

    /// Kind of its answers.
    pub fn answer(&self) -> Answer {
        self.architecture().answer()
    }

    /// Normalisation of its frames.
    pub fn input(&self) -> Input {
        self.architecture().input()
    }
}
