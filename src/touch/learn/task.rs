//! The tasks of nets: what a net reads and answers. Manifests, slots and training follow from it.
//! PURE. Uses: the names of a dataset's columns, the layout of a map. Never: a net, a file.

use nets::architecture::{Answer as NetAnswer, Frames as NetFrames};
use serde::{Deserialize, Serialize};

use super::examples::{MEASURED, SIMULATED};
use super::model_file::SensorFacts;
use crate::dataset::force_map::ForceMapSpec;

/// Task of a net (paper, section V).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NetTask {
    /// Measured voltages to simulated ones (Transfer-Net).
    Transfer,
    /// Simulated voltages to a force map (Recon-Net).
    Recon,
    /// Measured voltages to a force map.
    EndToEnd,
    /// Voltages to presence (logit) and log-force of a contact at each point of the sensor.
    Points,
}

/// Frames that a net reads when it serves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reads {
    /// Measured ones.
    Measured,
    /// Simulated ones, or measured ones through a Transfer-Net.
    Simulated,
}

/// Answer of a net to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answers {
    /// A simulated frame.
    Frame,
    /// A force map.
    Map,
    /// Presence and force at each point.
    Points,
}

/// A row of the list of tasks.
struct Row {
    name: &'static str,
    reads: Reads,
    answers: Answers,
    /// Columns of a dataset that it is trained on, in the order of input and target.
    columns: &'static [&'static str],
}

const SIMULATED_VOLTAGES: [&str; 2] = ["voltages_v_sim", "simulated voltages, V, injection-major"];

impl NetTask {
    /// The list of tasks.
    fn row(self) -> Row {
        use Reads::{Measured, Simulated};
        let row = |name, reads, answers, columns| Row { name, reads, answers, columns };
        match self {
            Self::Transfer => row("transfer", Measured, Answers::Frame, &[MEASURED, SIMULATED]),
            Self::Recon => row("recon", Simulated, Answers::Map, &[SIMULATED]),
            Self::EndToEnd => row("end-to-end", Measured, Answers::Map, &[MEASURED]),
            Self::Points => row("points", Measured, Answers::Points, &[SIMULATED]),
        }
    }

    /// The task of a net of a recipe.
    pub fn of(net: &nets::net::Net) -> Self {
        match (net.answer(), net.frames()) {
            (NetAnswer::Frame, _) => Self::Transfer,
            (NetAnswer::Map { .. }, NetFrames::Simulated) => Self::Recon,
            (NetAnswer::Map { .. }, NetFrames::Measured) => Self::EndToEnd,
            (NetAnswer::Points, _) => Self::Points,
        }
    }

    /// Name of the task in manifests.
    pub fn as_str(self) -> &'static str {
        self.row().name
    }

    /// Frames that the net reads when it serves.
    pub fn reads(self) -> Reads {
        self.row().reads
    }

    /// Kind of the answer.
    pub fn answers(self) -> Answers {
        self.row().answers
    }

    /// Whether the answer is a force map.
    pub fn gives_map(self) -> bool {
        self.answers() == Answers::Map
    }

    /// Columns of a dataset that the net is trained on, in the order of input and target.
    pub fn columns(self) -> &'static [&'static str] {
        self.row().columns
    }

    /// Name of the input tensor, and its description.
    pub fn input(self) -> [&'static str; 2] {
        match self.reads() {
            Reads::Simulated => SIMULATED_VOLTAGES,
            Reads::Measured => ["voltages_v", "measured voltages, V, injection-major"],
        }
    }

    /// Name of the output tensor, and its description.
    pub fn output(self) -> [&'static str; 2] {
        match self.answers() {
            Answers::Frame => SIMULATED_VOLTAGES,
            Answers::Map => {
                ["force_map_n", "newtons per pixel, row = y, column = x, row 0 at the lowest y"]
            }
            Answers::Points => ["points", "logit of a contact, and ln(force / N), at each point"],
        }
    }

    /// Shape of one answer for a sensor; `None` if it depends on a map that is not stated.
    pub fn output_shape(
        self,
        sensor: &SensorFacts,
        map: Option<ForceMapSpec>,
    ) -> Option<Vec<usize>> {
        match self.answers() {
            Answers::Frame => Some(vec![sensor.channels]),
            Answers::Map => map.map(|map| vec![map.pixels(); 2]),
            Answers::Points => Some(vec![2, sensor.points]),
        }
    }
}
