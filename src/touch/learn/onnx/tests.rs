//! Rejected ONNX files, by name, and requirements on a net to be written.

use prost::Message;
use tract_onnx::pb::tensor_proto::DataLocation;
use tract_onnx::pb::{AttributeProto, FunctionProto, GraphProto, ModelProto};

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
    assert_eq!(
        (file.output().name.as_str(), &*file.output().dimensions),
        ("answer", &[None, Some(2)][..])
    );
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
    assert_eq!(
        refused(|model, _| model.opset_import[0].version = 99),
        OnnxError::Opset { found: 99 }
    );
    assert_eq!(refused(|model, _| model.opset_import.clear()), OnnxError::Opset { found: 0 });
    let words = |change| refused(change).to_string();
    assert_eq!(
        words(|_, graph| graph.initializer[0].data_location = Some(DataLocation::External.into())),
        "tensor `dense_0.weight`: data in another file cannot be served"
    );
    assert_eq!(
        words(|_, graph| graph.initializer[0].dims = vec![i64::MAX, i64::MAX]),
        format!(
            "tensor `dense_0.weight`: shape [{0}, {0}] and 24 bytes of data do not agree",
            i64::MAX
        )
    );
    assert_eq!(
        words(|_, graph| graph.node[0]
            .attribute
            .push(AttributeProto { g: Some(GraphProto::default()), ..AttributeProto::default() })),
        "node `dense_0` (Gemm): a branch or a loop cannot be served"
    );
    assert_eq!(
        words(|_, graph| graph.node[1].domain = "com.example".into()),
        "node `relu_1` (Relu): an operator that is not part of ONNX cannot be served"
    );
    assert_eq!(
        words(|model, _| model.functions.push(FunctionProto::default())),
        "the file: a model-local function cannot be served"
    );
    assert_eq!(
        words(|_, graph| graph.node.swap(0, 1)),
        "node `relu_1` (Relu): `dense_0` is not defined before"
    );
    assert_eq!(
        words(|_, graph| graph.output[0].name = "elsewhere".into()),
        "the outputs: `elsewhere` is not defined before"
    );
    assert_eq!(
        words(|_, graph| graph.node[1].output[0] = "dense_0".into()),
        "node `relu_1` (Relu): `dense_0` is defined twice"
    );
    assert_eq!(
        words(|_, graph| graph.input.push(super::graph::value("more", "", &[1]))),
        "inputs: must be one, is 2"
    );
    assert_eq!(
        words(|_, graph| graph.input[0] = super::graph::value("voltages_v", "", &[3, 3])),
        "inputs: must be of two dimensions (frames, channels), is of 3 dimensions"
    );
}

#[test]
fn a_net_that_does_not_fit_together_is_refused_by_its_layer() {
    let refused =
        |layers, output: &[usize]| to_onnx(&net(layers, output), &says()).unwrap_err().to_string();
    assert_eq!(
        refused(vec![Layer::Relu, dense(4, 2)], &[2]),
        "layer dense_1: needs a vector of 4, input is a vector of 3"
    );
    let Layer::Dense { weight, .. } = dense(3, 1) else { unreachable!() };
    let short = |bias| Layer::Dense { inputs: 3, outputs: 2, weight: weight.repeat(2), bias };
    assert_eq!(
        refused(vec![short(vec![0.0])], &[2]),
        "layer dense_0: bias holds 1 numbers, must hold 2"
    );
    assert_eq!(
        refused(vec![short(vec![0.0, f32::NAN])], &[2]),
        "layer dense_0: bias holds a number that is not finite"
    );
    assert_eq!(
        refused(vec![Layer::PixelShuffle { factor: 2 }], &[3]),
        "layer pixel_shuffle_0: needs an image of a multiple of 4 channels, input is a vector of 3"
    );
    assert_eq!(
        refused(vec![], &[4]),
        "the result of the last layer is a vector of 3, the answer is [4]"
    );
    let mut residual = net(vec![dense(3, 2)], &[2]);
    residual.form = Form::Residual { floor: 1e-3 };
    assert!(matches!(to_onnx(&residual, &says()), Err(WriteError::Answer { .. })));
}
