//! Checks of an ONNX file of any origin: its input and output, and that it can be served.
//! PURE. Uses: the ONNX messages of tract, prost. Never: external data files.
//!
//! Guarantees for the engine: names refer to existing tensors, all weights are in the file and
//! match their shapes, there are no loops, and sizes are bounded.

mod fold;
mod graph;
#[cfg(test)]
mod tests;
pub mod write;

use std::collections::HashSet;

use prost::Message;
use tract_onnx::pb::tensor_proto::{DataLocation, DataType};
use tract_onnx::pb::tensor_shape_proto::dimension::Value as Dimension;
use tract_onnx::pb::type_proto::Value as Type;
use tract_onnx::pb::{
    GraphProto, ModelProto, NodeProto, StringStringEntryProto, TensorProto, ValueInfoProto,
};

use crate::ids::ModelId;

/// Largest file, bytes; ten times the largest net of the paper.
pub const FILE_BYTES_MAX: usize = 512 << 20;
/// Largest number of operations in a graph.
pub const NODES_MAX: usize = 4096;
/// Operator sets that are served: tract 0.23 is tested with 9 to 18, PyTorch 2.15 writes 20.
pub const OPSETS: std::ops::RangeInclusive<i64> = 9..=20;

/// Name of the property that contains the id of the model.
const ID_PROPERTY: &str = "palpate.model";

/// Why an ONNX file is rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum OnnxError {
    #[error("a file of {bytes} bytes: at most {FILE_BYTES_MAX}")]
    TooLarge { bytes: usize },
    #[error("not an ONNX file, or a damaged one: {0}")]
    Damaged(String),
    /// `found`: 0 if the file states none.
    #[error("operator set {found}: must be from {} to {} (export with opset_version=17)",
        OPSETS.start(), OPSETS.end())]
    Opset { found: i64 },
    /// The file uses a feature of ONNX that is excluded for safety.
    #[error("{place}: {what} cannot be served")]
    Unsupported { place: String, what: &'static str },
    #[error("tensor `{tensor}`: shape {shape:?} and {found} bytes of data do not agree")]
    Tensor { tensor: String, shape: Vec<i64>, found: usize },
    /// A name has no definition before its use, or two definitions.
    #[error("{place}: `{name}` is {fault}")]
    Name { place: String, name: String, fault: &'static str },
    /// Input or output is not exactly one tensor of 32-bit floats.
    #[error("{what}: must be {wanted}, is {found}")]
    Port { what: &'static str, wanted: &'static str, found: String },
}

/// Input or output of a net.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// Name of the tensor.
    pub name: String,
    /// Lengths, batch first; `None` if the file leaves one open.
    pub dimensions: Vec<Option<usize>>,
}

/// A checked ONNX file.
#[derive(Debug, Clone, PartialEq)]
pub struct OnnxFile {
    model: ModelProto,
    input: Port,
    output: Port,
}

impl OnnxFile {
    /// Reads a file and checks that it can be served.
    ///
    /// # Errors
    /// `OnnxError` with the first rule that the file breaks.
    pub fn read(bytes: &[u8]) -> Result<Self, OnnxError> {
        if bytes.len() > FILE_BYTES_MAX {
            return Err(OnnxError::TooLarge { bytes: bytes.len() });
        }
        let damaged = |error: prost::DecodeError| OnnxError::Damaged(error.to_string());
        let model = ModelProto::decode(bytes).map_err(damaged)?;
        let Some(graph) = &model.graph else {
            return Err(OnnxError::Damaged("it contains no graph".into()));
        };
        check_opset(&model)?;
        check_features(&model, graph)?;
        for tensor in weights(graph) {
            check_tensor(tensor)?;
        }
        check_names(graph)?;
        let (input, output) = ports(graph)?;
        Ok(Self { input, output, model })
    }

    /// The file as protobuf messages.
    pub fn model(&self) -> &ModelProto {
        &self.model
    }

    /// Input for frames.
    pub fn input(&self) -> &Port {
        &self.input
    }

    /// Output with the answers; without dimensions if the file states none.
    pub fn output(&self) -> &Port {
        &self.output
    }

    /// Kinds of its operations, each once, in the order of their first use.
    pub fn operators(&self) -> Vec<&str> {
        let mut seen = HashSet::new();
        let nodes = self.model.graph.iter().flat_map(|graph| &graph.node);
        nodes.map(|node| node.op_type.as_str()).filter(|kind| seen.insert(*kind)).collect()
    }
}

/// Returns a file with its model's id appended. Protobuf allows a repeated field to continue at the
/// end, so the id can be a hash of the file's own bytes and follow them: see [`unsealed`].
pub fn sealed(mut file: Vec<u8>, model: &ModelId) -> Vec<u8> {
    file.extend(seal(model));
    file
}

/// Returns the bytes that the id is a hash of: a file without its seal; any other file whole.
pub fn unsealed<'a>(file: &'a [u8], model: &ModelId) -> &'a [u8] {
    file.strip_suffix(seal(model).as_slice()).unwrap_or(file)
}

fn seal(model: &ModelId) -> Vec<u8> {
    let entry = StringStringEntryProto { key: ID_PROPERTY.into(), value: model.to_string() };
    ModelProto { metadata_props: vec![entry], ..ModelProto::default() }.encode_to_vec()
}

fn check_opset(model: &ModelProto) -> Result<(), OnnxError> {
    let own = |domain: &str| domain.is_empty() || domain == "ai.onnx";
    let stated = model.opset_import.iter().find(|set| own(&set.domain));
    let found = stated.map_or(0, |set| set.version);
    if OPSETS.contains(&found) { Ok(()) } else { Err(OnnxError::Opset { found }) }
}

/// Rejects functions, loops, sparse tensors, foreign operators, and too many nodes.
fn check_features(model: &ModelProto, graph: &GraphProto) -> Result<(), OnnxError> {
    let refuse = |place: &str, what| Err(OnnxError::Unsupported { place: place.into(), what });
    if !model.functions.is_empty() {
        return refuse("the file", "a model-local function");
    }
    if !graph.sparse_initializer.is_empty() {
        return refuse("the graph", "a sparse tensor");
    }
    if graph.node.len() > NODES_MAX {
        return refuse("the graph", "more than 4096 operations");
    }
    for node in &graph.node {
        let place = place(node);
        if !(node.domain.is_empty() || node.domain == "ai.onnx") {
            return refuse(&place, "an operator that is not part of ONNX");
        }
        for attribute in &node.attribute {
            if attribute.g.is_some() || !attribute.graphs.is_empty() {
                return refuse(&place, "a branch or a loop");
            }
            if attribute.sparse_tensor.is_some() || !attribute.sparse_tensors.is_empty() {
                return refuse(&place, "a sparse tensor");
            }
        }
    }
    Ok(())
}

fn place(node: &NodeProto) -> String {
    format!("node `{}` ({})", node.name, node.op_type)
}

/// All tensors of a graph: its initialisers, and those of its constants.
fn weights(graph: &GraphProto) -> impl Iterator<Item = &TensorProto> {
    let attributes = graph.node.iter().flat_map(|node| &node.attribute);
    let constants = attributes.flat_map(|a| a.t.iter().chain(&a.tensors));
    graph.initializer.iter().chain(constants)
}

fn check_tensor(tensor: &TensorProto) -> Result<(), OnnxError> {
    let refuse =
        |what| Err(OnnxError::Unsupported { place: format!("tensor `{}`", tensor.name), what });
    if tensor.data_location == Some(DataLocation::External as i32)
        || !tensor.external_data.is_empty()
    {
        return refuse("data in another file");
    }
    let (bytes_each, typed) = match tensor.data_type() {
        DataType::Float => (4, tensor.float_data.len()),
        DataType::Double => (8, tensor.double_data.len()),
        DataType::Int64 => (8, tensor.int64_data.len()),
        DataType::Int32 => (4, tensor.int32_data.len()),
        DataType::Bool => (1, tensor.int32_data.len()),
        _ => return refuse("a type other than float, double, int32, int64 or bool"),
    };
    let found = if tensor.raw_data.is_empty() { typed * bytes_each } else { tensor.raw_data.len() };
    let numbers = tensor
        .dims
        .iter()
        .try_fold(1_usize, |product, &length| product.checked_mul(usize::try_from(length).ok()?));
    if numbers.and_then(|numbers| numbers.checked_mul(bytes_each)) == Some(found) {
        Ok(())
    } else {
        let (name, shape) = (tensor.name.clone(), tensor.dims.clone());
        Err(OnnxError::Tensor { tensor: name, shape, found })
    }
}

/// Checks that every tensor is defined once, and before its use.
fn check_names(graph: &GraphProto) -> Result<(), OnnxError> {
    let fault = |place: &str, name: &str, fault| {
        Err(OnnxError::Name { place: place.into(), name: name.into(), fault })
    };
    let mut made: HashSet<&str> = HashSet::new();
    for tensor in &graph.initializer {
        if tensor.name.is_empty() || !made.insert(&tensor.name) {
            return fault("the initialisers", &tensor.name, "defined twice, or empty");
        }
    }
    made.extend(graph.input.iter().map(|input| input.name.as_str()));
    for node in &graph.node {
        for name in node.input.iter().filter(|name| !name.is_empty()) {
            if !made.contains(name.as_str()) {
                return fault(&place(node), name, "not defined before");
            }
        }
        for name in node.output.iter().filter(|name| !name.is_empty()) {
            if !made.insert(name) {
                return fault(&place(node), name, "defined twice");
            }
        }
    }
    for output in &graph.output {
        if !made.contains(output.name.as_str()) {
            return fault("the outputs", &output.name, "not defined before");
        }
    }
    Ok(())
}

/// The single input (older files list their weights as inputs too) and the single output.
fn ports(graph: &GraphProto) -> Result<(Port, Port), OnnxError> {
    let weights: HashSet<&str> = graph.initializer.iter().map(|t| t.name.as_str()).collect();
    let inputs: Vec<&ValueInfoProto> =
        graph.input.iter().filter(|input| !weights.contains(input.name.as_str())).collect();
    let wrong = |what, wanted, found| Err(OnnxError::Port { what, wanted, found });
    let [input] = inputs[..] else {
        return wrong("inputs", "one", inputs.len().to_string());
    };
    let [output] = &graph.output[..] else {
        return wrong("outputs", "one", graph.output.len().to_string());
    };
    let (input, output) = (port("inputs", input)?, port("outputs", output)?);
    if input.dimensions.len() != 2 {
        let found = format!("of {} dimensions", input.dimensions.len());
        return wrong("inputs", "of two dimensions (frames, channels)", found);
    }
    Ok((input, output))
}

fn port(what: &'static str, value: &ValueInfoProto) -> Result<Port, OnnxError> {
    let Some(Type::TensorType(tensor)) = value.r#type.as_ref().and_then(|t| t.value.as_ref())
    else {
        let found = format!("`{}`, of no stated type", value.name);
        return Err(OnnxError::Port { what, wanted: "tensors", found });
    };
    if tensor.elem_type != DataType::Float as i32 {
        let found = format!("`{}`, of type {}", value.name, tensor.elem_type);
        return Err(OnnxError::Port { what, wanted: "32-bit floats", found });
    }
    let lengths = tensor.shape.iter().flat_map(|shape| &shape.dim);
    let dimensions = lengths
        .map(|dim| match dim.value {
            Some(Dimension::DimValue(length)) => usize::try_from(length).ok(),
            Some(Dimension::DimParam(_)) | None => None,
        })
        .collect();
    Ok(Port { name: value.name.clone(), dimensions })
}
