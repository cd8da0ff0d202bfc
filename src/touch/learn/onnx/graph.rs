//! Parts of an ONNX graph: tensors, operations, attributes.
//! PURE. Uses: the ONNX messages of tract. Never: the meaning of the graph.

use tract_onnx::pb::attribute_proto::AttributeType;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension::Value as Length};
use tract_onnx::pb::type_proto::{Tensor, Value as Type};
use tract_onnx::pb::{
    AttributeProto, GraphProto, NodeProto, TensorProto, TensorShapeProto, TypeProto, ValueInfoProto,
};

/// Name of the batch's dimension.
const BATCH_DIMENSION: &str = "N";

/// A graph under construction.
#[derive(Debug, Default)]
pub(super) struct Graph {
    graph: GraphProto,
}

impl Graph {
    /// An operation with one output, which is named like the operation.
    pub(super) fn node<const A: usize>(
        &mut self,
        kind: &str,
        name: &str,
        inputs: &[&str],
        attributes: [AttributeProto; A],
    ) -> String {
        self.graph.node.push(NodeProto {
            op_type: kind.into(),
            name: name.into(),
            input: inputs.iter().map(|&input| input.to_owned()).collect(),
            output: vec![name.into()],
            attribute: attributes.into(),
            ..NodeProto::default()
        });
        name.to_owned()
    }

    /// Adds a tensor of floats, little-endian as ONNX requires.
    pub(super) fn floats(&mut self, name: &str, shape: &[usize], values: &[f32]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, shape, DataType::Float, bytes)
    }

    /// Adds a vector of integers, for example a shape.
    pub(super) fn integers(&mut self, name: &str, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, &[values.len()], DataType::Int64, bytes)
    }

    fn tensor(&mut self, name: &str, shape: &[usize], kind: DataType, bytes: Vec<u8>) -> String {
        self.graph.initializer.push(TensorProto {
            name: name.into(),
            dims: shape.iter().map(|&length| length as i64).collect(),
            data_type: kind.into(),
            raw_data: bytes,
            ..TensorProto::default()
        });
        name.to_owned()
    }

    /// Completes the graph with its name, description, input and output.
    pub(super) fn close(
        mut self,
        name: &str,
        doc: &str,
        input: ValueInfoProto,
        output: ValueInfoProto,
    ) -> GraphProto {
        self.graph.name = name.into();
        self.graph.doc_string = doc.into();
        self.graph.input.push(input);
        self.graph.output.push(output);
        self.graph
    }
}

/// An input or output of floats, `[N, shape..]`.
pub(super) fn value(name: &str, doc: &str, shape: &[usize]) -> ValueInfoProto {
    let batch = Length::DimParam(BATCH_DIMENSION.into());
    let lengths = shape.iter().map(|&length| Length::DimValue(length as i64));
    let dim = std::iter::once(batch).chain(lengths);
    let dim = dim.map(|value| Dimension { value: Some(value), ..Dimension::default() }).collect();
    let tensor =
        Tensor { elem_type: DataType::Float.into(), shape: Some(TensorShapeProto { dim }) };
    let kind = TypeProto { value: Some(Type::TensorType(tensor)), ..TypeProto::default() };
    ValueInfoProto { name: name.into(), doc_string: doc.into(), r#type: Some(kind) }
}

fn attribute(name: &str, kind: AttributeType) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: kind.into(), ..AttributeProto::default() }
}

/// An integer attribute.
pub(super) fn int(name: &str, value: usize) -> AttributeProto {
    AttributeProto { i: value as i64, ..attribute(name, AttributeType::Int) }
}

/// An attribute of several integers.
pub(super) fn ints<const K: usize>(name: &str, values: [usize; K]) -> AttributeProto {
    let ints = values.map(|value| value as i64).into();
    AttributeProto { ints, ..attribute(name, AttributeType::Ints) }
}

pub(super) fn float(name: &str, value: f32) -> AttributeProto {
    AttributeProto { f: value, ..attribute(name, AttributeType::Float) }
}

pub(super) fn text(name: &str, value: &str) -> AttributeProto {
    AttributeProto { s: value.into(), ..attribute(name, AttributeType::String) }
}
