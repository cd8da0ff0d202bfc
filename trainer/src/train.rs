//! Training: batches, losses and steps, until all epochs are done or the loss no longer decreases.
//! Uses: burn, nets. Never: files, the clock.

use burn::tensor::{Tensor, TensorData};
use nets::architecture::Answer;
use nets::batches::{Batch, Pass};
use nets::checkpoint::{self, EpochLoss, Place, State, Subject};
use nets::closed_form::{self, constant_channels};
use nets::error::{RecipeError, TrainError, require};
use nets::input::Input;
use nets::loss::Loss;
use nets::network::Network;
use nets::noise::NoiseSource;
use nets::progress::{End, Flow, Observer, Plan, Progress, Trained};
use nets::recipe::Recipe;
use nets::samples::Samples;
use nets::statistics::Statistics;

use crate::adam::{Adam, Update};
use crate::device;
use crate::loss::value;
use crate::model::Model;

/// Largest number of values in a batch: a few batches are in memory, and activations are larger.
const BATCH_MAX: usize = 1 << 26;

/// Number of the epoch whose noise validation samples get; no training reaches it.
const VALIDATION: u64 = u64::MAX;

/// Trains a net, from the beginning or from a checkpoint of the same plan and data.
///
/// # Errors
/// `TrainError` if recipe, data or checkpoint do not match, a sample cannot be read, or the loss is not
/// finite.
pub fn train(
    plan: &Plan,
    train: &dyn Samples,
    validation: &dyn Samples,
    checkpoint: Option<&[u8]>,
    observer: &mut (dyn Observer + Send),
) -> Result<Trained, TrainError> {
    plan.recipe.check()?;
    device::run(plan.compute, || match plan.recipe.net.architecture().closed_form() {
        Some(form) => {
            check(plan, train, validation)?;
            closed_form::fit(plan, form, [train, validation], observer)
        }
        None => Training::new(plan, train, validation, checkpoint, observer)?.run(observer),
    })?
}

/// Checks that the net can be trained on the data.
fn check(plan: &Plan, train: &dyn Samples, validation: &dyn Samples) -> Result<(), RecipeError> {
    let (channels, target) = (train.input_len(), train.target_len());
    require(!train.is_empty(), "training samples", 0, "at least 1")?;
    require(!validation.is_empty(), "validation samples", 0, "at least 1")?;
    let alike = validation.input_len() == channels && validation.target_len() == target;
    require(alike, "validation samples", "of other lengths", "as long as the training samples")?;
    require(channels > 0, "channels", channels, "at least 1")?;
    let held = plan.recipe.batch.saturating_mul(channels + target);
    let limit = "at most 2^26 numbers per batch, channels and target";
    require(held <= BATCH_MAX, "batch", plan.recipe.batch, limit)?;
    if let Some(sd_v) = &plan.noise_sd_v {
        let limit = "one for each channel";
        require(sd_v.len() == channels, "noise standard deviations", sd_v.len(), limit)?;
    }
    let given = plan.recipe.noise.level == 0.0 || plan.noise_sd_v.is_some();
    let limit = "0 without the residuals of a Transfer-Net";
    require(given, "noise.level", plan.recipe.noise.level, limit)?;
    match plan.recipe.net.answer() {
        Answer::Frame => {
            require(target == channels, "numbers of a target", target, "as many as channels")
        }
        Answer::Map { side } => {
            let square = side * side;
            require(target == square, "numbers of a target", target, "the square of net.side")
        }
        Answer::Points => require(target > 0, "points", target, "at least 1"),
        Answer::Quantity(quantity) => {
            let limit = "as many as the quantity has";
            let fits = target > 0 && target == quantity.len(target);
            require(fits, "numbers of a target", target, limit)
        }
    }
}

/// A running training.
struct Training<'a> {
    recipe: &'a Recipe,
    subject: Subject,
    train: &'a dyn Samples,
    validation: &'a dyn Samples,
    noise: NoiseSource,
    loss: Loss,
    model: Model,
    adam: Adam,
    place: Place,
    best: Network,
}

impl<'a> Training<'a> {
    fn new(
        plan: &'a Plan,
        train: &'a dyn Samples,
        validation: &'a dyn Samples,
        checkpoint: Option<&[u8]>,
        observer: &mut dyn Observer,
    ) -> Result<Self, TrainError> {
        check(plan, train, validation)?;
        let recipe = &plan.recipe;
        let (channels, target) = (train.input_len(), train.target_len());
        let subject = Subject {
            recipe: recipe.clone(),
            data: plan.data.clone(),
            channels,
            target,
            samples: train.len(),
            validation_samples: validation.len(),
        };
        let noise =
            NoiseSource::new(recipe.seed, recipe.noise, plan.noise_sd_v.as_deref(), channels);
        let measured = recipe.net.input().measured();
        let state = checkpoint.map(|bytes| checkpoint::read(bytes, &subject)).transpose()?;
        let statistics = match &state {
            None => Statistics::measure(train, measured, &noise, recipe.seed)?,
            Some(_) => Statistics::unknown(measured, channels, target),
        };
        let constant = statistics.constant_channels();
        if constant > 0 && recipe.net.input().scales_channels() {
            observer.warn(constant_channels(constant, channels));
        }
        let mut network = recipe.first(&statistics, target);
        let mut best = network.clone();
        let mut place = Place::default();
        if let Some(state) = &state {
            checkpoint::fits(state, &network)?;
            network.set_numbers(&state.network);
            best.set_numbers(&state.best);
            place = state.place.clone();
        }
        let device = device::of(plan.compute)?;
        let loss = recipe.net.architecture().loss(network.target_size());
        let model = Model::new(network, Input::LAYERS, &device);
        let update = if plan.compute.is_host() { Update::InPlace } else { Update::AsTensors };
        let mut adam = Adam::new(recipe.optimiser, model.shapes(), &device, update);
        if let Some(state) = state {
            adam.set_state(state.steps, state.moments);
        }
        Ok(Self { recipe, subject, train, validation, noise, loss, model, adam, place, best })
    }

    fn run(mut self, observer: &mut dyn Observer) -> Result<Trained, TrainError> {
        while self.place.epoch < self.recipe.epochs {
            if self.impatient() {
                return Ok(self.end(End::Patience));
            }
            if !self.epoch(observer)? {
                return Ok(self.end(End::Stopped));
            }
            let validation = self.judge()?;
            let train = self.train_loss();
            let epoch = self.place.epoch;
            if self.best_epoch().is_none_or(|best| validation < best.validation) {
                self.best = self.model.network();
            }
            self.place.curve.push(EpochLoss { epoch, train, validation });
            let progress = Progress { validation_loss: Some(validation), ..self.progress() };
            self.place = Place { epoch: epoch + 1, batches: 0, loss_sum: 0.0, ..self.place };
            if !self.follow(observer, &progress) {
                return Ok(self.end(End::Stopped));
            }
        }
        Ok(self.end(End::Epochs))
    }

    /// Learns the remaining batches of the epoch; returns `false` if it must stop.
    fn epoch(&mut self, observer: &mut dyn Observer) -> Result<bool, TrainError> {
        let noise = self.noise.clone();
        let pass = Pass {
            from: self.train,
            noise: &noise,
            batch: self.recipe.batch,
            shuffle: Some(self.recipe.seed),
            epoch: self.place.epoch.into(),
            skip: self.place.batches,
        };
        pass.each(|batch| {
            self.learn(batch)?;
            let progress = self.progress();
            Ok(self.follow(observer, &progress))
        })
    }

    fn learn(&mut self, batch: Batch) -> Result<(), TrainError> {
        let [inputs, targets] = self.tensors(batch);
        let loss = value(self.loss, self.model.learn(inputs), targets.autodiff());
        let minimised: f32 = loss.clone().into_scalar();
        if !minimised.is_finite() {
            let (epoch, batch) = (self.place.epoch, self.place.batches);
            return Err(TrainError::Diverged { epoch, batch });
        }
        let gradients = self.model.gradients(&mut loss.backward());
        drop(loss);
        let taken = self.place.epoch as u64 * self.batches() + self.place.batches;
        let steps = self.recipe.epochs as u64 * self.batches();
        let rate = self.recipe.optimiser.rate(taken, steps);
        self.adam.step(&mut self.model, gradients, rate);
        self.place.batches += 1;
        self.place.loss_sum += f64::from(minimised);
        Ok(())
    }

    /// Computes the loss on the validation samples.
    fn judge(&mut self) -> Result<f64, TrainError> {
        let noise = self.noise.clone();
        let pass = Pass {
            from: self.validation,
            noise: &noise,
            batch: self.recipe.batch,
            shuffle: None,
            epoch: VALIDATION,
            skip: 0,
        };
        let mut sum = 0.0;
        pass.each(|batch| {
            let len = batch.len as f64;
            let [inputs, targets] = self.tensors(batch);
            let answers = self.model.judge(inputs);
            let minimised: f32 = value(self.loss, answers, targets).into_scalar();
            sum += f64::from(minimised) * len;
            Ok::<_, TrainError>(true)
        })?;
        Ok(self.loss.in_units(sum / self.validation.len() as f64))
    }

    fn tensors(&self, batch: Batch) -> [Tensor<2>; 2] {
        [batch.inputs, batch.targets].map(|numbers| {
            let shape = [batch.len, numbers.len() / batch.len];
            Tensor::from_data(TensorData::new(numbers, shape), self.model.device())
        })
    }

    /// Number of batches of an epoch.
    fn batches(&self) -> u64 {
        self.train.len().div_ceil(self.recipe.batch as u64)
    }

    fn train_loss(&self) -> f64 {
        self.loss.in_units(self.place.loss_sum / self.place.batches.max(1) as f64)
    }

    fn best_epoch(&self) -> Option<EpochLoss> {
        let by_loss = |a: &&EpochLoss, b: &&EpochLoss| a.validation.total_cmp(&b.validation);
        self.place.curve.iter().min_by(by_loss).copied()
    }

    fn impatient(&self) -> bool {
        let since = self.best_epoch().map_or(0, |best| self.place.epoch - 1 - best.epoch);
        self.recipe.patience.is_some_and(|patience| since >= patience)
    }

    fn progress(&self) -> Progress {
        let (epoch, epochs) = (self.place.epoch, self.recipe.epochs);
        let len = self.train.len();
        let learned = (self.place.batches * self.recipe.batch as u64).min(len);
        Progress {
            epoch,
            epochs,
            batches: [self.place.batches, self.batches()],
            samples: [u64::from(epoch) * len + learned, u64::from(epochs) * len],
            train_loss: self.train_loss(),
            validation_loss: None,
            best: self.best_epoch(),
        }
    }

    /// Reports progress and follows the observer; returns `false` if the training must stop.
    fn follow(&self, observer: &mut dyn Observer, progress: &Progress) -> bool {
        let flow = observer.see(progress);
        if flow != Flow::Continue {
            let (steps, moments) = self.adam.state();
            let state = State {
                place: self.place.clone(),
                network: self.model.network().numbers(),
                best: self.best.numbers(),
                steps,
                moments,
            };
            observer.keep(checkpoint::write(&self.subject, &state));
        }
        flow != Flow::Stop
    }

    fn end(self, end: End) -> Trained {
        let none = self.place.curve.is_empty();
        let network = if none { self.model.network() } else { self.best };
        Trained { network, curve: self.place.curve, end }
    }
}
