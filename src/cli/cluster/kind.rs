//! The kinds of chunks, and what makes and gathers those of each. For a further kind: a variant, and a line in each
//! function; its definition and number of chunks are in a `WorkOrder` that its chapter makes.
//! Uses: `chunk`, `simulate::{random, twins}::chunks`, `jobs::chunks`. Never: a file of a chunk.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use crate::chunk::MakeChunks;
use crate::chunk::error::ChunkError;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::{ChunkRow, ORDER_FILE, WorkOrder};
use crate::cli::error::{CliError, CliResult};
use crate::cli::simulate::solved;
use crate::jobs::chunks::{self as trainings, TRAININGS, TrainingChunks, TrainingsOrder};
use crate::jobs::readings::chunks::{READINGS, ReadingChunks, ReadingsOrder};
use crate::problem::Problem;
use crate::simulate::random::chunks::{self, RandomChunks, RandomOrder};
use crate::simulate::random::manifest::SIM_RANDOM;
use crate::simulate::twins::chunks::{TWINS, TwinChunks, TwinsOrder};

/// What the chunks of a work order contain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChunkKind {
    /// A shard of Sim-Random.
    SimRandom,
    /// A net of a table, with its scores.
    Trainings,
    /// Twins of consecutive trials of a run.
    Twins,
    /// Answers of `exact` to frames of an evaluation.
    Readings,
}

/// Resources that make chunks: they do not change a byte.
#[derive(Debug, Clone)]
pub struct ChunkMeans {
    /// Number of threads, unless the work order states it.
    pub threads: NonZeroUsize,
    /// Folder whose `cache` contains solved unit responses, and the frames of a net while it trains.
    pub data: PathBuf,
}

/// What a gathered folder contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gathered {
    /// Number of rows; a net is one.
    pub rows: u64,
    /// Number of bytes.
    pub bytes: u64,
}

impl ChunkKind {
    /// The kind of a folder's work order.
    ///
    /// # Errors
    /// `ChunkError::Order` if this program does not know it.
    pub fn of(folder: &OrderFolder) -> CliResult<Self> {
        match folder.order().kind.as_str() {
            SIM_RANDOM => Ok(Self::SimRandom),
            TRAININGS => Ok(Self::Trainings),
            TWINS => Ok(Self::Twins),
            READINGS => Ok(Self::Readings),
            other => {
                let limit =
                    format!("this program makes {SIM_RANDOM}, {TRAININGS}, {TWINS} and {READINGS}");
                Err(refused(folder)(Problem::new(ORDER_FILE, "kind", other, limit)))
            }
        }
    }

    /// Opens what makes the chunks of a work order: files are read, models are solved.
    ///
    /// # Errors
    /// `ChunkError::Order` if a value of the order is not what this program makes; `CliError::Model` if the model of the
    /// skin is not available.
    pub fn open(self, folder: &OrderFolder, means: &ChunkMeans) -> CliResult<Box<dyn MakeChunks>> {
        let cache = means.data.join("cache");
        match self {
            Self::SimRandom => {
                let order = order_of(folder, RandomOrder::read)?;
                let model = solved(&order.sensor, &cache)?;
                boxed(folder, RandomChunks::new(order, &model, means.threads))
            }
            Self::Trainings => {
                let order = order_of(folder, TrainingsOrder::read)?;
                boxed(folder, TrainingChunks::new(order, folder.path(), cache))
            }
            Self::Twins => {
                let order = order_of(folder, TwinsOrder::read)?;
                let model = solved(&order.sensor, &cache)?;
                boxed(folder, TwinChunks::new(order, model, means.threads))
            }
            Self::Readings => {
                let order = order_of(folder, ReadingsOrder::read)?;
                let model = solved(&order.sensor, &cache)?;
                boxed(folder, ReadingChunks::new(order, &model, means.threads))
            }
        }
    }

    /// Writes the chunks of a work order to `out`, as one process would have; `tell` receives a call for each chunk.
    ///
    /// # Errors
    /// `ChunkError::Incomplete` if chunks are damaged: the others were written; another `ChunkError` or
    /// `CliError::SimRandom` if a file cannot be read or written, or `out` contains something else; `Problems` for
    /// twins and readings, which a service takes.
    pub fn gather(
        self,
        folder: &OrderFolder,
        rows: &[ChunkRow],
        out: &Path,
        tell: &mut dyn FnMut(),
    ) -> CliResult<Gathered> {
        match self {
            Self::SimRandom => {
                let order = order_of(folder, RandomOrder::read)?;
                let gathered = chunks::gather(&order, folder, rows, out, &mut |_| tell())?;
                folder.all_whole(gathered.damaged)?;
                let shards = gathered.manifest.shards.iter();
                let (rows, bytes) = shards.fold((0, 0), |(rows, bytes), shard| {
                    (rows + shard.trials, bytes + shard.bytes)
                });
                Ok(Gathered { rows, bytes })
            }
            Self::Trainings => {
                let order = order_of(folder, TrainingsOrder::read)?;
                let gathered = trainings::gather(&order, folder, rows, out, tell)?;
                Ok(Gathered { rows: gathered.nets, bytes: gathered.bytes })
            }
            Self::Twins | Self::Readings => {
                let limit = "must be absent: the service takes these chunks";
                Err(CliError::argument("out", out.display(), limit))
            }
        }
    }
}

/// Reads the work order of a folder as one of a kind, such as `TwinsOrder::read`.
///
/// # Errors
/// `ChunkError::Order` with the first value that is wrong.
pub fn order_of<T>(
    folder: &OrderFolder,
    read: impl FnOnce(&WorkOrder) -> Result<T, Problem>,
) -> CliResult<T> {
    read(folder.order()).map_err(refused(folder))
}

/// What makes the chunks of a folder's work order, unless a value of the order is refused.
fn boxed(
    folder: &OrderFolder,
    made: Result<impl MakeChunks + 'static, Problem>,
) -> CliResult<Box<dyn MakeChunks>> {
    Ok(Box::new(made.map_err(refused(folder))?))
}

/// Conversion of a problem of a folder's work order.
fn refused(folder: &OrderFolder) -> impl Fn(Problem) -> CliError {
    move |problem| ChunkError::order(folder.path(), problem).into()
}
