//! Answers of `exact` in chunks: the readings of some frames of an evaluation, which the work order contains.
//! Uses: `chunk`, `frames`, the fits of `exact`, threads. Never: the store, a dataset, a score.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sim_core::batch::Kernel;
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::ForwardModel;

use super::ReadingInputs;
use super::frames::FrameInput;
use crate::chunk::error::ChunkError;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::{
    ChunkRow, WorkOrder, check_here, chunk_input, chunk_inputs, invalid, read_input,
};
use crate::chunk::skin::{ordered_skin, skin_inputs};
use crate::chunk::{MakeChunks, Tell, WrittenChunk, in_shares};
use crate::digest::sha256_hex;
use crate::evaluate::request::EvaluationRequest;
use crate::ids::DatasetId;
use crate::infer::answer::Reading;
use crate::infer::maps::ForceMaps;
use crate::infer::methods::ReadyMethod;
use crate::infer::methods::exact::{ExactPipeline, ExactSkin, SkinErrors};
use crate::new_file::NewFile;
use crate::problem::Problem;

/// Kind of the chunks.
pub const READINGS: &str = "readings";
/// Version of the lines of a chunk, and of the fits: increased by a change that gives other bytes, also one of the
/// search of `exact` (`infer::methods::exact`, sim-core's `inverse::contacts`).
const READINGS_VERSION: u32 = 2;
/// Input of a work order: the errors of the skin, JSON.
const READINGS_ERRORS: &str = "errors";
/// Start of the names of the inputs with the frames of a chunk.
const FRAMES: &str = "frames";
/// Number of frames that a thread reads between two looks at a request to stop.
const READ_BETWEEN: usize = 4;

/// Everything that determines the bytes of all chunks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadingsDefinition {
    /// Version of lines and fits.
    pub format_version: u32,
    /// What the readings are for; it names the frames.
    pub request: EvaluationRequest,
    /// Dataset of the frames.
    pub dataset: DatasetId,
    /// Simulation id of the skin's model.
    pub model: String,
    /// Vector instructions of the service's processor: the last digits of a fit depend on them.
    pub kernel: String,
    /// sha256 of the errors of the skin's model.
    pub errors: String,
    /// sha256 of the frames of each chunk, as [`FrameInput::lines`] writes them.
    pub frames: Vec<String>,
}

/// Returns the work order of an evaluation.
pub fn work_order(request: EvaluationRequest, inputs: ReadingInputs) -> WorkOrder {
    let ReadingInputs { dataset, simulation, kernel, sensor, calibration, errors, frames, .. } =
        inputs;
    let definition = ReadingsDefinition {
        format_version: READINGS_VERSION,
        request,
        dataset,
        model: simulation,
        kernel,
        errors: sha256_hex(&errors),
        frames: frames.iter().map(sha256_hex).collect(),
    };
    let chunks = frames.len() as u64;
    let mut texts = skin_inputs(sensor, calibration);
    texts.insert(READINGS_ERRORS.to_owned(), errors);
    texts.extend(chunk_inputs(FRAMES, frames));
    WorkOrder::new(READINGS, &definition, texts, chunks)
}

/// What a work order of readings states.
#[derive(Debug, Clone)]
pub struct ReadingsOrder {
    /// Definition of the chunks.
    pub definition: ReadingsDefinition,
    /// The skin, calibrated if the evaluation uses a calibration.
    pub sensor: CalibratedSensor,
    errors: SkinErrors,
    /// Texts of the order, by name.
    inputs: BTreeMap<String, String>,
}

impl ReadingsOrder {
    /// Reads a work order.
    ///
    /// # Errors
    /// The first value that is wrong, by its key in the work order.
    pub fn read(order: &WorkOrder) -> Result<Self, Problem> {
        let definition: ReadingsDefinition = order.read_definition()?;
        order.check_chunks(definition.frames.len() as u64)?;
        let sensor = ordered_skin(order)?;
        let errors = order.inputs.get(READINGS_ERRORS).map_or("", String::as_str);
        if sha256_hex(errors) != definition.errors {
            return Err(invalid("inputs.errors", "must be those of the definition"));
        }
        let errors: SkinErrors =
            serde_json::from_str(errors).map_err(|error| invalid("inputs.errors", error))?;
        let channels = sensor.channels();
        if errors.channels() != channels {
            return Err(invalid("inputs.errors", format!("must have {channels} channels")));
        }
        Ok(Self { definition, sensor, errors, inputs: order.inputs.clone() })
    }

    /// The frames of a chunk, which must have the sha256 of the definition.
    fn chunk(&self, index: u64) -> Result<Vec<FrameInput>, String> {
        let stated = &self.definition.frames;
        let (inputs, _) = read_input(FRAMES, index, &self.inputs, stated, FrameInput::read)?;
        let channels = self.sensor.channels();
        match inputs.iter().all(|input| input.voltages_v.len() == channels) {
            true => Ok(inputs),
            false => {
                let name = chunk_input(FRAMES, index);
                Err(format!("{name}: must have {channels} voltages per frame"))
            }
        }
    }

    /// sha256 of the frames of all chunks, one after the other.
    pub fn frames_sha256(&self) -> String {
        let names = (0..self.definition.frames.len() as u64).map(|at| chunk_input(FRAMES, at));
        let texts = names.filter_map(|name| self.inputs.get(&name).map(String::as_str));
        sha256_hex(texts.collect::<String>())
    }
}

/// Makes the readings of a work order, each chunk on all of its threads.
pub struct ReadingChunks {
    order: ReadingsOrder,
    method: ExactPipeline,
    threads: NonZeroUsize,
}

impl ReadingChunks {
    /// Maker of an order's chunks with the model of its sensor. The fit is prepared, which takes seconds.
    ///
    /// # Errors
    /// The first value of the definition that this program, model or processor does not have.
    pub fn new(
        order: ReadingsOrder,
        model: &ForwardModel,
        threads: NonZeroUsize,
    ) -> Result<Self, Problem> {
        let here = ReadingsDefinition {
            format_version: READINGS_VERSION,
            model: model.model_hash().to_owned(),
            kernel: Kernel::detect().name().to_owned(),
            ..order.definition.clone()
        };
        check_here(&order.definition, &here, |found| {
            format!(
                "here it is {}; read the frames on machines like that of the service",
                found.here
            )
        })?;
        let skin = ExactSkin::with(model, order.errors.clone())
            .map_err(|error| invalid("inputs.errors", error))?;
        Ok(Self { method: ExactPipeline { skin: Arc::new(skin), points: None }, order, threads })
    }

    /// The readings of some frames, in their order.
    fn readings(&self, inputs: &[FrameInput]) -> Result<Vec<Reading>, String> {
        in_shares(inputs, self.threads, |inputs| {
            let mut readings = Vec::new();
            for input in inputs {
                let read = self.method.read(&input.frames(), ForceMaps::Without);
                readings.extend(read.map_err(|error| error.to_string())?);
            }
            Ok(readings)
        })
    }
}

impl MakeChunks for ReadingChunks {
    fn write(&mut self, index: u64, mut out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk {
        use std::io::Write;
        let inputs = self.order.chunk(index)?;
        for inputs in inputs.chunks(READ_BETWEEN * self.threads.get()) {
            for reading in self.readings(inputs)? {
                let mut line = serde_json::to_vec(&reading)?;
                line.push(b'\n');
                out.write_all(&line)?;
            }
            if tell(inputs.len() as u64).is_break() {
                return Ok(None);
            }
        }
        Ok(Some((out, inputs.len() as u64)))
    }
}

/// Reads the chunks of a work order, which have these rows; `tell` receives a call for each chunk. Returns the readings
/// of all frames, a line of JSON each.
///
/// # Errors
/// `ChunkError::File` if a chunk cannot be read, `Incomplete` if any is damaged.
pub fn gather(
    chunks: &OrderFolder,
    rows: &[ChunkRow],
    tell: &mut dyn FnMut(),
) -> Result<Vec<u8>, ChunkError> {
    let (mut lines, mut damaged) = (Vec::new(), Vec::new());
    for row in rows {
        match chunks.bytes(row)? {
            Some(bytes) => {
                lines.extend(bytes);
                tell();
            }
            None => damaged.push(row.index),
        }
    }
    chunks.all_whole(damaged)?;
    Ok(lines)
}
