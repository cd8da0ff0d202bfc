//! The manifest beside a model: what it is for, what it was made from, where it may be trusted.
//! PURE. Uses: ONNX files, the spec of a force map, labels. Never: files, answers, training.
//!
//! A model's id is made from its facts and its ONNX file, not from its scores, which come later.
//! A file written by another program becomes a model by the same facts, stated by a person.

#[cfg(all(test, feature = "train"))]
mod tests;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::onnx::{OnnxError, OnnxFile, Port, unsealed};
#[cfg(feature = "train")]
use super::onnx::{
    sealed,
    write::{Description, WriteError, to_onnx},
};
use crate::dataset::force_map::ForceMapSpec;
use crate::problem::{Checks, Problem};
use crate::store::Label;
use crate::syntax::syntax_problem;

/// Hex digits of an id.
const ID_DIGITS: usize = 16;
/// Most numbers of an answer, and most channels of a sensor: a bound on what is asked of memory.
const NUMBERS_MAX: usize = 1 << 20;

/// What a net was trained to do (paper, section V).
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

impl NetTask {
    /// The task as it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Transfer => "transfer",
            Self::Recon => "recon",
            Self::EndToEnd => "end-to-end",
            Self::Points => "points",
        }
    }

    /// Whether the answer is a force map.
    pub fn gives_map(self) -> bool {
        matches!(self, Self::Recon | Self::EndToEnd)
    }

    /// What goes in: the tensor's name, and words for it.
    pub fn input(self) -> [&'static str; 2] {
        match self {
            Self::Recon => ["voltages_v_sim", "simulated voltages, V, injection-major"],
            _ => ["voltages_v", "measured voltages, V, injection-major"],
        }
    }

    /// What comes out: the tensor's name, and words for it.
    pub fn output(self) -> [&'static str; 2] {
        match self {
            Self::Transfer => ["voltages_v_sim", "simulated voltages, V, injection-major"],
            Self::Recon | Self::EndToEnd => {
                ["force_map_n", "newtons per pixel, row = y, column = x, row 0 at the lowest y"]
            }
            Self::Points => ["points", "logit of a contact, and ln(force / N), at each point"],
        }
    }
}

/// What a model's sensor must have for the model to be used with it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SensorFacts {
    /// Its name.
    pub name: String,
    /// Numbers of a frame.
    pub channels: usize,
    /// Points of its lattice; 0 where it has none.
    pub points: usize,
}

/// Where in the space of touches and frames a model has been; what is not known is absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainedRange {
    /// Numbers of contacts that it has seen; empty: not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contact_counts: Vec<u32>,
    /// Largest force of a contact, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_force_n: Option<f64>,
    /// No contact that it learned from had a force: its maps say where and not how hard, and each
    /// contact in them sums up to 1.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub forces_unknown: bool,
    /// Largest Euclidean norm of a frame, V.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_norm_v: Option<f64>,
}

/// How a frame or an answer leaves the range that a model was trained on.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OutOfRange {
    /// A stronger frame than any.
    #[error("a frame of norm {norm_v:.4} V: trained up to {max_norm_v:.4} V")]
    Norm {
        /// The frame's.
        norm_v: f64,
        /// The largest in training.
        max_norm_v: f64,
    },
    /// A number of contacts that was never seen.
    #[error("{contacts} contacts: not among those trained on")]
    Contacts {
        /// How many.
        contacts: u32,
    },
    /// A harder touch than any.
    #[error("a contact of {force_n:.2} N: trained up to {max_force_n:.2} N")]
    Force {
        /// The contact's.
        force_n: f64,
        /// The largest in training.
        max_force_n: f64,
    },
}

impl TrainedRange {
    /// Whether a frame, V, is stronger than any that was trained on.
    pub fn frame(&self, frame: &[f32]) -> Option<OutOfRange> {
        let norm_v = frame.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt();
        let max_norm_v = self.max_norm_v?;
        (norm_v > max_norm_v).then_some(OutOfRange::Norm { norm_v, max_norm_v })
    }

    /// Whether an answer, as the forces of its contacts, N, is one that was never trained on.
    pub fn answer(&self, forces_n: &[f64]) -> Option<OutOfRange> {
        let contacts = u32::try_from(forces_n.len()).unwrap_or(u32::MAX);
        if !self.contact_counts.is_empty() && !self.contact_counts.contains(&contacts) {
            return Some(OutOfRange::Contacts { contacts });
        }
        let force_n = forces_n.iter().copied().fold(0.0, f64::max);
        let max_force_n = self.max_force_n?;
        (force_n > max_force_n).then_some(OutOfRange::Force { force_n, max_force_n })
    }
}

/// What is known of a model besides its weights; its id covers all of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFacts {
    /// What it does.
    pub task: NetTask,
    /// Whether what it learned from was measured, virtual, or simulated alone.
    pub label: Label,
    /// Name of the sensor that it is for.
    pub sensor: String,
    /// Numbers of a frame.
    pub channels: usize,
    /// Shape of one answer: `[784]`, `[160, 160]`, `[2, 804]`.
    pub output_shape: Vec<usize>,
    /// Resolution and spread of the force map that it gives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_map: Option<ForceMapSpec>,
    /// Ids of the datasets that it learned from.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<String>,
    /// Id of the calibration behind its simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<String>,
    /// Hash of the model that its simulations came from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulation: Option<String>,
    /// What trained it: program, version, commit.
    pub code: String,
    /// The recipe file that it was trained by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recipe: Option<String>,
    /// Where it has been.
    #[serde(default)]
    pub trained_on: TrainedRange,
}

/// A model's manifest, `manifest.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// `mdl-` and the start of a sha256 over `model` and the ONNX file.
    pub id: String,
    /// What is known of it.
    pub model: ModelFacts,
    /// How well it did, as whoever wrote the manifest says. The service's own scores are the results of
    /// its evaluations.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub scores: toml::Table,
}

/// Why a file and what is said of it do not make a model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The ONNX file.
    #[error("ONNX file: {0}")]
    Onnx(#[from] OnnxError),
    /// What is said of it; each with its key.
    #[error("{}", listed(.0))]
    Facts(Vec<Problem>),
    /// A file that does not do what is said of it.
    #[error("ONNX file: {port} `{name}` has shape {found:?}, {task} on this sensor has {wanted:?}")]
    Shape {
        /// Input or output.
        port: &'static str,
        /// Name of the tensor.
        name: String,
        /// Its shape, the batch first; `None` is open.
        found: Vec<Option<usize>>,
        /// The shape that is served.
        wanted: Vec<Option<usize>>,
        /// The task.
        task: &'static str,
    },
    /// A file other than the one that the manifest was written for.
    #[error(
        "the ONNX file and the manifest make {made}, the manifest says {stated}: one was changed"
    )]
    Changed {
        /// The id that they make.
        made: String,
        /// The id that is written.
        stated: String,
    },
    /// A net that cannot be written.
    #[cfg(feature = "train")]
    #[error("net: {0}")]
    Write(#[from] WriteError),
}

fn listed(problems: &[Problem]) -> String {
    problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("; ")
}

impl ModelFacts {
    /// What is wrong with them for this sensor; `file` is how messages name their source.
    pub fn check(&self, file: &str, sensor: &SensorFacts) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of(file);
        let limit = format!("must be `{}`", sensor.name);
        checks.require(self.sensor == sensor.name, "model.sensor", &self.sensor, &limit);
        let limit = format!("must be the sensor's {}", sensor.channels);
        let channels = self.channels == sensor.channels && self.channels <= NUMBERS_MAX;
        checks.require(channels, "model.channels", self.channels, &limit);
        let map = self.force_map.map_or("none".into(), |map| map.to_string());
        let limit = "must be there for recon and end-to-end, and for these alone";
        checks.require(
            self.task.gives_map() == self.force_map.is_some(),
            "model.force_map",
            map,
            limit,
        );
        let wanted = match (self.task, self.force_map) {
            (NetTask::Transfer, _) => vec![sensor.channels],
            (NetTask::Points, _) => vec![2, sensor.points],
            (NetTask::Recon | NetTask::EndToEnd, Some(map)) => vec![map.pixels(); 2],
            (NetTask::Recon | NetTask::EndToEnd, None) => self.output_shape.clone(),
        };
        let numbers = wanted.iter().try_fold(1, |n: usize, &l| n.checked_mul(l)).unwrap_or(0);
        let limit = format!("must be {wanted:?} for {} on this sensor", self.task.as_str());
        let fits = self.output_shape == wanted && (1..=NUMBERS_MAX).contains(&numbers);
        checks.require(fits, "model.output_shape", format!("{:?}", self.output_shape), &limit);
        checks.require(!self.code.is_empty(), "model.code", "\"\"", "must say what trained it");
        for id in &self.datasets {
            checks.require(id.starts_with("ds-"), "model.datasets", id, "must be ids, ds-..");
        }
        for (key, most) in [
            ("model.trained_on.max_force_n", self.trained_on.max_force_n),
            ("model.trained_on.max_norm_v", self.trained_on.max_norm_v),
        ] {
            let positive = most.is_none_or(|most| most.is_finite() && most > 0.0);
            checks.require(positive, key, most.unwrap_or(0.0), "must be above 0, or absent");
        }
        checks.done()
    }

    /// The model's id: `mdl-` and the start of a sha256 over these facts and a file without its
    /// seal.
    fn id(&self, file: &[u8]) -> String {
        let mut hash = Sha256::new();
        hash.update(serde_json::to_vec(self).expect("strings, numbers and lists are JSON"));
        hash.update(file);
        let digits = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        format!("mdl-{}", &digits[..ID_DIGITS])
    }

    /// Whether an ONNX file takes this model's frames and gives its answers, as far as it says.
    fn check_shapes(&self, onnx: &OnnxFile) -> Result<(), ModelError> {
        let input = [None, Some(self.channels)];
        let lengths = self.output_shape.iter().map(|&length| Some(length));
        let output: Vec<Option<usize>> = std::iter::once(None).chain(lengths).collect();
        let ports = [("input", onnx.input(), &input[..]), ("output", onnx.output(), &output)];
        for (port, found, wanted) in ports {
            if !agrees(found, wanted) {
                return Err(ModelError::Shape {
                    port,
                    name: found.name.clone(),
                    found: found.dimensions.clone(),
                    wanted: wanted.to_vec(),
                    task: self.task.as_str(),
                });
            }
        }
        Ok(())
    }

    #[cfg(feature = "train")]
    fn properties(&self) -> Vec<(String, String)> {
        let mut said = vec![
            ("task", self.task.as_str().to_owned()),
            ("label", self.label.as_str().to_owned()),
            ("sensor", self.sensor.clone()),
            ("code", self.code.clone()),
            ("datasets", self.datasets.join(" ")),
        ];
        said.extend(self.force_map.map(|map| ("force_map", map.to_string())));
        said.extend(self.calibration.clone().map(|id| ("calibration", id)));
        said.extend(self.simulation.clone().map(|hash| ("simulation", hash)));
        said.into_iter().map(|(key, value)| (format!("palpate.{key}"), value)).collect()
    }
}

/// Open lengths, and shapes that are not said at all, agree with anything.
fn agrees(port: &Port, wanted: &[Option<usize>]) -> bool {
    let found = &port.dimensions;
    let equal = |(found, wanted): (&Option<usize>, &Option<usize>)| match (found, wanted) {
        (Some(found), Some(wanted)) => found == wanted,
        _ => true,
    };
    found.is_empty() || (found.len() == wanted.len() && found.iter().zip(wanted).all(equal))
}

impl Manifest {
    /// Reads a manifest and checks it for the sensor at hand.
    pub fn from_toml(file: &str, text: &str, sensor: &SensorFacts) -> Result<Self, Vec<Problem>> {
        let manifest: Self =
            toml::from_str(text).map_err(|error| vec![syntax_problem(file, text, &error)])?;
        manifest.model.check(file, sensor)?;
        Ok(manifest)
    }

    /// The manifest as a file.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("strings, numbers, lists and tables are TOML")
    }

    /// Whether this ONNX file is the one that the manifest was written for, unchanged.
    pub fn check_file(&self, file: &[u8]) -> Result<OnnxFile, ModelError> {
        let made = self.model.id(unsealed(file, &self.id));
        if made != self.id {
            return Err(ModelError::Changed { made, stated: self.id.clone() });
        }
        let onnx = OnnxFile::read(file)?;
        self.model.check_shapes(&onnx)?;
        Ok(onnx)
    }
}

/// A model from an ONNX file that another program wrote, and what a person says of it. The file is
/// served as it is.
///
/// Fails where the file is none that can be served, or does not fit the sensor or the task.
pub fn manifest_for_foreign(
    file: &[u8],
    model: ModelFacts,
    sensor: &SensorFacts,
) -> Result<Manifest, ModelError> {
    model.check("model", sensor).map_err(ModelError::Facts)?;
    model.check_shapes(&OnnxFile::read(file)?)?;
    Ok(Manifest { id: model.id(file), model, scores: toml::Table::new() })
}

/// A model from a net that was trained here: its manifest, and its ONNX file with the id in it.
///
/// Fails where the net does not fit the sensor or the task, or cannot be written.
#[cfg(feature = "train")]
pub fn model_of(
    network: &nets::network::Network,
    model: ModelFacts,
    sensor: &SensorFacts,
) -> Result<(Manifest, Vec<u8>), ModelError> {
    model.check("model", sensor).map_err(ModelError::Facts)?;
    let properties = model.properties();
    let says = Description {
        name: model.task.as_str(),
        doc: "A net of Palpate; its manifest says what it was made from.",
        input: model.task.input(),
        output: model.task.output(),
        version: env!("CARGO_PKG_VERSION"),
        properties: &properties,
    };
    let file = to_onnx(network, &says)?;
    model.check_shapes(&OnnxFile::read(&file)?)?;
    let id = model.id(&file);
    let file = sealed(file, &id);
    Ok((Manifest { id, model, scores: toml::Table::new() }, file))
}
