//! The batch path against the f64 path: accuracy over all loads, bytes, extremes, errors.

use std::sync::OnceLock;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::batch::{BatchError, BatchModel, BatchWork, Kernel};
use sim_core::circuit::ReadoutCircuit;
use sim_core::fields::{DisplacementLut, NodeFields};
use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};

use super::{model, press, responses, sensor};

/// Largest difference from the f64 path, relative to the electrode voltages behind a value.
const ACCURACY: f64 = 2e-6;

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::ALL.into_iter().filter(|kernel| kernel.is_here())
}

/// The nominal skin in each kernel that this processor has.
fn batches() -> &'static [BatchModel] {
    static BATCHES: OnceLock<Vec<BatchModel>> = OnceLock::new();
    BATCHES.get_or_init(|| kernels().map(|kernel| BatchModel::new(model(), kernel)).collect())
}

/// Trials with one to six contacts on different points, forces spread evenly over their logarithms.
fn trials(count: usize, force_n: std::ops::Range<f64>, seed: u64) -> Vec<Vec<Contact>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (least, most) = (force_n.start.ln(), force_n.end.ln());
    (0..count)
        .map(|trial| {
            let mut points = Vec::new();
            while points.len() < 1 + trial % 6 {
                let point = rng.random_range(0..804);
                if !points.contains(&point) {
                    points.push(point);
                }
            }
            points.into_iter().map(|p| press(p, rng.random_range(least..most).exp())).collect()
        })
        .collect()
}

fn frames(batch: &BatchModel, trials: &[Vec<Contact>]) -> Vec<f32> {
    let trials: Vec<&[Contact]> = trials.iter().map(Vec::as_slice).collect();
    let mut out = vec![f32::NAN; 784 * trials.len()];
    batch.voltages(&trials, &mut out, &mut BatchWork::default()).unwrap();
    out
}

/// The largest error of frames against the f64 path: a value is a difference of two electrode
/// voltages, and counts relative to the greater of them.
fn error(model: &ForwardModel, trials: &[Vec<Contact>], frames: &[f32]) -> f64 {
    let mut work = Workspace::default();
    let mut worst = 0f64;
    for (contacts, frame) in trials.iter().zip(frames.chunks_exact(784)) {
        let exact = model.voltages(contacts, &mut work).unwrap().to_vec();
        let seen = work.readout().electrodes_v();
        for (at, (&v, exact)) in frame.iter().zip(exact).enumerate() {
            let (k, j) = (at / 28, at % 28);
            let size = seen[28 * k + j].max(seen[28 * k + (j + 1) % 28]);
            worst = worst.max((f64::from(v) - exact).abs() / size);
        }
    }
    worst
}

#[test]
fn every_kernel_agrees_with_the_exact_path_at_every_load() {
    for (seed, range) in [(1, 0.05..1.0), (2, 1.0..40.0), (3, 40.0..240.0), (4, 0.05..240.0)] {
        let trials = trials(24, range.clone(), seed);
        for batch in batches() {
            let error = error(model(), &trials, &frames(batch, &trials));
            println!("{}, {range:?} N: {error:.1e}", batch.kernel().name());
            assert!(error < ACCURACY, "{}, {range:?} N: {error:e}", batch.kernel().name());
        }
    }
}
