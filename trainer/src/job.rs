//! The order of a job's folder, carried out: locks the folder, trains, writes the result.
//! Uses: `learn`, `recipe`, `talk`. Never: a result in the folder of another order.

use std::fs::{self, File, TryLockError};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use nets::compute::Compute;
use nets::progress::End;
use sim_core::calibration::Calibration;
use sim_core::sensor::Sensor;

use crate::dataset::import::sensor::ImportedSensor;
use crate::device;
use crate::error::TrainerError;
use crate::ids::{CalibrationId, DatasetId};
use crate::infer::registry;
use crate::learn::error::LearnError;
use crate::learn::examples::Examples;
use crate::learn::model_file::{ModelFacts, model_of};
use crate::learn::order::{CHECKPOINT, Event, MANIFEST, ONNX, ORDER, Order, RESIDUALS, Source};
use crate::learn::recipe::Recipe;
use crate::new_file;
use crate::observer::JobObserver;
use crate::recipe::{self, Given, Learned};
use crate::simulate::model::load_or_build;
use crate::store::Label;
use crate::talk::Talk;

/// Nice value of the process: one at 0 gets about ten times as much processor time.
const TRAINER_NICE: i32 = 10;
/// Longest wait for the trainer of a service that has just ended: it writes its checkpoint.
const BUSY_MAX: Duration = Duration::from_secs(60);
const BUSY_LOOK: Duration = Duration::from_millis(50);

/// Carries out the order in a folder, and reports its end on standard output.
pub fn carry_out(folder: &Path) -> ExitCode {
    // Before any thread starts: the others inherit it. Without it the work only competes more.
    let _ = rustix::process::nice(TRAINER_NICE);
    let talk = Talk::begin();
    let (end, status) = match run(folder, &talk) {
        Ok(true) => (Event::Done, ExitCode::SUCCESS),
        Ok(false) => (Event::Stopped, ExitCode::SUCCESS),
        Err(error) => (Event::Failed { error: error.to_string() }, ExitCode::FAILURE),
    };
    talk.say(&end);
    status
}

/// Returns `false` if the training was stopped.
fn run(folder: &Path, talk: &Talk) -> Result<bool, TrainerError> {
    let _lock = lock(folder)?;
    let failed = LearnError::file("clearing", folder);
    new_file::sweep(folder).map_err(&failed)?;
    for name in [MANIFEST, ONNX, RESIDUALS] {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(failed(error).into());
            }
            _ => {}
        }
    }
    let path = folder.join(ORDER);
    let text = fs::read_to_string(&path).map_err(LearnError::file("reading", &path))?;
    let order = Order::read(&text)?;
    let recipe = Recipe::from_toml("recipe", &order.recipe).map_err(LearnError::Problems)?;
    let compute = order.compute.unwrap_or_else(device::own);
    Work { folder, talk, order: &order, recipe: &recipe, compute }.run()
}

/// Locks the folder while the file is open.
fn lock(folder: &Path) -> Result<File, TrainerError> {
    let file = File::open(folder).map_err(LearnError::file("opening", folder))?;
    let start = Instant::now();
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(TryLockError::WouldBlock) if start.elapsed() < BUSY_MAX => {
                std::thread::sleep(BUSY_LOOK);
            }
            Err(TryLockError::WouldBlock) => return Err(TrainerError::Busy(folder.into())),
            Err(TryLockError::Error(error)) => {
                return Err(LearnError::file("locking", folder)(error).into());
            }
        }
    }
}

/// Inputs of a running training.
struct Work<'a> {
    folder: &'a Path,
    talk: &'a Talk,
    order: &'a Order,
    recipe: &'a Recipe,
    compute: Compute,
}

struct Lineage {
    label: Label,
    dataset: Option<DatasetId>,
    calibration: Option<CalibrationId>,
    simulation: Option<String>,
}

impl Work<'_> {
    fn run(&self) -> Result<bool, TrainerError> {
        let checkpoint = fs::read(self.folder.join(CHECKPOINT)).ok();
        let (learned, lineage) = match &self.order.source {
            Source::Dataset { id, file, rows, scratch, label, calibration, simulation } => {
                self.phase("gathering frames", *rows);
                let learned = self.on_dataset(id, file, scratch, checkpoint)?;
                let lineage = Lineage {
                    label: *label,
                    dataset: Some(id.clone()),
                    calibration: calibration.clone(),
                    simulation: simulation.clone(),
                };
                (learned, lineage)
            }
            Source::Stream { calibration, cache } => {
                self.on_stream(calibration.as_deref(), cache, checkpoint)?
            }
        };
        if learned.trained.end == End::Stopped {
            return Ok(false);
        }
        self.write(learned, lineage)?;
        Ok(true)
    }

    fn on_dataset(
        &self,
        id: &DatasetId,
        file: &Path,
        scratch: &Path,
        checkpoint: Option<Vec<u8>>,
    ) -> Result<Learned, TrainerError> {
        let skin = ImportedSensor::from_toml("sensor", &self.order.sensor);
        let skin = skin.map_err(LearnError::Problems)?;
        let (conditions, columns) = (&self.recipe.conditions, self.recipe.task().columns());
        let examples = Examples::gather(file, conditions, columns, scratch)?;
        let names = std::iter::once(id.as_str()).chain(conditions.iter().map(String::as_str));
        let given = Given {
            data: names.collect::<Vec<_>>().join(" "),
            examples: &examples,
            skin: &skin,
            noise_sd_v: self.order.noise_sd_v.clone(),
            compute: self.compute,
        };
        let mut observer = JobObserver::begin(self.folder, self.talk, "training");
        Ok(recipe::train(self.recipe, &given, checkpoint.as_deref(), &mut observer)?)
    }

    fn on_stream(
        &self,
        calibration: Option<&Path>,
        cache: &Path,
        checkpoint: Option<Vec<u8>>,
    ) -> Result<(Learned, Lineage), TrainerError> {
        self.phase("preparing simulations", 0);
        let sensor = Sensor::from_toml(&self.order.sensor)?;
        let sensor = match calibration {
            Some(path) => {
                let text = fs::read_to_string(path).map_err(LearnError::file("reading", path))?;
                Calibration::from_toml(&text)?.apply(&sensor)?
            }
            None => sensor.into(),
        };
        let model = load_or_build(sensor, cache)?;
        let mut observer = JobObserver::begin(self.folder, self.talk, "training on simulations");
        let (recipe, compute) = (self.recipe, self.compute);
        let checkpoint = checkpoint.as_deref();
        let learned = recipe::train_on_stream(recipe, &model, compute, checkpoint, &mut observer)?;
        let lineage = Lineage {
            label: Label::Simulated,
            dataset: None,
            calibration: model.sensor().calibration().map(CalibrationId::unchecked),
            simulation: Some(model.model_hash().into()),
        };
        Ok((learned, lineage))
    }

    /// Writes the result; the manifest last.
    fn write(&self, learned: Learned, from: Lineage) -> Result<(), TrainerError> {
        self.phase("writing the model", 0);
        let (_, facts) =
            registry::facts("sensor", &self.order.sensor).map_err(LearnError::Problems)?;
        let model = ModelFacts {
            task: self.recipe.task(),
            label: from.label,
            sensor: facts.name.clone(),
            channels: facts.channels,
            output_shape: learned.trained.network.output.clone(),
            force_map: self.recipe.map,
            places_mm: learned.places_mm,
            datasets: from.dataset.into_iter().collect(),
            calibration: from.calibration,
            simulation: from.simulation,
            code: self.order.code.clone(),
            recipe: Some(self.order.recipe.clone()),
            trained_on: learned.range,
        };
        let made = model_of(&learned.trained.network, model, &facts);
        let (manifest, onnx) = made.map_err(LearnError::from)?;
        let residuals = learned.residuals.as_ref().map(serde_json::to_vec).transpose()?;
        let manifest = manifest.to_toml().into_bytes();
        let files = [(RESIDUALS, residuals), (ONNX, Some(onnx)), (MANIFEST, Some(manifest))];
        for (name, bytes) in files {
            let Some(bytes) = bytes else { continue };
            let failed = LearnError::file("writing", &self.folder.join(name));
            new_file::write(self.folder, name, bytes).map_err(failed)?;
        }
        Ok(())
    }

    fn phase(&self, phase: &str, total: u64) {
        self.talk.say(&Event::Phase { phase: phase.into(), total });
    }
}
