//! Many trials at once: the forward model in lanes of f32, one trial in each.
//! Uses: `forward`, `network` (plan, lanes, reduction, readout). Never: threads, files.
//!
//! The same physics as [`ForwardModel`], term by term; frames differ from its f64 ones by less than
//! 2e-6 of the electrode voltages that they are differences of. A trial's bytes depend on the kernel
//! alone, not on the trials beside it.

mod foam;
mod kernel;
mod loads;

pub use kernel::Kernel;

use foam::{BLOCK, Foam};
use loads::PointRows;

use crate::forward::{Contact, ContactError, ForwardModel, Workspace};
use crate::network::lane::{Lane32, LaneJob, LaneWork};
use crate::network::plan::ReductionPlan;
use crate::network::readout::ReadoutWork;
use crate::network::reduce::reduce;

/// Why there are no frames.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BatchError {
    /// A trial has a contact that the model does not take.
    #[error("trial {trial}: {source}")]
    Trial {
        /// Index of the trial.
        trial: usize,
        /// What is wrong with it.
        source: ContactError,
    },
    /// The output does not hold one frame for each trial.
    #[error("batch: {trials} trials need room for {needed} voltages, there is room for {found}")]
    Output {
        /// Trials given.
        trials: usize,
        /// Voltages that they have.
        needed: usize,
        /// Voltages that fit.
        found: usize,
    },
}

/// The forward model of one skin, for many trials. `Send + Sync`; each thread brings its own
/// [`BatchWork`].
#[derive(Debug)]
pub struct BatchModel {
    model: ForwardModel,
    kernel: Kernel,
    plan: ReductionPlan,
    foam: Foam,
    points: PointRows,
}

/// Memory of evaluations; fits any model and kernel.
#[derive(Default)]
pub struct BatchWork {
    one: Workspace,
    compression_mm: Vec<[f32; BLOCK]>,
    touched: Vec<bool>,
    rest_s: Vec<[f32; BLOCK]>,
    to_top_s: Vec<f32>,
    lanes: LaneWork,
    reduced: Vec<f32>,
    block: Vec<f64>,
    readout: ReadoutWork,
}

impl BatchModel {
    /// Lays out a model's tables for a kernel. On a processor without it, see [`Kernel::is_here`],
    /// the portable one takes its place.
    pub fn new(model: &ForwardModel, kernel: Kernel) -> Self {
        let kernel = if kernel.is_here() { kernel } else { Kernel::PortableF32x8 };
        let network = model.network().expect("the model was built from this network");
        let plan = ReductionPlan::new(&network);
        Self {
            foam: Foam::new(plan.order(), &model.laws, model.fields().displacement.clone()),
            points: PointRows::new(model, plan.order()),
            model: model.clone(),
            kernel,
            plan,
        }
    }

    /// The kernel in use.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Voltages in a frame.
    pub fn frame_len(&self) -> usize {
        self.plan.kept() * self.plan.kept()
    }

    /// The frames of trials, V after gain, one after the other, each as [`ForwardModel::voltages`]
    /// gives it. Contacts on points are quick; others take an f64 superposition each. After an error
    /// `out_v` holds nothing of use.
    pub fn voltages(
        &self,
        trials: &[&[Contact]],
        out_v: &mut [f32],
        work: &mut BatchWork,
    ) -> Result<(), BatchError> {
        let needed = trials.len() * self.frame_len();
        if out_v.len() != needed {
            let found = out_v.len();
            return Err(BatchError::Output { trials: trials.len(), needed, found });
        }
        self.kernel.run(Frames { batch: self, trials, out_v, work })
    }
}

/// The job of [`BatchModel::voltages`].
struct Frames<'a> {
    batch: &'a BatchModel,
    trials: &'a [&'a [Contact]],
    out_v: &'a mut [f32],
    work: &'a mut BatchWork,
}

impl LaneJob for Frames<'_> {
    type Output = Result<(), BatchError>;

    #[inline(always)]
    fn run<L: Lane32>(self) -> Self::Output {
        let Self { batch, trials, out_v, work } = self;
        rest::<L>(batch, work);
        let frames = out_v.chunks_mut(L::LANES * batch.frame_len());
        for (group, (trials, frames)) in trials.chunks(L::LANES).zip(frames).enumerate() {
            work.to_top_s.resize(batch.foam.nodes() * L::LANES, 0.0);
            for lane in 0..L::LANES {
                let contacts = trials.get(lane).copied().unwrap_or_default();
                let trial = group * L::LANES + lane;
                load_trial::<L>(batch, contacts, lane, work)
                    .map_err(|source| BatchError::Trial { trial, source })?;
            }
            let reduced = reduce(&batch.plan, &work.to_top_s, L::own(&mut work.lanes));
            work.reduced.resize(reduced.len() * L::LANES, 0.0);
            for (lanes, numbers) in reduced.iter().zip(work.reduced.chunks_exact_mut(L::LANES)) {
                lanes.store(numbers);
            }
            for (lane, frame) in frames.chunks_exact_mut(batch.frame_len()).enumerate() {
                read_out(batch, lane, L::LANES, work, frame);
            }
        }
        Ok(())
    }
}

/// Conductances of the untouched skin.
#[inline(always)]
fn rest<L: Lane32>(batch: &BatchModel, work: &mut BatchWork) {
    work.rest_s.clear();
    work.rest_s.resize(batch.foam.nodes() / BLOCK, [0.0; BLOCK]);
    for (block, values) in work.rest_s.iter_mut().enumerate() {
        batch.foam.conduct::<L>(block, values);
    }
}

/// Works out one trial's conductances and puts them into its lane.
#[inline(always)]
fn load_trial<L: Lane32>(
    batch: &BatchModel,
    contacts: &[Contact],
    lane: usize,
    work: &mut BatchWork,
) -> Result<(), ContactError> {
    let blocks = batch.foam.nodes() / BLOCK;
    work.compression_mm.clear();
    work.compression_mm.resize(blocks, [0.0; BLOCK]);
    work.touched.clear();
    work.touched.resize(blocks, false);
    let mut on_points = true;
    for (index, contact) in contacts.iter().enumerate() {
        batch.model.check(index, contact)?;
        let Some(row) = batch.points.find(contact.x_mm, contact.y_mm) else {
            on_points = false;
            break;
        };
        let sums = &mut work.compression_mm;
        batch.points.add::<L>(row, contact.force_n, sums, &mut work.touched);
    }
    if !on_points {
        batch.model.load(contacts, &mut work.one)?;
        let nodes = work.compression_mm.as_flattened_mut().iter_mut();
        for (x, &node) in nodes.zip(batch.plan.order()) {
            *x = work.one.compression_mm().get(node as usize).map_or(0.0, |&x| x as f32);
        }
        work.touched.fill(true);
    }
    let nodes = work.to_top_s.chunks_exact_mut(BLOCK * L::LANES);
    for (block, (nodes, values)) in nodes.zip(&mut work.compression_mm).enumerate() {
        if work.touched[block] {
            batch.foam.conduct::<L>(block, values);
        } else {
            *values = work.rest_s[block];
        }
        for (lanes, &value) in nodes.chunks_exact_mut(L::LANES).zip(values.iter()) {
            lanes[lane] = value;
        }
    }
    Ok(())
}

/// From one lane of the reduced network to its frame, in f64.
#[inline(always)]
fn read_out(
    batch: &BatchModel,
    lane: usize,
    lanes: usize,
    work: &mut BatchWork,
    frame: &mut [f32],
) {
    let kept = batch.plan.kept();
    work.block.clear();
    work.block.resize((kept + 1) * kept, 0.0);
    let mut numbers = work.reduced.iter().skip(lane).step_by(lanes);
    for (column, values) in work.block.chunks_exact_mut(kept + 1).enumerate() {
        for (value, &number) in values[column + 1..].iter_mut().zip(&mut numbers) {
            *value = f64::from(number);
        }
    }
    work.readout.evaluate(&work.block, batch.model.circuit());
    for (out, &v) in frame.iter_mut().zip(work.readout.frame_v()) {
        *out = v as f32;
    }
}
