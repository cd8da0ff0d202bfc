//! Twins of a run in chunks: the frames of consecutive trials, from contacts that the work order contains.
//! Uses: `chunk`, `file`, sim-core, threads. Never: a store, a rig, an order in which chunks are made.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use serde::{Deserialize, Serialize};
use sim_core::batch::Kernel;
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::{ForwardModel, Workspace};

use super::file::{TwinRow, TwinsFile, TwinsHead};
use super::{TwinInput, twin_frame};
use crate::chunk::order::{WorkOrder, check_here, chunk_inputs, read_input};
use crate::chunk::skin::{ordered_skin, skin_inputs};
use crate::chunk::{MakeChunks, Tell, WrittenChunk, in_shares};
use crate::digest::sha256_hex;
use crate::ids::RunUid;
use crate::new_file::NewFile;
use crate::problem::Problem;
use crate::simulate::random::manifest::byte_makers;

/// Kind of the chunks.
pub const TWINS: &str = "twins";
/// Version of the columns and settings of a chunk: increased by a change that gives other bytes.
const TWINS_VERSION: u32 = 1;
/// Start of the names of the inputs with the contacts of a chunk.
const CONTACTS: &str = "contacts";
/// Number of trials that a thread simulates between two looks at a request to stop.
const TOLD_TRIALS: usize = 64;

/// Everything that determines the bytes of all chunks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinsDefinition {
    /// Version of columns and settings.
    pub format_version: u32,
    /// Run of the trials.
    pub run: RunUid,
    /// Simulation id of the model of its skin.
    pub model: String,
    /// Vector instructions of the service's processor: the last digits of a frame depend on them.
    pub kernel: String,
    /// Versions of the libraries that produce bytes.
    pub libraries: BTreeMap<String, String>,
    /// sha256 of the contacts of each chunk, as [`TwinInput::lines`] writes them.
    pub contacts: Vec<String>,
}

/// The skin of a run, as the service that stored it simulates it.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinSkin {
    /// Run whose skin it is.
    pub run: RunUid,
    /// Simulation id of its model.
    pub model: String,
    /// Vector instructions of the service's processor.
    pub kernel: String,
    /// Text of the sensor file.
    pub sensor: String,
    /// Text of the calibration file; `None` for the nominal model.
    pub calibration: Option<String>,
}

/// Returns the work order of the twins of a run. `contacts`: those of each chunk, as [`TwinInput::lines`] writes them.
pub fn work_order(skin: TwinSkin, contacts: Vec<String>) -> WorkOrder {
    let TwinSkin { run, model, kernel, sensor, calibration } = skin;
    let definition = TwinsDefinition {
        format_version: TWINS_VERSION,
        run,
        model,
        kernel,
        libraries: byte_makers(),
        contacts: contacts.iter().map(sha256_hex).collect(),
    };
    let chunks = contacts.len() as u64;
    let mut inputs = skin_inputs(sensor, calibration);
    inputs.extend(chunk_inputs(CONTACTS, contacts));
    WorkOrder::new(TWINS, &definition, inputs, chunks)
}

/// What a work order of twins states.
#[derive(Debug, Clone)]
pub struct TwinsOrder {
    /// Definition of the chunks.
    pub definition: TwinsDefinition,
    /// The skin, calibrated if the service has a calibration of it.
    pub sensor: CalibratedSensor,
    /// Texts of the order, by name.
    inputs: BTreeMap<String, String>,
}

impl TwinsOrder {
    /// Reads a work order.
    ///
    /// # Errors
    /// The first value that is wrong, by its key in the work order.
    pub fn read(order: &WorkOrder) -> Result<Self, Problem> {
        let definition: TwinsDefinition = order.read_definition()?;
        order.check_chunks(definition.contacts.len() as u64)?;
        Ok(Self { definition, sensor: ordered_skin(order)?, inputs: order.inputs.clone() })
    }
}

/// Makes the twins of a work order, each chunk on all of its threads.
pub struct TwinChunks {
    order: TwinsOrder,
    model: ForwardModel,
    threads: NonZeroUsize,
}

impl TwinChunks {
    /// Maker of an order's chunks with the model of its sensor.
    ///
    /// # Errors
    /// The first value of the definition that this program, model or processor does not have.
    pub fn new(
        order: TwinsOrder,
        model: ForwardModel,
        threads: NonZeroUsize,
    ) -> Result<Self, Problem> {
        let here = TwinsDefinition {
            format_version: TWINS_VERSION,
            model: model.model_hash().to_owned(),
            kernel: Kernel::detect().name().to_owned(),
            libraries: byte_makers(),
            ..order.definition.clone()
        };
        check_here(&order.definition, &here, |found| match found.field.as_str() {
            "kernel" => format!(
                "this processor computes with {}; make the twins on machines like that of the service",
                found.here
            ),
            _ => format!("this program makes {}", found.here),
        })?;
        Ok(Self { order, model, threads })
    }

    /// The twins of some inputs, in their order.
    fn rows(&self, inputs: &[TwinInput]) -> Result<Vec<TwinRow>, String> {
        in_shares(inputs, self.threads, |inputs| {
            let mut work = Workspace::default();
            let row = |input: &TwinInput| TwinRow {
                trial: input.trial,
                frame_v: twin_frame(&self.model, input.contacts.as_deref(), &mut work).ok(),
            };
            Ok(inputs.iter().map(row).collect())
        })
    }
}

impl MakeChunks for TwinChunks {
    fn write(&mut self, index: u64, out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk {
        let TwinsDefinition { run, model, contacts, .. } = &self.order.definition;
        let (inputs, contacts_sha256) =
            read_input(CONTACTS, index, &self.order.inputs, contacts, TwinInput::read)?;
        let head = TwinsHead {
            run: *run,
            model: model.clone(),
            contacts_sha256: contacts_sha256.to_owned(),
        };
        let mut rows = Vec::with_capacity(inputs.len());
        for inputs in inputs.chunks(TOLD_TRIALS * self.threads.get()) {
            rows.extend(self.rows(inputs)?);
            if tell(inputs.len() as u64).is_break() {
                return Ok(None);
            }
        }
        let count = rows.len() as u64;
        let file = TwinsFile { head, rows };
        Ok(Some((file.write(self.order.sensor.channels(), out)?, count)))
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::ops::ControlFlow;

    use sim_core::forward::Contact;

    use super::*;
    use crate::calibrate::paper::{MODEL, SENSOR};
    use crate::chunk::folder::OrderFolder;
    use crate::chunk::skin::CALIBRATION_INPUT;
    use crate::ids::TrialId;

    fn skin() -> TwinSkin {
        TwinSkin {
            run: RunUid::new(),
            model: MODEL.model_hash().into(),
            kernel: Kernel::detect().name().into(),
            sensor: SENSOR.into(),
            calibration: None,
        }
    }

    /// Trials with up to three contacts; of each fifth one they are unknown, and a contact of each seventh one is off
    /// the skin.
    fn inputs(first: i64, count: i64) -> Vec<TwinInput> {
        let contact = |trial: i64, n: i64| Contact {
            x_mm: if trial % 7 == 6 { -5.0 } else { 40.0 + (trial * 37 + n * 101) as f64 % 450.0 },
            y_mm: 60.0 + (trial * 53 + n * 17) as f64 % 430.0,
            force_n: 1.7 * n as f64 + 0.1,
        };
        let contacts = |trial: i64| (0..trial % 4).map(|n| contact(trial, n)).collect();
        let input = |trial: i64| TwinInput {
            trial: TrialId(trial),
            contacts: (trial % 5 != 4).then(|| contacts(trial)),
        };
        (first..first + count).map(input).collect()
    }

    fn ordered(skin: TwinSkin) -> WorkOrder {
        work_order(skin, vec![TwinInput::lines(inputs(0, 70)), TwinInput::lines(inputs(70, 9))])
    }

    /// Makes both chunks; returns their bytes.
    fn made(order: &WorkOrder, threads: usize) -> [Vec<u8>; 2] {
        let place = tempfile::tempdir().unwrap();
        let (folder, _) = OrderFolder::write(place.path(), order.clone()).unwrap();
        let read = TwinsOrder::read(folder.order()).unwrap();
        let threads = NonZeroUsize::new(threads).unwrap();
        let mut maker = TwinChunks::new(read, MODEL.clone(), threads).unwrap();
        [0, 1].map(|index| {
            let row = folder.make(index, &mut maker, &mut |_| ControlFlow::Continue(()));
            fs::read(folder.result(&row.unwrap().unwrap().key)).unwrap()
        })
    }

    #[test]
    fn chunks_of_any_number_of_threads_are_the_twins_of_their_contacts() {
        let order = ordered(skin());
        let one = made(&order, 1);
        assert!(one == made(&order, 3), "other bytes with three threads");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chunk");
        let mut work = Workspace::default();
        let mut failures = 0;
        for (bytes, inputs) in one.iter().zip([inputs(0, 70), inputs(70, 9)]) {
            fs::write(&path, bytes).unwrap();
            let file = TwinsFile::read(File::open(&path).unwrap(), 784).unwrap();
            assert_eq!(file.head.contacts_sha256, sha256_hex(TwinInput::lines(inputs.clone())));
            assert_eq!(file.rows.len(), inputs.len());
            for (row, input) in file.rows.iter().zip(inputs) {
                let alone = twin_frame(&MODEL, input.contacts.as_deref(), &mut work);
                failures += usize::from(alone.is_err());
                assert_eq!((row.trial, &row.frame_v), (input.trial, &alone.ok()));
            }
        }
        assert!((20..40).contains(&failures), "{failures}");
    }

    #[test]
    fn a_chunk_of_other_contacts_is_not_made() {
        let place = tempfile::tempdir().unwrap();
        let mut order = ordered(skin());
        let contacts = order.inputs.get_mut("contacts-00001").unwrap();
        *contacts = contacts.replace("70", "71");
        let (folder, _) = OrderFolder::write(place.path(), order).unwrap();
        let read = TwinsOrder::read(folder.order()).unwrap();
        let mut maker = TwinChunks::new(read, MODEL.clone(), NonZeroUsize::MIN).unwrap();
        let made = folder.make(1, &mut maker, &mut |_| ControlFlow::Continue(()));
        let error = made.unwrap_err().to_string();
        assert!(error.contains("contacts-00001: has other contacts"), "{error}");
        let stopped = folder.make(0, &mut maker, &mut |_| ControlFlow::Break(())).unwrap();
        assert_eq!(stopped, None);
    }

    #[test]
    fn an_order_that_cannot_be_made_here_is_refused_by_key() {
        let key = |order: WorkOrder| TwinsOrder::read(&order).unwrap_err().key;
        let order = ordered(skin());
        assert_eq!((order.kind.as_str(), order.chunks), (TWINS, 2));
        assert_eq!(key(WorkOrder { chunks: 3, ..order.clone() }), "chunks");
        assert_eq!(key(WorkOrder { definition: 1.into(), ..order.clone() }), "definition");
        let none = WorkOrder { inputs: BTreeMap::new(), ..order.clone() };
        assert_eq!(key(none), "inputs.sensor_file");
        let mut inputs = order.inputs.clone();
        inputs.insert(CALIBRATION_INPUT.into(), "id = 1".into());
        assert_eq!(key(WorkOrder { inputs, ..order }), "inputs.calibration");
        let here = |skin: TwinSkin| {
            let read = TwinsOrder::read(&ordered(skin)).unwrap();
            TwinChunks::new(read, MODEL.clone(), NonZeroUsize::MIN).err().map(|problem| problem.key)
        };
        assert_eq!(here(skin()), None);
        let other = TwinSkin { model: "sim-0".into(), ..skin() };
        assert_eq!(here(other).as_deref(), Some("definition.model"));
        let other = TwinSkin { kernel: "none".into(), ..skin() };
        assert_eq!(here(other).as_deref(), Some("definition.kernel"));
    }
}
