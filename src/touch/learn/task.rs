//! The tasks of nets: what a net reads and answers. Manifests, slots and training follow from it.
//! PURE. Uses: the names of a dataset's columns, the layout of a map. Never: a net, a file.

use nets::architecture::Answer as NetAnswer;
pub use nets::architecture::Frames as Reads;
use nets::quantity::Quantity;
use serde::{Deserialize, Serialize};
use strum::VariantArray;

use crate::dataset::force_map::ForceMapSpec;
use crate::dataset::schema::VOLTAGES_V;
use crate::simulate::schema::SIM_VOLTAGES_V;

/// Column of measured frames.
pub const MEASURED: &str = VOLTAGES_V;
/// Column of simulated frames.
pub const SIMULATED: &str = SIM_VOLTAGES_V;

/// Task of a net (paper, section V).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, VariantArray)]
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
    /// Measured voltages to the position of the one contact.
    Position,
    /// Measured voltages to the pressed ones of known places.
    Pattern,
    /// Measured voltages to the number of contacts.
    Count,
    /// Measured voltages to the sum of the contacts' forces.
    Force,
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
    /// Few numbers for a whole frame.
    Quantity(Quantity),
}

/// Facts of a sensor that a model must match.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SensorFacts {
    /// Name of the sensor.
    pub name: String,
    /// Number of values in a frame.
    pub channels: usize,
    /// Number of points of its lattice; 0 without a lattice.
    pub points: usize,
}

impl From<Quantity> for NetTask {
    fn from(quantity: Quantity) -> Self {
        match quantity {
            Quantity::Position => Self::Position,
            Quantity::Pattern => Self::Pattern,
            Quantity::Count => Self::Count,
            Quantity::Force => Self::Force,
        }
    }
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
        let of = |quantity: Quantity| {
            row(quantity.name(), Measured, Answers::Quantity(quantity), &[MEASURED])
        };
        match self {
            Self::Transfer => row("transfer", Measured, Answers::Frame, &[MEASURED, SIMULATED]),
            Self::Recon => row("recon", Simulated, Answers::Map, &[SIMULATED]),
            Self::EndToEnd => row("end-to-end", Measured, Answers::Map, &[MEASURED]),
            Self::Points => row("points", Measured, Answers::Points, &[SIMULATED]),
            Self::Position => of(Quantity::Position),
            Self::Pattern => of(Quantity::Pattern),
            Self::Count => of(Quantity::Count),
            Self::Force => of(Quantity::Force),
        }
    }

    /// The task of a net of a recipe.
    pub fn of(net: &nets::net::Net) -> Self {
        match (net.answer(), net.frames()) {
            (NetAnswer::Frame, _) => Self::Transfer,
            (NetAnswer::Map { .. }, Reads::Simulated) => Self::Recon,
            (NetAnswer::Map { .. }, Reads::Measured) => Self::EndToEnd,
            (NetAnswer::Points, _) => Self::Points,
            (NetAnswer::Quantity(quantity), _) => quantity.into(),
        }
    }

    /// All tasks.
    pub const ALL: &[Self] = Self::VARIANTS;

    /// Description in one line.
    pub fn about(self) -> &'static str {
        match self {
            Self::Transfer => "measured to simulated voltages",
            Self::Recon => "simulated voltages to a force map",
            Self::EndToEnd => "measured voltages to a force map",
            Self::Points => "voltages to points and forces",
            Self::Position => "a frame to the position of one contact",
            Self::Pattern => "a frame to the places that are pressed",
            Self::Count => "a frame to the number of contacts",
            Self::Force => "a frame to the total force",
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

    /// The quantity that is answered, if it is one.
    pub fn quantity(self) -> Option<Quantity> {
        match self.answers() {
            Answers::Quantity(quantity) => Some(quantity),
            Answers::Frame | Answers::Map | Answers::Points => None,
        }
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
            Answers::Quantity(Quantity::Position) => ["position_mm", "x and y of the contact, mm"],
            Answers::Quantity(Quantity::Pattern) => {
                ["pattern", "above zero at each of the known places that is pressed"]
            }
            Answers::Quantity(Quantity::Count) => ["count", "number of contacts, not rounded"],
            Answers::Quantity(Quantity::Force) => ["force_n", "sum of all contacts' forces, N"],
        }
    }

    /// Shape of one answer for a sensor; `None` if it depends on a map that is not stated. `places`: number
    /// of known places.
    pub fn output_shape(
        self,
        sensor: &SensorFacts,
        map: Option<ForceMapSpec>,
        places: usize,
    ) -> Option<Vec<usize>> {
        match self.answers() {
            Answers::Frame => Some(vec![sensor.channels]),
            Answers::Map => map.map(|map| vec![map.pixels(); 2]),
            Answers::Points => Some(vec![2, sensor.points]),
            Answers::Quantity(quantity) => Some(vec![quantity.len(places)]),
        }
    }
}
