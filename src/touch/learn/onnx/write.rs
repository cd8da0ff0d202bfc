//! A net as an ONNX file: operator set 17, normalisation inside, the batch left open.
//! PURE. Uses: a net as plain numbers, the ONNX messages of tract, prost. Never: burn, files.
//!
//! The layers have names in the file (`dense_3`, `dense_3.weight`), except for batch norms, which
//! are merged into the layer before them if possible.

use nets::network::{Form, Layer, Network};
use prost::Message;
use tract_onnx::pb::{AttributeProto, ModelProto, OperatorSetIdProto, StringStringEntryProto};

use super::fold::folded;
use super::graph::{Graph, float, int, ints, text, value};

/// Version of ONNX's file format (1.12) and of its operators.
const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;

/// Why a net cannot be written; a layer is named by its kind and index, as in `dense_3`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum WriteError {
    #[error("layer {layer}: {tensor} holds {found} numbers, must hold {wanted}")]
    Length { layer: String, tensor: &'static str, found: usize, wanted: usize },
    #[error("layer {layer}: {tensor} holds a number that is not finite")]
    NotFinite { layer: String, tensor: &'static str },
    #[error("layer {layer}: needs {wanted}, input is {given}")]
    Shape { layer: String, wanted: String, given: String },
    /// The last layer's shape is not that of the answer, or of the input in the residual form.
    #[error("the result of the last layer is {given}, the answer is {wanted:?}")]
    Answer { given: String, wanted: Vec<usize> },
}

/// Description of a net in its file.
#[derive(Debug, Clone)]
pub struct Description<'a> {
    /// Name of the graph: the net's.
    pub name: &'a str,
    /// Purpose of the net, one sentence.
    pub doc: &'a str,
    /// Name of the input, and its description.
    pub input: [&'a str; 2],
    /// Name of the output, and its description.
    pub output: [&'a str; 2],
    /// Version of the program.
    pub version: &'a str,
    /// Further facts, by name.
    pub properties: &'a [(String, String)],
}

/// Shape between two layers, without the batch.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Vector(usize),
    Image { channels: usize, height: usize, width: usize },
}

impl std::fmt::Display for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Vector(length) => write!(f, "a vector of {length}"),
            Self::Image { channels, height, width } => {
                write!(f, "an image of {channels} x {height} x {width}")
            }
        }
    }
}

impl Shape {
    fn numbers(self) -> usize {
        match self {
            Self::Vector(length) => length,
            Self::Image { channels, height, width } => channels * height * width,
        }
    }
}

/// Returns the bytes of an ONNX file: input `[N, inputs]`, output `[N, output..]`, 32-bit floats.
///
/// # Errors
/// `WriteError` if the numbers or shapes of a layer do not match.
pub fn to_onnx(network: &Network, says: &Description<'_>) -> Result<Vec<u8>, WriteError> {
    let mut writer = Writer {
        graph: Graph::default(),
        last: says.input[0].to_owned(),
        shape: Shape::Vector(network.inputs),
        name: String::new(),
    };
    for (place, layer) in folded(&network.layers).iter().enumerate() {
        writer.layer(place, layer)?;
    }
    writer.answer(network, says)?;
    let graph = writer.graph.close(
        says.name,
        says.doc,
        value(says.input[0], says.input[1], &[network.inputs]),
        value(says.output[0], says.output[1], &network.output),
    );
    let property = |(key, value): &(String, String)| StringStringEntryProto {
        key: key.clone(),
        value: value.clone(),
    };
    let model = ModelProto {
        ir_version: IR_VERSION,
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPSET }],
        producer_name: "palpate".into(),
        producer_version: says.version.into(),
        doc_string: says.doc.into(),
        graph: Some(graph),
        metadata_props: says.properties.iter().map(property).collect(),
        ..ModelProto::default()
    };
    Ok(model.encode_to_vec())
}

/// A graph under construction, and the result of its last operation.
struct Writer {
    graph: Graph,
    /// Input tensor of the next operation.
    last: String,
    shape: Shape,
    /// Name of the current layer.
    name: String,
}

impl Writer {
    fn layer(&mut self, place: usize, layer: &Layer) -> Result<(), WriteError> {
        self.name = format!("{}_{place}", kind(layer));
        match layer {
            Layer::Dense { inputs, outputs, weight, bias } => {
                self.vector_of(*inputs)?;
                let weight = self.tensor("weight", &[*outputs, *inputs], weight)?;
                let bias = self.tensor("bias", &[*outputs], bias)?;
                self.step("Gemm", &[&weight, &bias], [int("transB", 1)]);
                self.shape = Shape::Vector(*outputs);
            }
            Layer::Relu => self.step("Relu", &[], []),
            Layer::Gelu => self.gelu(),
            Layer::BatchNorm { scale, shift, mean, variance, epsilon } => {
                let length = match self.shape {
                    Shape::Vector(length) => length,
                    Shape::Image { channels, .. } => channels,
                };
                let scale = self.tensor("scale", &[length], scale)?;
                let shift = self.tensor("shift", &[length], shift)?;
                let mean = self.tensor("mean", &[length], mean)?;
                let variance = self.tensor("variance", &[length], variance)?;
                let epsilon = float("epsilon", *epsilon);
                self.step("BatchNormalization", &[&scale, &shift, &mean, &variance], [epsilon]);
            }
            Layer::Image { channels, height, width } => {
                let (channels, height, width) = (*channels, *height, *width);
                self.vector_of(channels * height * width)?;
                self.reshape(&[channels, height, width]);
                self.shape = Shape::Image { channels, height, width };
            }
            Layer::ConvTranspose { .. } => self.conv_transpose(layer)?,
            Layer::Conv { inputs, outputs, kernel, weight, bias } => {
                let (height, width) = self.image_of(*inputs)?;
                let shape = [*outputs, *inputs, *kernel, *kernel];
                let tensors = self.weight_and_bias(&shape, weight, *outputs, bias)?;
                let pad = kernel / 2;
                let attributes = [ints("kernel_shape", [*kernel; 2]), ints("pads", [pad; 4])];
                self.step("Conv", &borrowed(&tensors), attributes);
                self.shape = Shape::Image { channels: *outputs, height, width };
            }
            Layer::PixelShuffle { factor } => self.pixel_shuffle(*factor)?,
            Layer::Standardise { mean, sd } => {
                self.vector_of(mean.len())?;
                let mean_name = self.tensor("mean", &[mean.len()], mean)?;
                let sd = self.tensor("sd", &[mean.len()], sd)?;
                self.part("Sub", "centred", &[&mean_name]);
                self.step("Div", &[&sd], []);
            }
            Layer::Clip { limit } => {
                let low = self.tensor("low", &[], &[-*limit])?;
                let high = self.tensor("high", &[], &[*limit])?;
                self.part("Max", "not_below", &[&low]);
                self.step("Min", &[&high], []);
            }
            Layer::Kernel { inputs, centres, gamma } => self.kernel(*inputs, centres, *gamma)?,
            Layer::Scale { scale, shift } => {
                let scale = self.tensor("scale", &[], &[*scale])?;
                let shift = self.tensor("shift", &[], &[*shift])?;
                self.part("Mul", "scaled", &[&scale]);
                self.step("Add", &[&shift], []);
            }
            Layer::UnitNorm { floor, log_scale } => self.unit_norm(*floor, *log_scale)?,
        }
        Ok(())
    }

    /// `x (1 + erf(x / sqrt 2)) / 2`: operator set 17 does not contain the operator Gelu.
    fn gelu(&mut self) {
        let x = self.last.clone();
        let root = self.scalar("root_half", std::f32::consts::FRAC_1_SQRT_2);
        let (one, half) = (self.scalar("one", 1.0), self.scalar("half", 0.5));
        self.part("Mul", "argument", &[&root]);
        self.part("Erf", "erf", &[]);
        self.part("Add", "erf_plus_one", &[&one]);
        self.part("Mul", "twice", &[&x]);
        self.step("Mul", &[&half], []);
    }

    /// `exp(2 gamma x c - gamma |c|^2 - gamma |x|^2)` for each centre c.
    fn kernel(&mut self, inputs: usize, centres: &[f32], gamma: f32) -> Result<(), WriteError> {
        self.vector_of(inputs)?;
        let count = centres.len() / inputs.max(1);
        let doubled: Vec<f32> = centres.iter().map(|x| 2.0 * gamma * x).collect();
        let square = |centre: &[f32]| -gamma * centre.iter().map(|x| x * x).sum::<f32>();
        let squares: Vec<f32> = centres.chunks_exact(inputs.max(1)).map(square).collect();
        let weight = self.tensor("centres", &[count, inputs], &doubled)?;
        let bias = self.tensor("squares", &[count], &squares)?;
        let scale = self.tensor("gamma", &[], &[gamma])?;
        let x = self.last.clone();
        let [length, square, scaled, near, apart] = ["length", "square", "scaled", "near", "apart"]
            .map(|part| format!("{}.{part}", self.name));
        let attributes = [ints("axes", [1]), int("keepdims", 1)];
        self.graph.node("ReduceL2", &length, &[&x], attributes);
        self.graph.node("Mul", &square, &[&length, &length], []);
        self.graph.node("Mul", &scaled, &[&square, &scale], []);
        self.graph.node("Gemm", &near, &[&x, &weight, &bias], [int("transB", 1)]);
        self.graph.node("Sub", &apart, &[&near, &scaled], []);
        self.last = apart;
        self.step("Exp", &[], []);
        self.shape = Shape::Vector(count);
        Ok(())
    }

    fn conv_transpose(&mut self, layer: &Layer) -> Result<(), WriteError> {
        let Layer::ConvTranspose { inputs, outputs, kernel, stride, padding, weight, bias } = layer
        else {
            return Ok(());
        };
        let (height, width) = self.image_of(*inputs)?;
        let grown = |length: usize| {
            ((length.max(1) - 1) * stride + kernel).checked_sub(2 * padding).filter(|&l| l > 0)
        };
        let (Some(height), Some(width)) = (grown(height), grown(width)) else {
            return Err(self.unfit("an image larger than the padding".into()));
        };
        let shape = [*inputs, *outputs, *kernel, *kernel];
        let tensors = self.weight_and_bias(&shape, weight, *outputs, bias)?;
        let attributes = [
            ints("kernel_shape", [*kernel; 2]),
            ints("strides", [*stride; 2]),
            ints("pads", [*padding; 4]),
        ];
        self.step("ConvTranspose", &borrowed(&tensors), attributes);
        self.shape = Shape::Image { channels: *outputs, height, width };
        Ok(())
    }

    fn pixel_shuffle(&mut self, factor: usize) -> Result<(), WriteError> {
        let square = factor * factor;
        let (channels, height, width) = match self.shape {
            Shape::Image { channels, height, width }
                if square > 0 && channels.is_multiple_of(square) =>
            {
                (channels / square, height * factor, width * factor)
            }
            _ => return Err(self.unfit(format!("an image of a multiple of {square} channels"))),
        };
        self.step("DepthToSpace", &[], [int("blocksize", factor), text("mode", "CRD")]);
        self.shape = Shape::Image { channels, height, width };
        Ok(())
    }

    fn unit_norm(&mut self, floor: f32, log_scale: Option<f32>) -> Result<(), WriteError> {
        let Shape::Vector(length) = self.shape else {
            return Err(self.unfit("a vector".into()));
        };
        let x = self.last.clone();
        let norm = self.norm(&x, floor)?;
        let unit = format!("{}.unit", self.name);
        let Some(log_scale) = log_scale else {
            self.step("Div", &[&norm], []);
            return Ok(());
        };
        self.graph.node("Div", &unit, &[&x, &norm], []);
        let log_scale = self.tensor("log_scale", &[], &[log_scale])?;
        self.last = norm;
        self.part("Log", "log_norm", &[]);
        self.part("Mul", "scaled_log_norm", &[&log_scale]);
        let log = std::mem::replace(&mut self.last, unit);
        self.step("Concat", &[&log], [int("axis", 1)]);
        self.shape = Shape::Vector(length + 1);
        Ok(())
    }

    /// `max(|x|, floor)`, `[N, 1]`.
    fn norm(&mut self, x: &str, floor: f32) -> Result<String, WriteError> {
        let floor = self.tensor("floor", &[], &[floor])?;
        let length = format!("{}.length", self.name);
        let attributes = [ints("axes", [1]), int("keepdims", 1)];
        self.graph.node("ReduceL2", &length, &[x], attributes);
        let norm = format!("{}.norm", self.name);
        Ok(self.graph.node("Max", &norm, &[&length, &floor], []))
    }

    /// Writes the answer under the output's name: the result of the last layer, or its sum with the
    /// input.
    fn answer(&mut self, network: &Network, says: &Description<'_>) -> Result<(), WriteError> {
        let wanted = &network.output;
        let like_input = matches!(network.form, Form::Plain) || *wanted == [network.inputs];
        if self.shape.numbers() != wanted.iter().product::<usize>() || !like_input {
            let given = self.shape.to_string();
            return Err(WriteError::Answer { given, wanted: wanted.clone() });
        }
        self.name = "answer".into();
        let output = says.output[0];
        match network.form {
            Form::Residual { floor } => {
                let norm = self.norm(says.input[0], floor)?;
                self.part("Mul", "difference", &[&norm]);
                self.graph.node("Add", output, &[says.input[0], &self.last], []);
            }
            Form::Plain if matches!(self.shape, Shape::Vector(_)) && wanted.len() == 1 => {
                self.graph.node("Identity", output, &[&self.last], []);
            }
            Form::Plain => {
                let shape = self.graph.integers("answer.shape", &shape_of(wanted));
                self.graph.node("Reshape", output, &[&self.last, &shape], []);
            }
        }
        Ok(())
    }

    fn reshape(&mut self, shape: &[usize]) {
        let shape = self.graph.integers(&format!("{}.shape", self.name), &shape_of(shape));
        self.step("Reshape", &[&shape], []);
    }

    /// Adds an operation on the last result and `more`, whose result is that of the layer.
    fn step<const A: usize>(&mut self, kind: &str, more: &[&str], attributes: [AttributeProto; A]) {
        let inputs = [&[self.last.as_str()], more].concat();
        self.last = self.graph.node(kind, &self.name, &inputs, attributes);
    }

    /// Adds an operation within a layer.
    fn part(&mut self, kind: &str, part: &str, more: &[&str]) {
        let name = format!("{}.{part}", self.name);
        let inputs = [&[self.last.as_str()], more].concat();
        self.last = self.graph.node(kind, &name, &inputs, []);
    }

    /// Adds a layer's tensor, if its length matches its shape and all values are finite.
    fn tensor(
        &mut self,
        tensor: &'static str,
        shape: &[usize],
        values: &[f32],
    ) -> Result<String, WriteError> {
        let (layer, found) = (self.name.clone(), values.len());
        let wanted = shape.iter().product();
        if found != wanted {
            return Err(WriteError::Length { layer, tensor, found, wanted });
        }
        if !values.iter().all(|value| value.is_finite()) {
            return Err(WriteError::NotFinite { layer, tensor });
        }
        Ok(self.graph.floats(&format!("{layer}.{tensor}"), shape, values))
    }

    fn scalar(&mut self, tensor: &str, value: f32) -> String {
        self.graph.floats(&format!("{}.{tensor}", self.name), &[], &[value])
    }

    /// Adds a kernel, and a bias unless it is empty.
    fn weight_and_bias(
        &mut self,
        shape: &[usize],
        weight: &[f32],
        outputs: usize,
        bias: &[f32],
    ) -> Result<Vec<String>, WriteError> {
        let mut tensors = vec![self.tensor("weight", shape, weight)?];
        if !bias.is_empty() {
            tensors.push(self.tensor("bias", &[outputs], bias)?);
        }
        Ok(tensors)
    }

    fn vector_of(&self, length: usize) -> Result<(), WriteError> {
        let wanted = Shape::Vector(length);
        if self.shape == wanted { Ok(()) } else { Err(self.unfit(wanted.to_string())) }
    }

    /// Height and width of an image with `wanted` channels.
    fn image_of(&self, wanted: usize) -> Result<(usize, usize), WriteError> {
        match self.shape {
            Shape::Image { channels, height, width } if channels == wanted => Ok((height, width)),
            _ => Err(self.unfit(format!("an image of {wanted} channels"))),
        }
    }

    fn unfit(&self, wanted: String) -> WriteError {
        WriteError::Shape { layer: self.name.clone(), wanted, given: self.shape.to_string() }
    }
}

fn kind(layer: &Layer) -> &'static str {
    match layer {
        Layer::Dense { .. } => "dense",
        Layer::Relu => "relu",
        Layer::Gelu => "gelu",
        Layer::BatchNorm { .. } => "batch_norm",
        Layer::Image { .. } => "image",
        Layer::ConvTranspose { .. } => "conv_transpose",
        Layer::Conv { .. } => "conv",
        Layer::PixelShuffle { .. } => "pixel_shuffle",
        Layer::Standardise { .. } => "standardise",
        Layer::Clip { .. } => "clip",
        Layer::Kernel { .. } => "kernel",
        Layer::Scale { .. } => "scale",
        Layer::UnitNorm { .. } => "unit_norm",
    }
}

/// A shape for Reshape, which keeps the batch at a zero.
fn shape_of(lengths: &[usize]) -> Vec<i64> {
    std::iter::once(0).chain(lengths.iter().map(|&length| length as i64)).collect()
}

fn borrowed(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}
