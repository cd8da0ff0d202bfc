//! An ONNX file prepared for inference, by tract.
//! Uses: checked ONNX files. Never: files, its own threads, an assumed shape.
//!
//! tract is fast if every shape is known, and slow with an open batch (22 ms compared with 4 ms for
//! a frame through Transfer-Net and Recon-Net). A file therefore becomes one plan for each of a few
//! batch sizes, and frames are processed in pieces of these sizes. Plans are read-only while they
//! run: any number of callers share one [`Plan`].
//!
//! tract panics on some malformed graphs. Panics are caught here and become
//! [`PlanError::Panicked`]; the panic hook still writes its line. An allocation that the system
//! refuses ends the process nevertheless, which is why sizes are checked before anything runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::model::TypedSimplePlan;

use crate::learn::onnx::{OnnxError, OnnxFile};

/// Batch sizes of nets of dense layers, the largest first: a larger batch reads the weights less
/// often.
pub const BATCHES: [usize; 3] = [64, 8, 1];
/// Batch sizes of nets with convolutions, whose images would not fit into the cache.
pub const IMAGE_BATCHES: [usize; 2] = [8, 1];
/// Operators that identify nets with images.
const IMAGE_OPERATORS: [&str; 2] = ["Conv", "ConvTranspose"];
/// Largest number of values of a tensor between two operations: 256 MiB.
const TENSOR_NUMBERS_MAX: usize = 1 << 26;

/// Why a file cannot become a plan, or frames cannot be answered; frames and channels count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum PlanError {
    /// The file is rejected before it is loaded.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    #[error("operator {operator}: not supported by the engine")]
    Operator { operator: String },
    /// `found`: lengths, batch first; `None` is open.
    #[error(
        "input `{name}` takes {found:?}, must take any number of frames of {channels} channels"
    )]
    Input { name: String, found: Vec<Option<usize>>, channels: usize },
    #[error("output `{name}` is {found} for {batch} frames, must be {wanted:?} for each")]
    Output { name: String, found: String, batch: usize, wanted: Vec<usize> },
    #[error("operation `{operation}` has {numbers} numbers: at most {TENSOR_NUMBERS_MAX}")]
    TooLarge { operation: String, numbers: String },
    /// The engine returned an error.
    #[error("{stage}: {cause}")]
    Refused { stage: &'static str, cause: String },
    #[error("{stage}: the engine panicked: {cause}")]
    Panicked { stage: &'static str, cause: String },
    #[error("{numbers} numbers: must be frames of {channels} channels")]
    Frames { numbers: usize, channels: usize },
    #[error("frame {frame}, channel {channel}: not a finite number")]
    NotFinite { frame: usize, channel: usize },
    #[error("frame {frame}: the net's answer is not finite")]
    NoAnswer { frame: usize },
}

/// A net prepared for frames of one length, with answers of one shape.
#[derive(Debug, Clone)]
pub struct Plan {
    channels: usize,
    output_shape: Vec<usize>,
    /// Batch size and plan, the largest first.
    sized: Vec<(usize, Arc<TypedSimplePlan>)>,
}

impl Plan {
    /// Builds the plans of a file, and runs each once, so that the first frame is not delayed.
    ///
    /// A file whose batch is fixed at one frame has one plan.
    ///
    /// # Errors
    /// `PlanError` if the file is malformed, has unsupported operations, or does not map frames of
    /// `channels` numbers to answers of `output_shape`.
    pub fn load(file: &[u8], channels: usize, output_shape: &[usize]) -> Result<Self, PlanError> {
        let onnx = OnnxFile::read(file)?;
        let images = onnx.operators().iter().any(|kind| IMAGE_OPERATORS.contains(kind));
        let fits = |found: Option<usize>| found.is_none_or(|found| found == channels);
        let batches = match onnx.input().dimensions[..] {
            [Some(1), found] if fits(found) => &[1][..],
            [None, found] if fits(found) && images => &IMAGE_BATCHES,
            [None, found] if fits(found) => &BATCHES,
            ref found => {
                let (name, found) = (onnx.input().name.clone(), found.to_vec());
                return Err(PlanError::Input { name, found, channels });
            }
        };
        let parsed = parse(&onnx)?;
        let sized = batches.iter().map(|&batch| {
            let plan = plan_for(&parsed, batch, channels, &onnx.output().name, output_shape)?;
            Ok((batch, plan))
        });
        let sized = sized.collect::<Result<_, PlanError>>()?;
        let plan = Self { channels, output_shape: output_shape.to_vec(), sized };
        // A usual frame, since a net may divide by its norm.
        let frame: Vec<f32> = (0..channels).map(|channel| 1e-3 * (channel % 7) as f32).collect();
        for &(batch, _) in &plan.sized {
            plan.run(&frame.repeat(batch), batch, 0, &mut Vec::new())?;
        }
        Ok(plan)
    }

    /// Length of a frame.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Shape of one answer.
    pub fn output_shape(&self) -> &[usize] {
        &self.output_shape
    }

    /// Answers frames, `[n][channels]` in one slice, and appends the answers, `[n][output..]`. If
    /// one frame fails, nothing is appended.
    ///
    /// # Errors
    /// `Frames` or `NotFinite` if the input is invalid; `NoAnswer` if an answer is not finite;
    /// `Refused` or `Panicked` if the engine fails.
    pub fn answer(&self, frames: &[f32], out: &mut Vec<f32>) -> Result<(), PlanError> {
        let (numbers, channels) = (frames.len(), self.channels);
        if !numbers.is_multiple_of(channels) {
            return Err(PlanError::Frames { numbers, channels });
        }
        if let Some(hole) = frames.iter().position(|v| !v.is_finite()) {
            let (frame, channel) = (hole / channels, hole % channels);
            return Err(PlanError::NotFinite { frame, channel });
        }
        let before = out.len();
        let answered = self.answer_in_pieces(frames, out);
        if answered.is_err() {
            out.truncate(before);
        }
        answered
    }

    fn answer_in_pieces(&self, frames: &[f32], out: &mut Vec<f32>) -> Result<(), PlanError> {
        let mut done = 0;
        for &(batch, _) in &self.sized {
            let pieces = frames[done * self.channels..].chunks_exact(batch * self.channels);
            for piece in pieces {
                self.run(piece, batch, done, out)?;
                done += batch;
            }
        }
        Ok(())
    }

    /// Runs one batch; `first` is the index of its first frame, for messages.
    fn run(
        &self,
        frames: &[f32],
        batch: usize,
        first: usize,
        out: &mut Vec<f32>,
    ) -> Result<(), PlanError> {
        let sized = self.sized.iter().find(|(size, _)| *size == batch);
        let (_, plan) = sized.expect("a batch that a plan was made for");
        let numbers = self.output_shape.iter().product::<usize>();
        let before = out.len();
        guarded("answering", || {
            let input = Tensor::from_shape(&[batch, self.channels], frames)?;
            let outputs = plan.run(tvec!(input.into()))?;
            // Exactly one output, as `OnnxFile` checks.
            for answer in outputs {
                out.extend_from_slice(answer.try_as_plain_ram()?.as_slice::<f32>()?);
            }
            Ok(())
        })?;
        match out[before..].iter().position(|value| !value.is_finite()) {
            Some(place) => Err(PlanError::NoAnswer { frame: first + place / numbers }),
            None => Ok(()),
        }
    }
}

/// The graph as tract reads it; shapes are unknown.
fn parse(onnx: &OnnxFile) -> Result<InferenceModel, PlanError> {
    // Intermediate shapes stated in a file may name its own batch: tract infers them itself.
    let engine = tract_onnx::onnx().with_ignore_value_info(true);
    let unknown = |kind: &&&str| !engine.op_register.0.contains_key(**kind);
    if let Some(operator) = onnx.operators().iter().find(unknown) {
        return Err(PlanError::Operator { operator: (*operator).to_owned() });
    }
    guarded("reading the graph", || Ok(engine.parse(onnx.model(), None)?.model))
}

fn plan_for(
    parsed: &InferenceModel,
    batch: usize,
    channels: usize,
    name: &str,
    output_shape: &[usize],
) -> Result<Arc<TypedSimplePlan>, PlanError> {
    let typed = guarded("working out shapes", || {
        let fact = InferenceFact::dt_shape(f32::datum_type(), [batch, channels]);
        parsed.clone().with_input_fact(0, fact)?.into_typed()
    })?;
    check_sizes(&typed)?;
    let optimised = guarded("optimising", || typed.into_optimized())?;
    check_sizes(&optimised)?;
    let found = guarded("working out shapes", || optimised.output_fact(0).cloned())?;
    let wanted: Vec<usize> = std::iter::once(batch).chain(output_shape.iter().copied()).collect();
    let fits = found.shape.as_concrete() == Some(&wanted) && found.datum_type == f32::datum_type();
    if !fits {
        let (name, found) = (name.to_owned(), format!("{found:?}"));
        return Err(PlanError::Output { name, found, batch, wanted: output_shape.to_vec() });
    }
    guarded("planning", || optimised.into_runnable())
}

/// Checks that every shape is known and within the limit.
fn check_sizes(model: &TypedModel) -> Result<(), PlanError> {
    for node in &model.nodes {
        for outlet in &node.outputs {
            let lengths = outlet.fact.shape.as_concrete();
            let numbers = lengths.and_then(|lengths| {
                lengths.iter().try_fold(1_usize, |product, &length| product.checked_mul(length))
            });
            if numbers.is_none_or(|numbers| numbers > TENSOR_NUMBERS_MAX) {
                let numbers = numbers.map_or(format!("{:?}", outlet.fact), |n| n.to_string());
                return Err(PlanError::TooLarge { operation: node.name.clone(), numbers });
            }
        }
    }
    Ok(())
}

/// Runs the engine and converts its errors and panics to errors that name the stage.
fn guarded<T>(stage: &'static str, work: impl FnOnce() -> TractResult<T>) -> Result<T, PlanError> {
    // Nothing that the work holds is used after a panic: plans are read-only, and the caller
    // truncates the output.
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(error)) => Err(PlanError::Refused { stage, cause: format!("{error:#}") }),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or(panic.downcast_ref::<&str>().copied());
            let cause = text.unwrap_or("without a message").to_owned();
            Err(PlanError::Panicked { stage, cause })
        }
    }
}
