//! An ONNX file made ready to answer frames, by tract.
//! Uses: ONNX files that were looked through. Never: files, threads of its own, a guess at a shape.
//!
//! tract is fast where every shape is known, and slow with an open batch (22 ms against 4 ms for a
//! frame through Transfer-Net and Recon-Net). So a file becomes one plan for each of a few batches,
//! and frames go through them in pieces. Plans are only read while they run: any
//! number of callers share one [`Plan`].
//!
//! tract gives up on some malformed graphs by a panic. Panics are caught here and become
//! [`PlanError::Panicked`]; the panic hook still writes its line. An allocation that the system
//! refuses ends the process nevertheless, which is why sizes are checked before anything runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use tract_onnx::prelude::*;
use tract_onnx::tract_core::model::TypedSimplePlan;

use crate::learn::onnx::{OnnxError, OnnxFile};

/// Frames that are answered at once, the larger first, by nets of dense layers: a larger batch reads
/// the weights less often.
pub const BATCHES: [usize; 3] = [64, 8, 1];
/// The same for nets with convolutions, whose images would leave the cache.
pub const IMAGE_BATCHES: [usize; 2] = [8, 1];
/// What makes a net one of images.
const IMAGE_OPERATORS: [&str; 2] = ["Conv", "ConvTranspose"];
/// Most numbers of a tensor between two operations: 256 MiB.
const TENSOR_NUMBERS_MAX: usize = 1 << 26;

/// Why a file does not become a plan, or frames are not answered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The file is refused before it is tried.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// An operation that the engine does not know.
    #[error("operator {operator}: unknown to the engine")]
    Operator {
        /// Its kind.
        operator: String,
    },
    /// A net for other frames.
    #[error(
        "input `{name}` takes {found:?}, must take any number of frames of {channels} channels"
    )]
    Input {
        /// Name of the tensor.
        name: String,
        /// Its lengths, the batch first; `None` is open.
        found: Vec<Option<usize>>,
        /// Channels of the sensor.
        channels: usize,
    },
    /// A net with other answers.
    #[error("output `{name}` gives {found} for {batch} frames, must give {wanted:?} for each")]
    Output {
        /// Name of the tensor.
        name: String,
        /// Its shape.
        found: String,
        /// Frames that were asked for.
        batch: usize,
        /// Shape of one answer.
        wanted: Vec<usize>,
    },
    /// A graph that would need more memory than any net here.
    #[error("operation `{operation}` makes {numbers} numbers: at most {TENSOR_NUMBERS_MAX}")]
    TooLarge {
        /// Its name.
        operation: String,
        /// What it makes.
        numbers: String,
    },
    /// The engine says no, in its own words.
    #[error("{stage}: {cause}")]
    Refused {
        /// What was tried.
        stage: &'static str,
        /// What tract says.
        cause: String,
    },
    /// The engine gave up in the middle.
    #[error("{stage}: the engine gave up: {cause}")]
    Panicked {
        /// What was tried.
        stage: &'static str,
        /// What the panic says.
        cause: String,
    },
    /// Numbers that are no whole frames.
    #[error("{numbers} numbers: must be frames of {channels} channels")]
    Frames {
        /// How many were given.
        numbers: usize,
        /// Channels of the sensor.
        channels: usize,
    },
    /// A frame with a hole.
    #[error("frame {frame}, channel {channel}: not a finite number")]
    NotFinite {
        /// Which frame, from 0.
        frame: usize,
        /// Which channel, from 0.
        channel: usize,
    },
    /// A frame that the net has no answer to: its numbers overflow.
    #[error("frame {frame}: the net's answer is not finite")]
    NoAnswer {
        /// Which frame, from 0.
        frame: usize,
    },
}

/// A net, ready: for frames of one length, with answers of one shape.
#[derive(Debug, Clone)]
pub struct Plan {
    channels: usize,
    output_shape: Vec<usize>,
    /// By batch, the larger first.
    sized: Vec<(usize, Arc<TypedSimplePlan>)>,
}

impl Plan {
    /// Makes the plans of a file, and runs each once, so that the first frame waits for nothing.
    ///
    /// A file whose batch is fixed at one frame has one plan. Fails where the file is malformed, has
    /// operations that are unknown, or does not take frames of `channels` numbers and give answers
    /// of `output_shape`.
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
        // A frame like any other, since a net may divide by a frame's size.
        let frame: Vec<f32> = (0..channels).map(|channel| 1e-3 * (channel % 7) as f32).collect();
        for &(batch, _) in &plan.sized {
            plan.run(&frame.repeat(batch), batch, 0, &mut Vec::new())?;
        }
        Ok(plan)
    }

    /// Numbers of a frame.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Shape of one answer.
    pub fn output_shape(&self) -> &[usize] {
        &self.output_shape
    }

    /// Answers frames, `[n][channels]` in one slice, and appends the answers, `[n][output..]`.
    /// Where one frame fails, nothing is appended.
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

    /// One batch; `first` is the place of its first frame, for messages.
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
            // One, as `OnnxFile` makes sure.
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

/// The graph as tract reads it; shapes are not known yet.
fn parse(onnx: &OnnxFile) -> Result<InferenceModel, PlanError> {
    // Shapes that a file notes along the way may name its own batch: tract finds them itself.
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

/// Every shape is known by now, and none is absurd.
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

/// What the engine does, with its errors and panics as errors that say what was tried.
fn guarded<T>(stage: &'static str, work: impl FnOnce() -> TractResult<T>) -> Result<T, PlanError> {
    // Nothing that the work holds is used after it has panicked: plans are only read, and what it
    // was about to append is cut off by its caller.
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(error)) => Err(PlanError::Refused { stage, cause: format!("{error:#}") }),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or(panic.downcast_ref::<&str>().copied());
            let cause = text.unwrap_or("without a word").to_owned();
            Err(PlanError::Panicked { stage, cause })
        }
    }
}
