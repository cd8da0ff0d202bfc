//! The manifest of a model: its purpose, its origin, its range of validity.
//! PURE. Uses: ONNX files, the spec of a force map, labels. Never: files, answers, training.
//!
//! The id of a model is a hash of its facts and its ONNX file; scores, which follow later, are not
//! included. For an ONNX file of another program, a person states the same facts.

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use sim_core::stats::norm;

use super::onnx::write::{Description, WriteError, to_onnx};
use super::onnx::{OnnxError, OnnxFile, Port, sealed, unsealed};
use super::task::{NetTask, SensorFacts};
use crate::dataset::force_map::ForceMapSpec;
use crate::digest::{Hashing, ID_DIGITS};
use crate::ids::{CalibrationId, DatasetId, ModelId};
use crate::problem::{Checks, Problem, listed};
use crate::store::Label;
use crate::syntax::parse_toml;

/// Largest number of values of an answer, and of channels of a sensor: bounds the memory.
const NUMBERS_MAX: usize = 1 << 20;

/// Range of contacts and frames that a model was trained on; unknown values are absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainedRange {
    /// Numbers of contacts in training; empty if unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contact_counts: Vec<u32>,
    /// Largest force of a contact in training, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_force_n: Option<f64>,
    /// No contact in training had a force: the maps contain positions only, and each contact in
    /// them sums up to 1.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub forces_unknown: bool,
    /// Largest Euclidean norm of a frame in training, V.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_norm_v: Option<f64>,
}

/// Why a frame or an answer is outside the trained range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum OutOfRange {
    #[error("a frame of norm {norm_v:.4} V: trained up to {max_norm_v:.4} V")]
    Norm { norm_v: f64, max_norm_v: f64 },
    #[error("{contacts} contacts: not among those trained on")]
    Contacts { contacts: u32 },
    #[error("a contact of {force_n:.2} N: trained up to {max_force_n:.2} N")]
    Force { force_n: f64, max_force_n: f64 },
}

impl TrainedRange {
    /// Checks whether a frame, V, has a larger norm than in training.
    pub fn frame(&self, frame: &[f32]) -> Option<OutOfRange> {
        let norm_v = norm(frame);
        let max_norm_v = self.max_norm_v?;
        (norm_v > max_norm_v).then_some(OutOfRange::Norm { norm_v, max_norm_v })
    }

    /// Checks whether an answer, as the forces of its contacts, N, is outside the trained range.
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

/// Facts of a model, without its weights; its id covers all of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFacts {
    /// Task of the net.
    pub task: NetTask,
    /// Origin of the training data: measured, virtual, or only simulated.
    pub label: Label,
    /// Name of its sensor.
    pub sensor: String,
    /// Number of values in a frame.
    pub channels: usize,
    /// Shape of one answer: `[784]`, `[160, 160]`, `[2, 804]`.
    pub output_shape: Vec<usize>,
    /// Resolution and spread of its force map; absent for other tasks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_map: Option<ForceMapSpec>,
    /// Known places of a pattern, mm, in the order of its numbers; empty for other tasks.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places_mm: Vec<[f64; 2]>,
    /// Ids of the datasets used in training.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<DatasetId>,
    /// Id of the calibration of its simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationId>,
    /// Hash of the model of its simulations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulation: Option<String>,
    /// Program, version and commit that trained it.
    pub code: String,
    /// Text of its recipe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recipe: Option<String>,
    /// Numbers of contacts, largest force and largest frame of the training rows.
    #[serde(default)]
    pub trained_on: TrainedRange,
}

/// A model's manifest, `manifest.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// `mdl-` and the start of a sha256 over `model` and the ONNX file.
    pub id: ModelId,
    /// Facts of the model.
    pub model: ModelFacts,
    /// Scores, as stated by the author of the manifest. The service's own scores are the results of
    /// its evaluations.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub scores: toml::Table,
}

/// Why a file and its stated facts are not a model.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum ModelError {
    #[error("ONNX file: {0}")]
    Onnx(#[from] OnnxError),
    #[error("{}", listed(.0))]
    Facts(Vec<Problem>),
    #[error("ONNX file: {port} `{name}` has shape {found:?}, {task} on this sensor has {wanted:?}")]
    Shape {
        port: &'static str,
        name: String,
        /// Its shape, batch first; `None` is open.
        found: Vec<Option<usize>>,
        wanted: Vec<Option<usize>>,
        task: &'static str,
    },
    #[error(
        "the id of ONNX file and manifest is {made}, the manifest states {stated}: one was changed"
    )]
    Changed { made: ModelId, stated: ModelId },
    #[error("net: {0}")]
    Write(#[from] WriteError),
}

impl ModelFacts {
    /// Checks the facts for a sensor; `file` names their source in messages.
    ///
    /// # Errors
    /// All problems, each with its key.
    pub fn check(&self, file: &str, sensor: &SensorFacts) -> Result<(), Vec<Problem>> {
        let mut checks = Checks::of(file);
        let limit = format!("must be `{}`", sensor.name);
        checks.require(self.sensor == sensor.name, "model.sensor", &self.sensor, &limit);
        let limit = format!("must be the sensor's {}", sensor.channels);
        let channels = self.channels == sensor.channels && self.channels <= NUMBERS_MAX;
        checks.require(channels, "model.channels", self.channels, &limit);
        let map = self.force_map.map_or("none".into(), |map| map.to_string());
        let limit = "must be set for nets with force maps as answers, and only for these";
        let is_right = self.task.gives_map() == self.force_map.is_some();
        checks.require(is_right, "model.force_map", map, limit);
        let is_pattern = self.task == NetTask::Pattern;
        let limit = "must be set for the task pattern, and only for it";
        let is_right = is_pattern != self.places_mm.is_empty();
        checks.require(is_right, "model.places_mm", self.places_mm.len(), limit);
        let wanted = self.task.output_shape(sensor, self.force_map, self.places_mm.len());
        let wanted = wanted.unwrap_or_else(|| self.output_shape.clone());
        let numbers = wanted.iter().try_fold(1, |n: usize, &l| n.checked_mul(l)).unwrap_or(0);
        let limit = format!("must be {wanted:?} for {} on this sensor", self.task.as_str());
        let fits = self.output_shape == wanted && (1..=NUMBERS_MAX).contains(&numbers);
        checks.require(fits, "model.output_shape", format!("{:?}", self.output_shape), &limit);
        checks.require(!self.code.is_empty(), "model.code", "\"\"", "must state what trained it");
        for id in &self.datasets {
            // Read from a file, so that the start of its text is not known.
            let is_id = id.as_str().parse::<DatasetId>().is_ok();
            checks.require(is_id, "model.datasets", id, "must be ids, ds-..");
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

    /// Returns the facts as TOML, as a form states them.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("strings, numbers, lists and tables are TOML")
    }

    /// The model's id: `mdl-` and the start of a sha256 over these facts and a file without its
    /// seal.
    fn id(&self, file: &[u8]) -> ModelId {
        let mut hash = Hashing::default();
        hash.update(serde_json::to_vec(self).expect("strings, numbers and lists are JSON"));
        hash.update(file);
        let digits = hash.finish();
        ModelId::unchecked(format!("mdl-{}", &digits[..ID_DIGITS]))
    }

    /// Checks the shapes of an ONNX file's input and output, as far as it states them.
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

    fn properties(&self) -> Vec<(String, String)> {
        let datasets: Vec<&str> = self.datasets.iter().map(DatasetId::as_str).collect();
        let mut said = vec![
            ("task", self.task.as_str().to_owned()),
            ("label", self.label.as_str().to_owned()),
            ("sensor", self.sensor.clone()),
            ("code", self.code.clone()),
            ("datasets", datasets.join(" ")),
        ];
        said.extend(self.force_map.map(|map| ("force_map", map.to_string())));
        said.extend(self.calibration.as_ref().map(|id| ("calibration", id.to_string())));
        said.extend(self.simulation.clone().map(|hash| ("simulation", hash)));
        said.into_iter().map(|(key, value)| (format!("palpate.{key}"), value)).collect()
    }
}

/// Open lengths and unstated shapes agree with any shape.
fn agrees(port: &Port, wanted: &[Option<usize>]) -> bool {
    let found = &port.dimensions;
    let equal = |(found, wanted): (&Option<usize>, &Option<usize>)| match (found, wanted) {
        (Some(found), Some(wanted)) => found == wanted,
        _ => true,
    };
    found.is_empty() || (found.len() == wanted.len() && found.iter().zip(wanted).all(equal))
}

impl Manifest {
    /// Reads a manifest and checks it for a sensor.
    ///
    /// # Errors
    /// All problems of the text or its facts.
    pub fn from_toml(file: &str, text: &str, sensor: &SensorFacts) -> Result<Self, Vec<Problem>> {
        let manifest: Self = parse_toml(file, text)?;
        manifest.model.check(file, sensor)?;
        Ok(manifest)
    }

    /// Returns the text of the manifest file.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("strings, numbers, lists and tables are TOML")
    }

    /// Checks that an ONNX file is the unchanged one of this manifest, and returns it.
    ///
    /// # Errors
    /// `ModelError::Changed` if it is not; `Onnx` or `Shape` if it cannot be served.
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

/// Builds the manifest of an ONNX file of another program from facts that a person states. The file
/// is served unchanged.
///
/// # Errors
/// `ModelError` if the file cannot be served, or the facts do not match the sensor or the file.
pub fn manifest_for_foreign(
    file: &[u8],
    model: ModelFacts,
    sensor: &SensorFacts,
) -> Result<Manifest, ModelError> {
    model.check("model", sensor).map_err(ModelError::Facts)?;
    model.check_shapes(&OnnxFile::read(file)?)?;
    Ok(Manifest { id: model.id(file), model, scores: toml::Table::new() })
}

/// Builds the manifest of a net that a trainer of Palpate has made on another machine. Its id must be that of its facts and
/// its file.
///
/// # Errors
/// `ModelError::Changed` if it is not; others if the file cannot be served, or the facts do not match the sensor or the
/// file.
pub fn manifest_with_id(
    file: &[u8],
    model: ModelFacts,
    sensor: &SensorFacts,
    id: ModelId,
) -> Result<Manifest, ModelError> {
    model.check("model", sensor).map_err(ModelError::Facts)?;
    let manifest = Manifest { id, model, scores: toml::Table::new() };
    manifest.check_file(file)?;
    Ok(manifest)
}

/// Builds the manifest of a net trained here, and its ONNX file, which contains the id.
///
/// # Errors
/// `ModelError` if the net does not match the sensor or the task, or cannot be written.
pub fn model_of(
    network: &nets::network::Network,
    model: ModelFacts,
    sensor: &SensorFacts,
) -> Result<(Manifest, Vec<u8>), ModelError> {
    model.check("model", sensor).map_err(ModelError::Facts)?;
    let properties = model.properties();
    let says = Description {
        name: model.task.as_str(),
        doc: "A net of Palpate; its manifest states what it was made from.",
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
