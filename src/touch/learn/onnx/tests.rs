//! Rejected ONNX files, by name, and requirements on a net to be written.

use prost::Message;
use tract_onnx::pb::tensor_proto::DataLocation;
use tract_onnx::pb::{AttributeProto, FunctionProto, GraphProto, ModelProto};

use super::graph::value;
use super::write::{Description, WriteError, to_onnx};
use super::{OnnxError, OnnxFile, sealed, unsealed};
use crate::ids::ModelId;
use nets::network::{Form, Layer, Network};

fn says() -> Description<'static> {
    Description {
        name: "net",
        doc: "a test",
        input: ["voltages_v", "V"],
        output: ["answer", ""],
        version: "1",
        properties: &[],
    }
}

fn dense(inputs: usize, outputs: usize) -> Layer {
    let weight = (0..inputs * outputs).map(|i| i as f32).collect();
    Layer::Dense { inputs, outputs, weight, bias: vec![0.5; outputs] }
}

fn net(layers: Vec<Layer>, output: &[usize]) -> Network {
    Network { inputs: 3, output: output.to_vec(), layers, form: Form::Plain }
}

fn file() -> Vec<u8> {
    to_onnx(&net(vec![dense(3, 2), Layer::Relu], &[2]), &says()).unwrap()
}

/// A valid file after a change.
fn changed(change: impl FnOnce(&mut ModelProto, &mut GraphProto)) -> Result<OnnxFile, OnnxError> {
    let mut model = ModelProto::decode(file().as_slice()).unwrap();
    let mut graph = model.graph.take().unwrap();
    change(&mut model, &mut graph);
    model.graph = Some(graph);
    OnnxFile::read(&model.encode_to_vec())
}

#[test]
fn a_file_tells_its_ports_operators_and_producer() {
    let file = OnnxFile::read(&file()).unwrap();
    assert_eq!(file.input().name, "voltages_v");
    assert_eq!(file.input().dimensions, [None, Some(3)]);
    let output = file.output();
    assert_eq!((output.name.as_str(), &*output.dimensions), ("answer", &[None, Some(2)][..]));
    assert_eq!(file.operators(), ["Gemm", "Relu", "Identity"]);
    let ModelProto { producer_name, producer_version, .. } = file.model();
    assert_eq!((producer_name.as_str(), producer_version.as_str()), ("palpate", "1"));
}

#[test]
fn a_seal_is_read_by_any_reader_and_taken_off_again() {
    let plain = file();
    let with = sealed(plain.clone(), &ModelId::unchecked("mdl-1"));
    assert_eq!(unsealed(&with, &ModelId::unchecked("mdl-1")), plain);
    assert_eq!(unsealed(&with, &ModelId::unchecked("mdl-2")), with);
    let model = OnnxFile::read(&with).unwrap().model().clone();
    let said = &model.metadata_props[0];
    assert_eq!((said.key.as_str(), said.value.as_str()), ("palpate.model", "mdl-1"));
}

#[test]
fn what_cannot_be_served_is_named() {
    let refused = |change: fn(&mut ModelProto, &mut GraphProto)| changed(change).unwrap_err();
    assert!(matches!(OnnxFile::read(b"{\"not\": \"onnx\"}"), Err(OnnxError::Damaged(_))));
    assert!(matches!(OnnxFile::read(b""), Err(OnnxError::Damaged(_))));
    assert_eq!(refused(|m, _| m.opset_import[0].version = 99), OnnxError::Opset { found: 99 });
    assert_eq!(refused(|m, _| m.opset_import.clear()), OnnxError::Opset { found: 0 });
    let is_refused = |change: fn(&mut ModelProto, &mut GraphProto), words: &str| {
        assert_eq!(refused(change).to_string(), words);
    };
    let words = "tensor `dense_0.weight`: data in another file cannot be served";
    is_refused(|_, g| g.initializer[0].data_location = Some(DataLocation::External.into()), words);
    let n = i64::MAX;
    let words =
        format!("tensor `dense_0.weight`: shape [{n}, {n}] and 24 bytes of data do not agree");
    is_refused(|_, g| g.initializer[0].dims = vec![i64::MAX, i64::MAX], &words);
    let branch = |_: &mut ModelProto, graph: &mut GraphProto| {
        let g = Some(GraphProto::default());
        graph.node[0].attribute.push(AttributeProto { g, ..AttributeProto::default() });
    };
    is_refused(branch, "node `dense_0` (Gemm): a branch or a loop cannot be served");
    let words = "node `relu_1` (Relu): an operator that is not part of ONNX cannot be served";
    is_refused(|_, g| g.node[1].domain = "com.example".into(), words);
    let words = "the file: a model-local function cannot be served";
    is_refused(|m, _| m.functions.push(FunctionProto::default()), words);
    let words = "node `relu_1` (Relu): `dense_0` is not defined before";
    is_refused(|_, g| g.node.swap(0, 1), words);
    let words = "the outputs: `elsewhere` is not defined before";
    is_refused(|_, g| g.output[0].name = "elsewhere".into(), words);
    let words = "node `relu_1` (Relu): `dense_0` is defined twice";
    is_refused(|_, g| g.node[1].output[0] = "dense_0".into(), words);
    is_refused(|_, g| g.input.push(value("more", "", &[1])), "inputs: must be one, is 2");
    let words = "inputs: must be of two dimensions (frames, channels), is of 3 dimensions";
    is_refused(|_, g| g.input[0] = value("voltages_v", "", &[3, 3]), words);
}

#[test]
fn a_net_that_does_not_fit_together_is_refused_by_its_layer() {
    let refused = |layers, output, words: &str| {
        let refused = to_onnx(&net(layers, &[output]), &says()).unwrap_err();
        assert_eq!(refused.to_string(), words);
    };
    let words = "layer dense_1: needs a vector of 4, input is a vector of 3";
    refused(vec![Layer::Relu, dense(4, 2)], 2, words);
    let Layer::Dense { weight, .. } = dense(3, 1) else { unreachable!() };
    let short = |bias| Layer::Dense { inputs: 3, outputs: 2, weight: weight.repeat(2), bias };
    refused(vec![short(vec![0.0])], 2, "layer dense_0: bias holds 1 numbers, must hold 2");
    let words = "layer dense_0: bias holds a number that is not finite";
    refused(vec![short(vec![0.0, f32::NAN])], 2, words);
    let words =
        "layer pixel_shuffle_0: needs an image of a multiple of 4 channels, input is a vector of 3";
    refused(vec![Layer::PixelShuffle { factor: 2 }], 3, words);
    refused(vec![], 4, "the result of the last layer is a vector of 3, the answer is [4]");
    let mut residual = net(vec![dense(3, 2)], &[2]);
    residual.form = Form::Residual { floor: 1e-3 };
    assert!(matches!(to_onnx(&residual, &says()), Err(WriteError::Answer { .. })));
}
