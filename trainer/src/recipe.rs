//! From a recipe and its data to a trained net: its samples, the training, its residuals.
//! Uses: nets, `train`, `rows`, `learn` of `touch`. Never: files, a clock.

use std::sync::Arc;

use nets::architecture::Answer;
use nets::compute::Compute;
use nets::net::Net;
use nets::network::{Layer, Network};
use nets::points::streamed::Streamed;
use nets::progress::{Observer, Plan, Trained};
use sim_core::batch::{BatchModel, Kernel};
use sim_core::forward::ForwardModel;

use crate::answer::answer;
use crate::dataset::force_map::ForceMap;
use crate::dataset::import::sensor::ImportedSensor;
use crate::dataset::split::Part;
use crate::learn::error::LearnError;
use crate::learn::examples::Examples;
use crate::learn::model_file::TrainedRange;
use crate::learn::recipe::Recipe;
use crate::learn::residuals::Residuals;
use crate::learn::targets::Targets;
use crate::learn::task::Answers;
use crate::rows::{Fixed, RowSamples, Target};
use crate::train;

/// Largest number of rows on which the residuals of a Transfer-Net are measured.
const RESIDUAL_ROWS: usize = 20_000;
/// Number of simulated samples in an epoch, if the recipe does not state it.
const STREAM_EPOCH: u64 = 100_000;
/// Number of simulated samples for validation, the same in every epoch.
const STREAM_CHOSEN_WITH: u64 = 2_000;
/// Changes the seed of validation samples, so that they are not those of the training.
const CHOOSING: u64 = 1 << 62;
/// Number of frames that are answered at a time.
const FRAMES_AT_ONCE: usize = 256;

/// Inputs of a training in addition to its recipe.
#[derive(Debug)]
pub struct Given<'a> {
    /// Name of the data, as checkpoints carry it: the dataset's id and conditions.
    pub data: String,
    /// Rows of the dataset.
    pub examples: &'a Examples,
    /// Skin of the rows.
    pub skin: &'a ImportedSensor,
    /// Standard deviation of each channel's noise, V.
    pub noise_sd_v: Option<Vec<f32>>,
    /// Device of the training.
    pub compute: Compute,
}

/// Result of a training.
#[derive(Debug)]
pub struct Learned {
    /// The trained net, with its losses.
    pub trained: Trained,
    /// Numbers of contacts, largest force and largest frame of the training rows.
    pub range: TrainedRange,
    /// Residuals; only of a Transfer-Net.
    pub residuals: Option<Residuals>,
    /// Known places, mm; only of a net that answers patterns.
    pub places_mm: Vec<[f64; 2]>,
}

/// Trains on a dataset's rows: those of the training part, validated on those of the validation
/// part.
///
/// # Errors
/// `LearnError` if a part is empty, the data do not match the recipe, or the training fails.
pub fn train(
    recipe: &Recipe,
    given: &Given<'_>,
    checkpoint: Option<&[u8]>,
    observer: &mut (dyn Observer + Send),
) -> Result<Learned, LearnError> {
    let [mut learn, mut choose] =
        [Part::Train, Part::Validation].map(|part| given.examples.part(part));
    if let Some(rows) = recipe.rows {
        thin(&mut learn, rows as usize);
        thin(&mut choose, (rows as usize).div_ceil(3));
    }
    for (rows, part) in [(&learn, "train"), (&choose, "validation")] {
        if rows.is_empty() {
            let limit = format!("has no rows in part {part}");
            return Err(LearnError::value("recipe", "dataset", &given.data, &limit));
        }
    }
    let plan = Plan {
        recipe: recipe.training.clone(),
        data: given.data.clone(),
        noise_sd_v: given.noise_sd_v.clone(),
        compute: given.compute,
    };
    let targets = recipe.task().quantity().map(|quantity| {
        let contacts = learn.iter().map(|&row| given.examples.contacts(row));
        Targets::of(quantity, contacts)
    });
    let targets = targets.transpose()?;
    if let Some(targets) = &targets {
        for (rows, part) in [(&mut learn, "train"), (&mut choose, "validation")] {
            rows.retain(|&row| targets.of_row(given.examples.contacts(row)).is_some());
            if rows.is_empty() {
                let limit =
                    format!("has no rows in part {part} with a {}", targets.quantity.name());
                return Err(LearnError::value("recipe", "dataset", &given.data, &limit));
            }
        }
    }
    let range = given.examples.range(&learn);
    let [learn, choose] =
        [learn, choose].map(|rows| samples(recipe, given, rows, targets.as_ref()));
    let (learn, choose) = (learn?, choose?);
    let trained = train::train(&plan, &learn, &choose, checkpoint, observer)?;
    let residuals = match recipe.task().answers() {
        Answers::Frame => Some(residuals(&trained.network, given)?),
        Answers::Map | Answers::Points | Answers::Quantity(_) => None,
    };
    let places_mm = targets.map_or_else(Vec::new, |targets| targets.places_mm);
    Ok(Learned { trained, range, residuals, places_mm })
}

/// Trains a Point-Net on simulations of this model that are made during training; the model's hash
/// is the name of the data. Simulations have no offsets: the net first subtracts those of a
/// calibrated skin.
///
/// # Errors
/// `LearnError` if the recipe is not of a Point-Net, or the training fails.
pub fn train_on_stream(
    recipe: &Recipe,
    model: &ForwardModel,
    compute: Compute,
    checkpoint: Option<&[u8]>,
    observer: &mut (dyn Observer + Send),
) -> Result<Learned, LearnError> {
    let Net::PointNet(net) = &recipe.training.net else {
        let limit = "must be point-net if no dataset is named";
        return Err(LearnError::value("recipe", "training.net", recipe.task().as_str(), limit));
    };
    let batch = Arc::new(BatchModel::new(model, Kernel::detect()));
    let points = model.sensor().points();
    let stream = |seed, len| Streamed::new(batch.clone(), points, net.draws, seed, len);
    let seed = recipe.training.seed;
    let learn = stream(seed, recipe.rows.unwrap_or(STREAM_EPOCH));
    let choose = Fixed::of(&stream(seed ^ CHOOSING, STREAM_CHOSEN_WITH))?;
    let plan = Plan {
        recipe: recipe.training.clone(),
        data: model.model_hash().into(),
        noise_sd_v: None,
        compute,
    };
    let mut trained = train::train(&plan, &learn, &choose, checkpoint, observer)?;
    if let Some(skin) = model.sensor().skin() {
        let mean: Vec<f32> = skin.offsets_mv.iter().map(|mv| (1e-3 * mv) as f32).collect();
        let sd = vec![1.0; mean.len()];
        trained.network.layers.insert(0, Layer::Standardise { mean, sd });
    }
    let [fewest, most] = net.draws.contacts;
    let untouched = (fewest > 0 && net.draws.untouched_share > 0.0).then_some(0);
    let range = TrainedRange {
        contact_counts: untouched.into_iter().chain(fewest as u32..=most as u32).collect(),
        max_force_n: Some(net.draws.force_n[1].max(net.draws.light_force_n[1])),
        forces_unknown: false,
        max_norm_v: choose.max_norm_v(),
    };
    Ok(Learned { trained, range, residuals: None, places_mm: Vec::new() })
}

/// Keeps at most `most` rows, taken evenly.
fn thin(rows: &mut Vec<u32>, most: usize) {
    let all = rows.len();
    if most < all {
        *rows = (0..most).map(|i| rows[i * all / most]).collect();
    }
}

fn samples<'a>(
    recipe: &Recipe,
    given: &Given<'a>,
    rows: Vec<u32>,
    targets: Option<&Targets>,
) -> Result<RowSamples<'a>, LearnError> {
    let examples = given.examples;
    let target = match (targets, recipe.training.net.answer(), recipe.map) {
        (Some(targets), ..) => Target::Quantity(targets.clone()),
        (None, Answer::Frame, _) => Target::Frame,
        (None, Answer::Map { side }, Some(map)) => {
            let draws = ForceMap::new(map, [given.skin.width_mm, given.skin.height_mm]);
            let draws = draws
                .map_err(|error| LearnError::value("recipe", "map", map, &error.to_string()))?;
            if draws.pixels() != side {
                let limit = format!("must be the {} pixels of a side of map {map}", draws.pixels());
                return Err(LearnError::value("recipe", "training.net.side", side, &limit));
            }
            // If no contact has a force, the map contains positions only.
            let contacts = || rows.iter().flat_map(|&row| examples.contacts(row));
            let force_of_unknown_n = contacts().all(|c| c.force_n.is_none()).then_some(1.0);
            Target::Map { draws, force_of_unknown_n }
        }
        _ => {
            let limit = "does not use a dataset";
            return Err(LearnError::value("recipe", "training.net", recipe.task().as_str(), limit));
        }
    };
    Ok(RowSamples { examples, rows, target })
}

/// Measures the residuals of a Transfer-Net on the validation rows.
fn residuals(network: &Network, given: &Given<'_>) -> Result<Residuals, LearnError> {
    let mut rows = given.examples.part(Part::Validation);
    thin(&mut rows, RESIDUAL_ROWS);
    let channels = given.examples.channels;
    let (mut sum, mut squares) = (vec![0.0; channels], vec![0.0; channels]);
    let mut target = vec![0.0; channels];
    for rows in rows.chunks(FRAMES_AT_ONCE) {
        let mut frames = vec![0.0; rows.len() * channels];
        for (&row, frame) in rows.iter().zip(frames.chunks_exact_mut(channels)) {
            given.examples.frame(row, 0, frame)?;
        }
        let answers = answer(network, &frames, given.compute)?;
        for (&row, answer) in rows.iter().zip(answers.chunks_exact(channels)) {
            given.examples.frame(row, 1, &mut target)?;
            for channel in 0..channels {
                let left = f64::from(answer[channel]) - f64::from(target[channel]);
                sum[channel] += left;
                squares[channel] += left * left;
            }
        }
    }
    let n = rows.len() as f64;
    let mean: Vec<f64> = sum.iter().map(|sum| sum / n).collect();
    let sd = squares.iter().zip(&mean).map(|(sq, mean)| (sq / n - mean * mean).max(0.0).sqrt());
    Ok(Residuals {
        sd_v: sd.map(|sd| sd as f32).collect(),
        mean_v: mean.iter().map(|&mean| mean as f32).collect(),
        trials: rows.len() as u64,
    })
}
