//! Many trials at once: the forward model in lanes of f32, one trial in each.
//! Uses: `forward`, `network` (plan, lanes, reduction, readout). Never: threads, files.
//!
//! The same physics as [`ForwardModel`], term by term; frames differ from its f64 frames by less
//! than 2e-6 of the electrode voltages that they are differences of. The bytes of a trial depend
//! on the kernel alone, not on the other trials of the batch.

mod foam;
mod kernel;
mod loads;

pub use kernel::Kernel;

use foam::{BLOCK_NODES, Foam};
use loads::PointRows;

use crate::forward::{Contact, ContactError, ContactResult, ForwardModel, Workspace};
use crate::network::lane::{Lane32, LaneJob};
use crate::network::lane_work::LaneWork;
use crate::network::plan::ReductionPlan;
use crate::network::readout::ReadoutWork;
use crate::network::reduce::reduce;

/// Trials that are read out together; divides every lane count.
const READ_OUT: usize = 8;

/// Why the frames of a batch cannot be computed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum BatchError {
    #[error("trial {trial}: {source}")]
    Trial { trial: usize, source: ContactError },
    #[error("batch: {trials} trials need room for {needed} voltages, there is room for {found}")]
    Output { trials: usize, needed: usize, found: usize },
}

/// The forward model of one skin, for many trials. `Send + Sync`; each thread needs its own
/// [`BatchWork`].
#[derive(Debug)]
pub struct BatchModel {
    model: ForwardModel,
    kernel: Kernel,
    plan: ReductionPlan,
    foam: Foam,
    points: PointRows,
}

#[derive(Default)]
struct TrialLoad {
    /// Nominal compression, before the clamp.
    compression_mm: Vec<[f32; BLOCK_NODES]>,
    /// Blocks whose compression is not zero.
    touched: Vec<bool>,
}

/// Memory of evaluations; may be reused with any model and kernel.
#[derive(Default)]
pub struct BatchWork {
    one: Workspace,
    loads: Vec<TrialLoad>,
    rest_s: Vec<[f32; BLOCK_NODES]>,
    to_top_s: Vec<f32>,
    lanes: LaneWork,
    reduced: Vec<f32>,
    block: Vec<[f64; READ_OUT]>,
    readout: ReadoutWork<READ_OUT>,
}

impl BatchModel {
    /// Lays out a model's tables for a kernel. The portable kernel is used if the processor does
    /// not support it, see [`Kernel::is_here`].
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

    /// Number of voltages in a frame.
    pub fn frame_len(&self) -> usize {
        self.plan.kept() * self.plan.kept()
    }

    /// Computes the frames of trials, V after gain, one after the other, each as
    /// [`ForwardModel::voltages`] returns it. Contacts on points are fast; each other contact takes
    /// an f64 superposition. After an error the contents of `out_v` are undefined.
    ///
    /// # Errors
    /// `BatchError::Output` if `out_v` does not hold one frame per trial; `BatchError::Trial` if a
    /// contact is rejected.
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
        // Each stage is a separate job, so that the code to vectorise stays small.
        self.kernel.run(Rest { foam: &self.foam, work });
        let lanes = self.kernel.lanes();
        let frames = out_v.chunks_mut(lanes * self.frame_len());
        for (group, (trials, frames)) in trials.chunks(lanes).zip(frames).enumerate() {
            self.kernel.run(Load { batch: self, trials, work }).map_err(|(lane, source)| {
                BatchError::Trial { trial: group * lanes + lane, source }
            })?;
            self.kernel.run(Reduce { plan: &self.plan, work });
            // In AVX-512 the compiler would gather and scatter the lanes, which is far slower.
            Kernel::Avx2F32x8.run(ReadOut { batch: self, lanes, work, frames });
        }
        Ok(())
    }
}

/// Computes the conductances of the untouched skin.
struct Rest<'a> {
    foam: &'a Foam,
    work: &'a mut BatchWork,
}

impl LaneJob for Rest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lane32>(self) {
        self.work.rest_s.clear();
        self.work.rest_s.resize(self.foam.nodes() / BLOCK_NODES, [0.0; BLOCK_NODES]);
        for (block, values) in self.work.rest_s.iter_mut().enumerate() {
            self.foam.conduct::<L>(block, values);
        }
    }
}

/// Computes the conductances of trials, one in each lane; lanes without a trial are untouched.
struct Load<'a> {
    batch: &'a BatchModel,
    trials: &'a [&'a [Contact]],
    work: &'a mut BatchWork,
}

impl LaneJob for Load<'_> {
    type Output = Result<(), (usize, ContactError)>;

    #[inline(always)]
    fn run<L: Lane32>(self) -> Self::Output {
        let Self { batch, trials, work } = self;
        work.loads.resize_with(L::LANES, TrialLoad::default);
        for lane in 0..L::LANES {
            let contacts = trials.get(lane).copied().unwrap_or_default();
            let load = &mut work.loads[lane];
            superpose::<L>(batch, contacts, load, &mut work.one).map_err(|e| (lane, e))?;
        }
        work.to_top_s.resize(batch.foam.nodes() * L::LANES, 0.0);
        let nodes = work.to_top_s.chunks_exact_mut(BLOCK_NODES * L::LANES);
        for (block, (nodes, rest_s)) in nodes.zip(&work.rest_s).enumerate() {
            for (lane, load) in work.loads.iter().enumerate() {
                let mut values = *rest_s;
                if load.touched[block] {
                    values = load.compression_mm[block];
                    batch.foam.conduct::<L>(block, &mut values);
                }
                for (lanes, value) in nodes.chunks_exact_mut(L::LANES).zip(values) {
                    lanes[lane] = value;
                }
            }
        }
        Ok(())
    }
}

/// Reduces the network to its electrodes.
struct Reduce<'a> {
    plan: &'a ReductionPlan,
    work: &'a mut BatchWork,
}

impl LaneJob for Reduce<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lane32>(self) {
        let BatchWork { to_top_s, lanes, reduced, .. } = self.work;
        let block = reduce(self.plan, to_top_s, lanes.of::<L>());
        reduced.resize(block.len() * L::LANES, 0.0);
        for (lanes, numbers) in block.iter().zip(reduced.chunks_exact_mut(L::LANES)) {
            lanes.store(numbers);
        }
    }
}

/// Turns the reduced network of each lane into its frame, in f64.
struct ReadOut<'a> {
    batch: &'a BatchModel,
    /// Lanes of the kernel that did the reduction.
    lanes: usize,
    work: &'a mut BatchWork,
    frames: &'a mut [f32],
}

impl LaneJob for ReadOut<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lane32>(self) {
        let Self { batch, lanes, work, frames } = self;
        let groups = frames.chunks_mut(READ_OUT * batch.frame_len());
        for (first, frames) in (0..lanes).step_by(READ_OUT).zip(groups) {
            read_out(batch, [first, lanes], work, frames);
        }
    }
}

/// Computes the compression of one trial.
#[inline(always)]
fn superpose<L: Lane32>(
    batch: &BatchModel,
    contacts: &[Contact],
    load: &mut TrialLoad,
    one: &mut Workspace,
) -> ContactResult<()> {
    let blocks = batch.foam.nodes() / BLOCK_NODES;
    let TrialLoad { compression_mm, touched } = load;
    compression_mm.clear();
    compression_mm.resize(blocks, [0.0; BLOCK_NODES]);
    touched.clear();
    touched.resize(blocks, false);
    for (index, contact) in contacts.iter().enumerate() {
        batch.model.check(index, contact)?;
        let Some(row) = batch.points.find(contact.x_mm, contact.y_mm) else {
            batch.model.load(contacts, one)?;
            let nodes = compression_mm.as_flattened_mut().iter_mut();
            for (x, &node) in nodes.zip(batch.plan.order()) {
                *x = one.compression_mm().get(node as usize).map_or(0.0, |&x| x as f32);
            }
            touched.fill(true);
            break;
        };
        batch.points.add::<L>(row, contact.force_n, compression_mm, touched);
    }
    Ok(())
}

/// Converts lanes of the reduced network, from lane `first` on, to their frames, in f64.
#[inline(always)]
fn read_out(
    batch: &BatchModel,
    [first, lanes]: [usize; 2],
    work: &mut BatchWork,
    frames: &mut [f32],
) {
    let kept = batch.plan.kept();
    work.block.clear();
    work.block.resize((kept + 1) * kept, [0.0; READ_OUT]);
    let mut numbers = work.reduced.chunks_exact(lanes);
    for (column, values) in work.block.chunks_exact_mut(kept + 1).enumerate() {
        for (value, numbers) in values[column + 1..].iter_mut().zip(&mut numbers) {
            *value = std::array::from_fn(|lane| f64::from(numbers[first + lane]));
        }
    }
    let frame_v = work.readout.evaluate_lanes(&work.block, batch.model.circuit());
    for (lane, frame) in frames.chunks_exact_mut(batch.frame_len()).enumerate() {
        for (out, v) in frame.iter_mut().zip(frame_v) {
            *out = v[lane] as f32;
        }
    }
}
