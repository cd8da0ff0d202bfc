//! Fits of nets in closed form (`ridge`): penalties, and widths of the kernel, are tried, and the one with the
//! least error on the validation rows is kept.
//! Uses: faer, `recipe`, `progress`. Never: test rows; more than a bounded number of rows in memory.

use faer::prelude::Solve;
use faer::{Mat, Scale, Side};

use crate::architecture::ClosedForm;
use crate::checkpoint::EpochLoss;
use crate::error::TrainError;
use crate::network::{Layer, Network};
use crate::noise::NoiseSource;
use crate::progress::{End, Flow, Observer, Plan, Progress, Trained};
use crate::samples::{Samples, read_finite};
use crate::statistics::Statistics;

/// Largest number of values of frames in memory, 1 GB.
const HELD_MAX: usize = 1 << 27;
/// Number of rows that are read at a time.
const CLOSED_FORM_ROWS: usize = 256;
/// Largest numbers of training and validation rows by which the width of the kernel is chosen.
const FEW: [usize; 2] = [1200, 1000];
/// Largest number of validation rows.
const JUDGES_MAX: usize = 4000;
/// Largest number of numbers of a target by which penalty and width are chosen, taken evenly: a map of 4 mm has
/// 25,600.
const JUDGED_MAX: usize = 1024;
/// Largest number of weights from centres to answers, 64 MB in a file: 655 centres for a map of 4 mm.
const ANSWERS_MAX: usize = 1 << 24;
/// Widths of the kernel, as `gamma` times the number of channels: from far wider than the distance of two
/// rows to narrower.
const GAMMAS: [f64; 10] = [1e-4, 1e-3, 4e-3, 0.015, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0];

/// Powers of ten of the penalty, relative to the mean eigenvalue of what is inverted.
fn penalties() -> impl Iterator<Item = f64> {
    (-20..=4).map(|half| 10f64.powf(f64::from(half) / 2.0))
}

/// Fits a net in closed form.
///
/// # Errors
/// `TrainError::Samples` if a sample cannot be read; `Singular` if a matrix cannot be decomposed.
pub fn fit(
    plan: &Plan,
    form: ClosedForm,
    [train, validation]: [&dyn Samples; 2],
    observer: &mut dyn Observer,
) -> Result<Trained, TrainError> {
    let recipe = &plan.recipe;
    let noise_sd_v = plan.noise_sd_v.as_deref();
    let noise = NoiseSource::new(recipe.seed, recipe.noise, noise_sd_v, train.input_len());
    let input = recipe.net.input();
    let statistics = Statistics::measure(train, input.measured(), &noise, recipe.seed)?;
    let constant = statistics.constant_channels();
    if constant > 0 {
        observer.warn(constant_channels(constant, train.input_len()));
    }
    let network = recipe.first(&statistics, train.target_len());
    let limit = input.limit().unwrap_or(f32::INFINITY);
    let data = Data { statistics: &statistics, noise: &noise, limit };
    let trials = match form {
        ClosedForm::Ridge => 1,
        ClosedForm::KernelRidge { .. } => GAMMAS.len() as u32 + 1,
    };
    let mut log = Log { observer, trials, samples: train.len(), curve: Vec::new() };
    let best = match form {
        ClosedForm::Ridge => ridge(&data, train, validation, &mut log)?,
        ClosedForm::KernelRidge { centres } => {
            kernel_ridge(&data, train, validation, centres, &mut log)?
        }
    };
    let end = if best.is_some() { End::Epochs } else { End::Stopped };
    let network = best.map_or_else(|| network.clone(), |middle| placed(&network, middle));
    Ok(Trained { network, curve: log.curve, end })
}

/// Message about channels without information.
pub fn constant_channels(constant: usize, channels: usize) -> String {
    format!(
        "{constant} of {channels} channels are constant in the training rows: they are ignored, whatever \
         they are later"
    )
}

/// A network with fitted layers in place of its empty ones, which end with its one dense layer.
fn placed(network: &Network, middle: Vec<Layer>) -> Network {
    let mut layers = network.layers.clone();
    let is_empty = |layer: &Layer| matches!(layer, Layer::Dense { .. } | Layer::Kernel { .. });
    layers.retain(|layer| !is_empty(layer));
    let first = network.layers.iter().position(is_empty).unwrap_or_default();
    layers.splice(first..first, middle);
    Network { layers, ..network.clone() }
}

/// Rows of scaled numbers: frames `[rows, channels]`, targets `[rows, numbers]`.
struct Rows {
    frames: Mat<f64>,
    targets: Mat<f64>,
}

struct Data<'a> {
    statistics: &'a Statistics,
    noise: &'a NoiseSource,
    /// Largest absolute value of a scaled channel.
    limit: f32,
}

impl Data<'_> {
    /// Reads samples, scaled as by the first layers of the net; of their targets the numbers `kept`.
    fn read(
        &self,
        from: &dyn Samples,
        numbers: &[u64],
        kept: &[usize],
    ) -> Result<Rows, TrainError> {
        let (channels, target) = (from.input_len(), from.target_len());
        let mut rows = Rows {
            frames: Mat::zeros(numbers.len(), channels),
            targets: Mat::zeros(numbers.len(), kept.len()),
        };
        let (mut x, mut y) =
            (vec![0.0; CLOSED_FORM_ROWS * channels], vec![0.0; CLOSED_FORM_ROWS * target]);
        let of = self.statistics;
        for (piece, numbers) in numbers.chunks(CLOSED_FORM_ROWS).enumerate() {
            let (x, y) = (&mut x[..numbers.len() * channels], &mut y[..numbers.len() * target]);
            read_finite(from, numbers, x, y)?;
            for (nth, &number) in numbers.iter().enumerate() {
                let row = piece * CLOSED_FORM_ROWS + nth;
                let frame = &mut x[nth * channels..][..channels];
                self.noise.add(0, number, frame);
                for (i, &v) in frame.iter().enumerate() {
                    let scaled = (v - of.mean[i]) / of.sd[i];
                    rows.frames[(row, i)] = f64::from(scaled.clamp(-self.limit, self.limit));
                }
                let of_row = &y[nth * target..][..target];
                for (column, &i) in kept.iter().enumerate() {
                    let scaled = (of_row[i] - of.target_mean[i]) / of.target_sd[i];
                    rows.targets[(row, column)] = f64::from(scaled);
                }
            }
        }
        Ok(rows)
    }
}

/// At most `most` of the numbers of samples, taken evenly.
fn evenly(from: &dyn Samples, most: usize) -> Vec<u64> {
    let (all, most) = (from.len(), most as u64);
    if all <= most { (0..all).collect() } else { (0..most).map(|i| i * all / most).collect() }
}

/// All numbers of a target, and those by which penalty and width are chosen.
fn numbers_of(target: usize) -> [Vec<usize>; 2] {
    let judged = target.min(JUDGED_MAX);
    [(0..target).collect(), (0..judged).map(|i| i * target / judged).collect()]
}

/// Progress of the fit, one step for each matrix that is decomposed.
struct Log<'a> {
    observer: &'a mut dyn Observer,
    trials: u32,
    samples: u64,
    curve: Vec<EpochLoss>,
}

impl Log<'_> {
    /// Notes the mean squared errors of standardised targets of a step; returns `false` if it must stop.
    fn step(&mut self, train: f64, validation: f64) -> bool {
        let epoch = self.curve.len() as u32;
        self.curve.push(EpochLoss { epoch, train, validation });
        let best = self.curve.iter().min_by(|a, b| a.validation.total_cmp(&b.validation)).copied();
        let progress = Progress {
            epoch,
            epochs: self.trials,
            batches: [1, 1],
            samples: [u64::from(epoch + 1) * self.samples, u64::from(self.trials) * self.samples],
            train_loss: train,
            validation_loss: Some(validation),
            best,
        };
        self.observer.see(&progress) != Flow::Stop
    }
}

/// Weights of standardised inputs `[inputs, numbers]`, and their errors.
struct Solution {
    weights: Mat<f64>,
    train: f64,
    validation: f64,
    penalty: f64,
}

fn mean_square(answers: &Mat<f64>, targets: &Mat<f64>) -> f64 {
    let apart = answers - targets;
    apart.squared_norm_l2() / (targets.nrows() * targets.ncols()) as f64
}

/// Solves `(A + penalty I) W = B` for all penalties by one decomposition of A, symmetric and not negative,
/// and returns the W whose answers err least on the validation rows. `judged`: the columns of B whose weights
/// `validation_error` judges; `train_error` judges those of all.
fn solve(
    matrix: &Mat<f64>,
    right: &Mat<f64>,
    judged: &[usize],
    train_error: impl Fn(&Mat<f64>) -> f64,
    validation_error: impl Fn(&Mat<f64>) -> f64,
) -> Result<Solution, TrainError> {
    let decomposed = matrix.self_adjoint_eigen(Side::Lower).map_err(|_| TrainError::Singular)?;
    let (values, vectors) = (decomposed.S().column_vector(), decomposed.U());
    let size = matrix.nrows();
    let unit = (0..size).map(|i| matrix[(i, i)]).sum::<f64>() / size as f64;
    let along = vectors.transpose() * right;
    let weights = |penalty: f64, columns: &[usize]| {
        let scaled = Mat::from_fn(size, columns.len(), |i, j| {
            along[(i, columns[j])] / (values[i].max(0.0) + penalty)
        });
        vectors * scaled
    };
    let mut best: Option<(f64, f64)> = None;
    for relative in penalties() {
        let penalty = relative * unit.max(f64::MIN_POSITIVE);
        let validation = validation_error(&weights(penalty, judged));
        if best.is_none_or(|(_, least)| validation < least) {
            best = Some((penalty, validation));
        }
    }
    let (penalty, validation) = best.ok_or(TrainError::Singular)?;
    let all: Vec<usize> = (0..right.ncols()).collect();
    let weights = weights(penalty, &all);
    Ok(Solution { train: train_error(&weights), weights, validation, penalty })
}

/// The fitted layers; `None` if it was stopped.
fn ridge(
    data: &Data<'_>,
    train: &dyn Samples,
    validation: &dyn Samples,
    log: &mut Log<'_>,
) -> Result<Option<Vec<Layer>>, TrainError> {
    let channels = train.input_len();
    let [all, judged] = numbers_of(train.target_len());
    let judging = evenly(validation, JUDGES_MAX.min(HELD_MAX / channels));
    let mut judges = data.read(validation, &judging, &judged)?;
    let few = train.len() < channels as u64;
    // Few rows themselves, if they are a first layer: a long target then needs fewer weights.
    let mut inner: Option<Mat<f64>> = None;
    // Scaled channels have a mean: that of clipped ones, or that of rows which were not measured.
    let (mean, solution) = if few {
        // Fewer rows than channels: in dual variables.
        let mut rows = data.read(train, &evenly(train, HELD_MAX / channels), &all)?;
        let mean = sums(&rows.frames) * Scale(1.0 / rows.frames.nrows() as f64);
        centre(&mut rows.frames, &mean);
        centre(&mut judges.frames, &mean);
        let products = &rows.frames * rows.frames.transpose();
        let across = &judges.frames * rows.frames.transpose();
        let (count, target) = (rows.frames.nrows(), all.len());
        let is_long = target > judged.len() && count * (channels + target) < channels * target;
        let size = (0..count).map(|i| products[(i, i)]).sum::<f64>() / count as f64;
        // The answers of two layers lose more in 32 bits.
        let lost = if is_long { size.powi(2) } else { 0.0 };
        let solution = solve(
            &products,
            &rows.targets,
            &judged,
            |dual| mean_square(&(&products * dual), &rows.targets),
            |dual| mean_square(&(&across * dual), &judges.targets) + lost * rounding(dual),
        )?;
        if is_long {
            inner = Some(Mat::from_fn(channels, count, |i, j| rows.frames[(j, i)]));
            (mean, solution)
        } else {
            (mean, Solution { weights: rows.frames.transpose() * &solution.weights, ..solution })
        }
    } else {
        let mut products = Mat::<f64>::zeros(channels, channels);
        let mut right = Mat::<f64>::zeros(channels, train.target_len());
        let mut square = 0.0;
        let mut mean = Mat::<f64>::zeros(1, channels);
        let mut of_targets = Mat::<f64>::zeros(1, train.target_len());
        let numbers: Vec<u64> = (0..train.len()).collect();
        for numbers in numbers.chunks(4 * CLOSED_FORM_ROWS) {
            let rows = data.read(train, numbers, &all)?;
            products += rows.frames.transpose() * &rows.frames;
            right += rows.frames.transpose() * &rows.targets;
            square += rows.targets.squared_norm_l2();
            mean += sums(&rows.frames);
            of_targets += sums(&rows.targets);
        }
        let count = train.len() as f64;
        mean *= Scale(1.0 / count);
        products -= mean.transpose() * &mean * Scale(count);
        right -= mean.transpose() * &of_targets;
        centre(&mut judges.frames, &mean);
        let of_judges =
            |weights: &Mat<f64>| mean_square(&(&judges.frames * weights), &judges.targets);
        let values = (train.len() as usize * train.target_len()) as f64;
        // |X W - Y|^2 without the rows.
        let of_train = |weights: &Mat<f64>| {
            let fitted = &products * weights;
            let sum: f64 = (0..weights.ncols())
                .flat_map(|j| (0..channels).map(move |i| (i, j)))
                .map(|at| weights[at] * (fitted[at] - 2.0 * right[at]))
                .sum();
            ((square + sum) / values).max(0.0)
        };
        (mean, solve(&products, &right, &judged, of_train, of_judges)?)
    };
    if !log.step(solution.train, solution.validation) {
        return Ok(None);
    }
    let weights = &solution.weights;
    let first = inner.as_ref().unwrap_or(weights);
    let bias = &mean * first * Scale(-1.0);
    let second = inner.is_some().then(|| dense(weights, &Mat::zeros(1, weights.ncols())));
    Ok(Some([dense(first, &bias)].into_iter().chain(second).collect()))
}

/// Sum of all rows, `[1, columns]`.
fn sums(rows: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(1, rows.ncols(), |_, j| (0..rows.nrows()).map(|i| rows[(i, j)]).sum())
}

/// Subtracts a row, `[1, columns]`, from all rows.
fn centre(rows: &mut Mat<f64>, mean: &Mat<f64>) {
    *rows = Mat::from_fn(rows.nrows(), rows.ncols(), |i, j| rows[(i, j)] - mean[(0, j)]);
}

fn kernel_ridge(
    data: &Data<'_>,
    train: &dyn Samples,
    validation: &dyn Samples,
    centres: usize,
    log: &mut Log<'_>,
) -> Result<Option<Vec<Layer>>, TrainError> {
    let (channels, target) = (train.input_len(), train.target_len());
    let [all, judged] = numbers_of(target);
    let centres = centres.min(HELD_MAX / channels).min(ANSWERS_MAX / target).max(1);
    let few = data.read(train, &evenly(train, FEW[0].min(centres)), &judged)?;
    let judges = data.read(validation, &evenly(validation, FEW[1].min(centres)), &judged)?;
    let of_few: Vec<usize> = (0..judged.len()).collect();
    let [within, across] = [&few, &judges].map(|rows| distances(&rows.frames, &few.frames));
    let mut chosen: Option<(f64, Solution)> = None;
    for gamma in GAMMAS.map(|gamma| gamma / channels as f64) {
        let kernel = kernel(&within, gamma);
        let to_judges = self::kernel(&across, gamma);
        let solution = solve(
            &kernel,
            &few.targets,
            &of_few,
            |dual| mean_square(&(&kernel * dual), &few.targets),
            |dual| mean_square(&(&to_judges * dual), &judges.targets) + rounding(dual),
        )?;
        if !log.step(solution.train, solution.validation) {
            return Ok(None);
        }
        if chosen.as_ref().is_none_or(|(_, best)| solution.validation < best.validation) {
            chosen = Some((gamma, solution));
        }
    }
    let Some((gamma, chosen)) = chosen else { return Err(TrainError::Singular) };
    drop((within, across));
    let rows = data.read(train, &evenly(train, centres), &all)?;
    let judging = evenly(validation, JUDGES_MAX.min(HELD_MAX / channels));
    let judges = data.read(validation, &judging, &judged)?;
    let [within, across] = [&rows, &judges].map(|of| distances(&of.frames, &rows.frames));
    let some =
        Mat::from_fn(rows.targets.nrows(), judged.len(), |i, j| rows.targets[(i, judged[j])]);
    let mut best: Option<(f64, f64, f64)> = None;
    // More rows allow a narrower kernel and a smaller penalty.
    for gamma in [gamma, 2.0 * gamma] {
        let (kernel, to_judges) = (kernel(&within, gamma), kernel(&across, gamma));
        for share in [0.01, 0.1, 0.3, 1.0, 3.0] {
            let penalty = share * chosen.penalty;
            let Some(weights) = dual(&kernel, penalty, &some) else { continue };
            let validation =
                mean_square(&(&to_judges * &weights), &judges.targets) + rounding(&weights);
            if best.is_none_or(|(_, _, least)| validation < least) {
                best = Some((gamma, penalty, validation));
            }
        }
    }
    let (gamma, penalty, validation) = best.ok_or(TrainError::Singular)?;
    let kernel = kernel(&within, gamma);
    let weights = dual(&kernel, penalty, &rows.targets).ok_or(TrainError::Singular)?;
    if !log.step(mean_square(&(&kernel * &weights), &rows.targets), validation) {
        return Ok(None);
    }
    let frames = &rows.frames;
    let numbers = (0..frames.nrows()).flat_map(|i| (0..channels).map(move |j| (i, j)));
    let centres = numbers.map(|at| frames[at] as f32).collect();
    let layer = Layer::Kernel { inputs: channels, centres, gamma: gamma as f32 };
    let none = Mat::zeros(1, weights.ncols());
    Ok(Some(vec![layer, dense(&weights, &none)]))
}

/// Solves `(K + penalty I) W = B`; `None` if the matrix is not invertible in this precision: with a larger penalty
/// it is.
fn dual(kernel: &Mat<f64>, penalty: f64, right: &Mat<f64>) -> Option<Mat<f64>> {
    let mut matrix = kernel.clone();
    (0..matrix.nrows()).for_each(|i| matrix[(i, i)] += penalty);
    Some(matrix.llt(Side::Lower).ok()?.solve(right))
}

/// Mean square of what answers lose when the net is computed in 32 bits: wide kernels with a small penalty
/// have weights that are huge and cancel.
fn rounding(weights: &Mat<f64>) -> f64 {
    let of_a_value = f64::from(4.0 * f32::EPSILON).powi(2);
    of_a_value * weights.squared_norm_l2() / weights.ncols() as f64
}

/// Squared distances of the rows of a from those of b.
fn distances(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let square = |rows: &Mat<f64>, i: usize| rows.row(i).squared_norm_l2();
    let of_a: Vec<f64> = (0..a.nrows()).map(|i| square(a, i)).collect();
    let of_b: Vec<f64> = (0..b.nrows()).map(|i| square(b, i)).collect();
    let products = a * b.transpose();
    Mat::from_fn(a.nrows(), b.nrows(), |i, j| (of_a[i] + of_b[j] - 2.0 * products[(i, j)]).max(0.0))
}

fn kernel(distances: &Mat<f64>, gamma: f64) -> Mat<f64> {
    Mat::from_fn(distances.nrows(), distances.ncols(), |i, j| (-gamma * distances[(i, j)]).exp())
}

/// A dense layer without bias: standardised targets have a mean of zero.
fn dense(weights: &Mat<f64>, bias: &Mat<f64>) -> Layer {
    let (inputs, outputs) = (weights.nrows(), weights.ncols());
    let numbers = (0..outputs).flat_map(|j| (0..inputs).map(move |i| (i, j)));
    Layer::Dense {
        inputs,
        outputs,
        weight: numbers.map(|at| weights[at] as f32).collect(),
        bias: (0..outputs).map(|j| bias[(0, j)] as f32).collect(),
    }
}
