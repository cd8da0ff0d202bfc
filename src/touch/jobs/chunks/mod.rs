//! Trainings in chunks: each chunk is one net, made by the trainer's process from a recipe and the file of a
//! dataset in the order's folder, with its scores on parts of the dataset.
//! Uses: `chunk`, `learn`, the trainer's process. Never: the store, a dataset whose bytes are not those of the order,
//! two processes that train one net in one folder.
//!
//! ```text
//! FOLDER/unfinished/INDEX       folder of the trainer, as of a job: order, checkpoint, losses; removed with the net made
//! FOLDER/unfinished/INDEX.lock  locked by the process that makes the chunk
//! ```
//! Another start of a chunk resumes from its checkpoint, or scores its net, which does not change a byte.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::pin::pin;

use nets::compute::Compute;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sim_core::batch::Kernel;

mod net_file;
mod scores;

pub use self::net_file::{GatheredNets, SCORES_FILE, gather};
use self::net_file::{ScoredNet, write_net};
pub use self::scores::NetScore;
use self::scores::net_scores;
use super::trainer::{self, Ended, TrainerError};
use super::training::{self, Inherited};
use super::{JobError, Watch};
use crate::chunk::folder::input_file;
use crate::chunk::order::{ORDER_FILE, WorkOrder};
use crate::chunk::{MakeChunks, MakeFailure, Tell, WrittenChunk};
use crate::dataset::read::sensor_text;
use crate::evaluate::request::{EvaluationRequest, FramesRead};
use crate::ids::{CalibrationId, DatasetId};
use crate::learn::order::{CHECKPOINT, Event, ORDER, ORDER_VERSION, Order, Source};
use crate::learn::recipe::Recipe;
use crate::new_file::{self, Finished, Look, NewFile};
use crate::problem::{Problem, listed};
use crate::program::STOP_POLL;
use crate::store::Label;

/// Kind of the chunks.
pub const TRAININGS: &str = "trainings";
/// Device of a training on a processor: with more threads the order of sums, and so the bytes, differ each time.
pub const ONE_THREAD: Compute = Compute::Cpu { threads: 1 };

/// The first GPU of a machine; bytes need not be the same twice.
pub const FIRST_GPU: Compute = Compute::Cuda(0);

/// Folder of unfinished trainings, in that of their work order.
const UNFINISHED: &str = "unfinished";

/// The file of a dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DatasetFile {
    /// Id of the dataset.
    pub id: DatasetId,
    /// Number of its rows.
    pub rows: u64,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// sha256 of the file.
    pub sha256: String,
}

/// A net of a work order. Its seed and its layers are in the recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetOrder {
    /// Text of the recipe, TOML.
    pub recipe: String,
    /// Rows that the net learns from.
    pub dataset: DatasetFile,
    /// Label of the model.
    pub label: Label,
    /// Calibration of the dataset's twins.
    pub calibration: Option<CalibrationId>,
    /// Hash of the model that simulated them.
    pub simulation: Option<String>,
    /// Evaluations of the net on parts of the dataset; they do not name the net.
    pub evaluations: Vec<EvaluationRequest>,
}

impl NetOrder {
    /// The net of a recipe on the file of a dataset with this lineage.
    ///
    /// # Errors
    /// All problems of the recipe.
    pub fn new(
        recipe: &str,
        dataset: DatasetFile,
        lineage: &Value,
        evaluations: Vec<EvaluationRequest>,
    ) -> Result<Self, Vec<Problem>> {
        let recipe = Recipe::from_toml("recipe", recipe)?;
        let Inherited { label, calibration, simulation } = training::inherited(lineage, &recipe);
        // As the service writes it: a recipe was read from TOML.
        let recipe = toml::to_string(&recipe).unwrap_or_default();
        Ok(Self { recipe, dataset, label, calibration, simulation, evaluations })
    }
}

/// What determines the bytes of all chunks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingsDefinition {
    /// Program and commit that train, which every manifest states.
    pub code: String,
    /// Device of each training: [`ONE_THREAD`], or a GPU, whose bytes need not be the same twice.
    pub compute: Compute,
    /// Vector instructions of the processor: the last digits of a net depend on them.
    pub kernel: String,
    /// The nets, in the order of the chunks.
    pub nets: Vec<NetOrder>,
}

/// Returns the work order of nets for machines like this one.
pub fn work_order(nets: Vec<NetOrder>, compute: Compute) -> WorkOrder {
    let chunks = nets.len() as u64;
    let files = nets.iter().map(|net| net.dataset.sha256.clone()).collect();
    let kernel = Kernel::detect().name().to_owned();
    let definition = TrainingsDefinition { code: training::code(), compute, kernel, nets };
    WorkOrder { files, ..WorkOrder::new(TRAININGS, &definition, BTreeMap::new(), chunks) }
}

/// What a work order of trainings states.
#[derive(Debug, Clone)]
pub struct TrainingsOrder {
    definition: TrainingsDefinition,
    recipes: Vec<Recipe>,
}

impl TrainingsOrder {
    /// Reads a work order.
    ///
    /// # Errors
    /// The first value that is wrong, by its key in the work order.
    pub fn read(order: &WorkOrder) -> Result<Self, Problem> {
        let definition: TrainingsDefinition = order.read_definition()?;
        order.check_chunks(definition.nets.len() as u64)?;
        if definition.compute.is_host() && definition.compute != ONE_THREAD {
            let found = serde_json::to_string(&definition.compute).unwrap_or_default();
            let limit = "must have one thread: with more, the bytes differ each time";
            return Err(Problem::new(ORDER_FILE, "definition.compute", found, limit));
        }
        let (mut recipes, mut names) = (Vec::new(), BTreeSet::new());
        for (index, net) in definition.nets.iter().enumerate() {
            let key = |of: &str| format!("definition.nets.{index}.{of}");
            let recipe = Recipe::from_toml(ORDER_FILE, &net.recipe).map_err(|problems| {
                Problem::new(ORDER_FILE, &key("recipe"), "..", listed(&problems))
            })?;
            let refused = |of: &str, value: &str, limit: &str| {
                Err(Problem::new(ORDER_FILE, &key(of), value, limit))
            };
            // A folder has this name.
            if recipe.name.starts_with('.') {
                return refused("recipe.name", &recipe.name, "must not start with a full stop");
            }
            if !names.insert(recipe.name.clone()) {
                return refused("recipe.name", &recipe.name, "must be that of one net only");
            }
            if recipe.dataset.is_none() {
                let limit = "must be set: nets on simulations are not made in chunks";
                return refused("recipe.dataset", "none", limit);
            }
            if let Some(noise_of) = &recipe.noise_of {
                let limit = "must be absent: nets with noise need a Transfer-Net first";
                return refused("recipe.noise_of", noise_of, limit);
            }
            let named = recipe.dataset.as_deref();
            let mut evaluations = net.evaluations.iter();
            if let Some(other) = evaluations.find(|of| Some(of.dataset.as_str()) != named) {
                let limit = "must be the dataset of the net";
                return refused("evaluations.dataset", &other.dataset, limit);
            }
            if net.evaluations.iter().any(|of| of.frames != FramesRead::Mean) {
                let limit = "must be mean: first frames are in the store of a service";
                return refused("evaluations.frames", "first", limit);
            }
            recipes.push(recipe);
        }
        Ok(Self { definition, recipes })
    }
}

/// Makes the nets of a work order.
pub struct TrainingChunks {
    order: TrainingsOrder,
    /// Folder of the work order, with the files of the datasets.
    folder: PathBuf,
    /// Folder for the frames while a net trains or is scored.
    scratch: PathBuf,
}

impl TrainingChunks {
    /// Maker of an order's chunks in its folder, which has the files of the datasets.
    ///
    /// # Errors
    /// The first value of the definition that this program or machine does not have.
    pub fn new(order: TrainingsOrder, folder: &Path, scratch: PathBuf) -> Result<Self, Problem> {
        let TrainingsDefinition { code, kernel, nets, .. } = &order.definition;
        let (own_code, own_kernel) = (training::code(), Kernel::detect().name());
        if *code != own_code {
            let limit = format!("this program is `{own_code}`; use the one that wrote the order");
            return Err(Problem::new(ORDER_FILE, "definition.code", code, limit));
        }
        if kernel != own_kernel {
            let limit = format!(
                "this processor computes with {own_kernel}; make the nets on machines like the one of the order"
            );
            return Err(Problem::new(ORDER_FILE, "definition.kernel", kernel, limit));
        }
        let mut whole = BTreeSet::new();
        for (index, NetOrder { dataset, .. }) in nets.iter().enumerate() {
            if !whole.insert(dataset.sha256.clone()) {
                continue;
            }
            let path = input_file(folder, &dataset.sha256);
            let file = Finished { bytes: dataset.bytes, sha256: dataset.sha256.clone() };
            let why = match file.is_at(&path, Look::Sha256) {
                Ok(true) => continue,
                Ok(false) => "is missing or has other bytes".to_owned(),
                Err(error) => error.to_string(),
            };
            let limit = format!("{} {why}; order again, or copy this file", path.display());
            let key = format!("definition.nets.{index}.dataset.id");
            return Err(Problem::new(ORDER_FILE, &key, &dataset.id, limit));
        }
        Ok(Self { folder: folder.to_owned(), scratch, order })
    }

    fn trainers_order(&self, net: &NetOrder) -> Result<Order, MakeFailure> {
        let NetOrder { recipe, dataset, label, calibration, simulation, .. } = net.clone();
        let file = input_file(&self.folder, &dataset.sha256);
        Ok(Order {
            version: ORDER_VERSION.into(),
            recipe,
            code: self.order.definition.code.clone(),
            sensor: sensor_text(&file).map_err(|error| error.to_string())?,
            noise_sd_v: None,
            compute: Some(self.order.definition.compute),
            source: Source::Dataset {
                id: dataset.id,
                file: training::absolute(&file),
                rows: dataset.rows,
                scratch: training::absolute(&self.scratch),
                label,
                calibration,
                simulation,
            },
        })
    }
}

impl MakeChunks for TrainingChunks {
    fn write(&mut self, index: u64, mut out: NewFile, tell: &mut Tell<'_>) -> WrittenChunk {
        let at = usize::try_from(index)?;
        let (net, recipe) = (&self.order.definition.nets[at], &self.order.recipes[at]);
        let work = self.folder.join(UNFINISHED);
        let folder = work.join(index.to_string());
        fs::create_dir_all(&folder)?;
        let _lock = lock(&work.join(format!("{index}.lock")))?;
        let order = self.trainers_order(net)?;
        let made = || training::result(&folder, &order, recipe.name.clone());
        // The net of an earlier start, which ended before its scores.
        let model = match made() {
            Ok(model) => model,
            Err(_) => {
                if trained(&folder, &order, tell)? == Ended::Stopped {
                    return Ok(None);
                }
                made().map_err(|error: JobError| error.to_string())?
            }
        };
        let file = input_file(&self.folder, &net.dataset.sha256);
        let scores = net_scores(net, &model, [&file, &self.scratch], tell);
        let Some(scores) = scores.map_err(|error| error.to_string())? else { return Ok(None) };
        write_net(&ScoredNet { model, scores }, &mut out)?;
        fs::remove_dir_all(&folder)?;
        Ok(Some((out, 1)))
    }
}

/// Locks a file as the only process that makes a chunk; none on a file system without locks.
fn lock(path: &Path) -> Result<Option<File>, MakeFailure> {
    let lock = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
    match lock.try_lock() {
        Ok(()) => Ok(Some(lock)),
        Err(TryLockError::WouldBlock) => Err("another process trains this net".into()),
        Err(TryLockError::Error(error)) => {
            tracing::debug!(path = %path.display(), %error, "no locks here");
            Ok(None)
        }
    }
}

/// Writes the trainer's order into a folder, and runs the trainer.
fn trained(folder: &Path, order: &Order, tell: &mut Tell<'_>) -> Result<Ended, MakeFailure> {
    new_file::write(folder, ORDER, serde_json::to_vec(order)?)?;
    // The runtime is this call's: a chunk is made on a blocking thread, or without any runtime.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let ended = runtime.block_on(train(folder, tell));
    if ended.as_ref().is_err_and(is_repeatable_from_start) {
        // A damaged checkpoint must not fail every attempt.
        fs::remove_file(folder.join(CHECKPOINT)).ok();
    }
    Ok(ended.map_err(|error| error.to_string())?)
}

/// Whether the next attempt must not resume from the checkpoint. A trainer that was killed may.
fn is_repeatable_from_start(error: &TrainerError) -> bool {
    match error {
        TrainerError::Failed(_) => true,
        TrainerError::Ended(end) => end.signal.is_none(),
        TrainerError::Program(_) | TrainerError::Start { .. } => false,
    }
}

/// Runs the trainer on a folder; `tell` receives the number of learned samples, and ends it if it breaks off.
async fn train(folder: &Path, tell: &mut Tell<'_>) -> Result<Ended, TrainerError> {
    let watch = Watch::default();
    let learned = Cell::new(0);
    let work = async {
        let Some(program) = trainer::path(&watch).await? else { return Ok(Ended::Stopped) };
        let seen = |event: Event| match event {
            Event::Learned { done, .. } => learned.set(done),
            Event::Warning { message } => tracing::warn!(message, "the trainer warns"),
            Event::Phase { .. }
            | Event::Checkpoint
            | Event::Done
            | Event::Stopped
            | Event::Failed { .. } => {}
        };
        trainer::run(&program, folder, &watch, seen).await
    };
    let mut work = pin!(work);
    loop {
        tokio::select! {
            ended = &mut work => return ended,
            () = tokio::time::sleep(STOP_POLL) => {
                if tell(learned.get()).is_break() {
                    watch.stop();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
