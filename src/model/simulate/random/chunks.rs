//! Sim-Random in chunks: each chunk is one shard, byte for byte that of `generate`.
//! Uses: `chunk`, `shards`, `folder`, sim-core. Never: a queue, an order in which chunks are made.

use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::path::Path;

use sim_core::batch::BatchModel;
use sim_core::calibrated::CalibratedSensor;
use sim_core::forward::ForwardModel;

use super::error::RandomError;
use super::folder::Folder;
use super::manifest::{Definition, Manifest, Order, SIM_RANDOM, ShardRow, kernel};
use super::reproduced;
use super::shards::ShardMaker;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::{CHUNKS_MAX, ChunkRow, ORDER_FILE, WorkOrder, check_here, invalid};
use crate::chunk::skin::{ordered_skin, skin_inputs};
use crate::chunk::{MakeChunks, Tell, WrittenChunk};
use crate::new_file::{Look, NewFile};
use crate::problem::Problem;

/// Returns the work order of a definition. The texts are those of the sensor file and of the calibration, if any.
///
/// # Errors
/// A problem of the command line if there would be too many chunks.
pub fn work_order(
    definition: &Definition,
    sensor: String,
    calibration: Option<String>,
) -> Result<WorkOrder, Problem> {
    let chunks = definition.shard_count();
    if chunks > CHUNKS_MAX {
        let limit = format!("these are {chunks} chunks of a shard each, at most {CHUNKS_MAX}");
        return Err(Problem::new("command line", "shard-trials", definition.shard_trials, limit));
    }
    Ok(WorkOrder::new(SIM_RANDOM, definition, skin_inputs(sensor, calibration), chunks))
}

/// What a work order of Sim-Random states.
#[derive(Debug, Clone)]
pub struct RandomOrder {
    /// Definition of the shards.
    pub definition: Definition,
    /// The skin, calibrated if a calibration was ordered.
    pub sensor: CalibratedSensor,
    request: Order,
}

impl RandomOrder {
    /// Reads a work order.
    ///
    /// # Errors
    /// The first value that is wrong, by its key in the work order.
    pub fn read(order: &WorkOrder) -> Result<Self, Problem> {
        let definition: Definition = order.read_definition()?;
        let sensor = ordered_skin(order)?;
        let Definition { draws, trials, shard_trials, .. } = &definition;
        let request = Order::new(draws.clone(), *trials, *shard_trials, sensor.points().len())
            .map_err(|problems| match problems.into_iter().next() {
                Some(first) => Problem { file: ORDER_FILE.into(), ..first },
                None => invalid("definition", "is invalid"),
            })?;
        order.check_chunks(definition.shard_count())?;
        Ok(Self { definition, sensor, request })
    }
}

/// Makes the shards of a work order, each on all of its threads.
pub struct RandomChunks {
    definition: Definition,
    sensor: CalibratedSensor,
    model: BatchModel,
    threads: NonZeroUsize,
}

impl RandomChunks {
    /// Maker of an order's chunks with the model of its sensor.
    ///
    /// # Errors
    /// The first value of the definition that this program, model or processor does not have.
    pub fn new(
        order: RandomOrder,
        model: &ForwardModel,
        threads: NonZeroUsize,
    ) -> Result<Self, Problem> {
        let RandomOrder { definition, sensor, request } = order;
        let kernel = kernel(&definition.kernel).map_err(|here| {
            let limit = format!("{here}; order the work with one of them: --kernel");
            Problem::new(ORDER_FILE, "definition.kernel", &definition.kernel, limit)
        })?;
        let here = Definition::new(request, model, kernel);
        check_here(&definition, &here, |found| format!("this program makes {}", found.here))?;
        Ok(Self { definition, sensor, model: BatchModel::new(model, kernel), threads })
    }
}

impl MakeChunks for RandomChunks {
    fn write(&mut self, index: u64, out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk {
        let shard = self.definition.shard(index);
        let maker = ShardMaker::new(&self.definition, &self.sensor, &self.model)?;
        let name = out.path().display().to_string();
        let written = maker.row_groups(&[shard], self.threads, |made| {
            maker.write(&shard, out, &name, made, tell)
        })?;
        Ok(written.map(|out| (out, shard.trials)))
    }
}

/// Shards that were copied out of a work order.
#[derive(Debug, Clone, PartialEq)]
pub struct GatheredShards {
    /// The manifest of the folder: all shards that are whole.
    pub manifest: Manifest,
    /// Indexes of the chunks whose bytes do not have the sha256 of their row, ascending.
    pub damaged: Vec<u64>,
}

/// Copies the chunks of a work order into a folder, as `generate` would have written it. `rows` are all of its rows, in
/// order; `tell` receives each shard.
///
/// # Errors
/// `RandomError` if the folder is in use or of another definition, or a file cannot be read or written.
pub fn gather(
    order: &RandomOrder,
    chunks: &OrderFolder,
    rows: &[ChunkRow],
    out: &Path,
    tell: &mut dyn FnMut(&ShardRow),
) -> Result<GatheredShards, RandomError> {
    let (folder, mut manifest) = Folder::take_for(out, &order.definition, &order.sensor.file)?;
    let mut damaged = Vec::new();
    for (shard, row) in order.definition.shards().zip(rows) {
        if let Some(there) = manifest.row(&shard)
            && there.sha256 == row.sha256
            && folder.holds(there, Look::Sha256)?
        {
            tell(there);
            continue;
        }
        let path = chunks.result(&row.key);
        let mut bytes = File::open(&path).map_err(RandomError::file("opening", path))?;
        let mut copy = folder.begin()?;
        let partial = copy.path().to_owned();
        io::copy(&mut bytes, &mut copy)
            .map_err(RandomError::file("copying a chunk to", partial))?;
        if copy.sha256() != row.sha256 {
            damaged.push(row.index);
            continue;
        }
        let made = ShardRow { commit: row.commit.clone(), ..folder.finish(&shard, copy)? };
        reproduced(manifest.row(&shard), &made)?;
        tell(&made);
        manifest.set(made);
    }
    folder.write_manifest(&manifest)?;
    Ok(GatheredShards { manifest, damaged })
}

#[cfg(test)]
pub(super) mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::calibrate::paper::SENSOR;
    use crate::chunk::order::value_of;
    use crate::chunk::skin::CALIBRATION_INPUT;
    use crate::simulate::random::draw::Draws;
    use crate::simulate::random::manifest::Shard;

    /// Of 2500 trials in three shards.
    pub(in super::super) fn definition() -> Definition {
        Definition {
            experiment: SIM_RANDOM.into(),
            format_version: 1,
            draw_version: 1,
            draws: Draws::paper(7),
            trials: 2500,
            shard_trials: 1000,
            row_group_trials: 1000,
            sensor: "ert-28".into(),
            model: "sim-0".into(),
            calibration: None,
            kernel: "portable-f32x8".into(),
            palpate: "0.0.0".into(),
            libraries: BTreeMap::new(),
        }
    }

    #[test]
    fn a_chunk_is_a_shard_and_an_order_states_everything_again() {
        let definition = definition();
        let order = work_order(&definition, SENSOR.into(), None).unwrap();
        assert_eq!((order.kind.as_str(), order.chunks), (SIM_RANDOM, 3));
        let read = WorkOrder::from_json(&order.to_json().unwrap()).unwrap();
        let read = RandomOrder::read(&read).unwrap();
        assert_eq!(read.definition, definition);
        assert_eq!(read.sensor.points().len(), 804);
        let last = Shard { number: 2, first: 2000, trials: 500 };
        assert_eq!(read.definition.shard(2), last);
        assert_eq!(read.definition.shards().last(), Some(last));
    }

    #[test]
    fn an_order_that_cannot_be_made_is_refused_by_key() {
        let many = Definition { trials: 100_001, shard_trials: 1, ..definition() };
        let problem = work_order(&many, SENSOR.into(), None).unwrap_err();
        assert_eq!(problem.key, "shard-trials");
        let order = work_order(&definition(), SENSOR.into(), None).unwrap();
        let key = |order: WorkOrder| RandomOrder::read(&order).unwrap_err().key;
        assert_eq!(key(WorkOrder { chunks: 4, ..order.clone() }), "chunks");
        assert_eq!(key(WorkOrder { definition: 1.into(), ..order.clone() }), "definition");
        let none = WorkOrder { inputs: BTreeMap::new(), ..order.clone() };
        assert_eq!(key(none), "inputs.sensor_file");
        let mut inputs = order.inputs.clone();
        inputs.insert(CALIBRATION_INPUT.into(), "id = 1".into());
        assert_eq!(key(WorkOrder { inputs, ..order.clone() }), "inputs.calibration");
        let zero = Definition { shard_trials: 0, ..definition() };
        let zero = WorkOrder { definition: value_of(&zero), ..order };
        assert_eq!(key(zero), "shard-trials");
    }
}
