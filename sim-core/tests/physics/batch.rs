//! The batch path compared with the f64 path: accuracy over all loads, bytes, extremes, errors.

use std::sync::OnceLock;

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::batch::{BatchError, BatchModel, BatchWork, Kernel};
use sim_core::circuit::ReadoutCircuit;
use sim_core::fields::{DisplacementLut, LutGrid, NodeFields};
use sim_core::forward::{Contact, ContactError, ForwardModel, Workspace};

use super::{model, press, responses, sensor};

/// Largest difference from the f64 path, relative to the electrode voltages behind a value.
const ACCURACY: f64 = 2e-6;

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::ALL.into_iter().filter(|kernel| kernel.is_here())
}

/// The nominal skin in each kernel that this processor supports.
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

/// The largest error of frames compared with the f64 path: a value is a difference of two electrode
/// voltages, and its error is relative to the greater of them.
fn error(model: &ForwardModel, trials: &[Vec<Contact>], frames: &[f32]) -> f64 {
    let mut work = Workspace::default();
    let mut worst = 0f64;
    for (contacts, frame) in trials.iter().zip(frames.chunks_exact(784)) {
        let exact = model.voltages(contacts, &mut work).unwrap().to_vec();
        let seen = work.readout().electrodes_v();
        for (at, (&v, exact)) in frame.iter().zip(exact).enumerate() {
            let (k, j) = (at / 28, at % 28);
            let size = seen[28 * k + j].max(seen[28 * k + (j + 1) % 28]);
            let error = (f64::from(v) - exact).abs() / size;
            worst = if error.is_nan() { f64::INFINITY } else { worst.max(error) };
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

/// Frames of a naive f32 path: a sparse Cholesky factor with a diagonal and subtractions, in the
/// same precision, and the same last stage in f64.
fn plain_f32_frames(trials: &[Vec<Contact>]) -> Vec<f32> {
    let network = model().network().unwrap();
    let mut work = Workspace::default();
    let mut frames = Vec::new();
    for contacts in trials {
        model().voltages(contacts, &mut work).unwrap();
        let n = network.places_mm.len();
        let mut triplets: Vec<_> =
            (0..n).map(|i| Triplet::new(i, i, work.to_top_s()[i] as f32)).collect();
        for r in &network.resistors {
            let (i, j, g) = (r.a as usize, r.b as usize, r.conductance_s as f32);
            triplets.push(Triplet::new(i, i, g));
            triplets.push(Triplet::new(j, j, g));
            triplets.push(Triplet::new(i.max(j), i.min(j), -g));
        }
        let matrix = SparseColMat::<usize, f32>::try_new_from_triplets(n, n, &triplets).unwrap();
        let mut rhs = Mat::<f32>::zeros(n, 28);
        for (k, &electrode) in network.electrodes.iter().enumerate() {
            rhs[(electrode as usize, k)] = 1.0;
        }
        // In f32 the matrix of a lightly touched skin may not be positive definite numerically.
        let z = matrix.sp_cholesky(Side::Lower).map(|factor| factor.solve(&rhs));
        let z_at = |j: usize, k: usize| {
            let row = network.electrodes[j] as usize;
            z.as_ref().map_or(f64::NAN, |z| f64::from(z[(row, k)]))
        };
        for k in 0..28 {
            let volts = |j: usize| 12.0 * (z_at(k, k) - z_at(j, k)) / z_at(k, k);
            frames.extend((0..28).map(|j| (volts(j) - volts((j + 1) % 28)) as f32));
        }
    }
    frames
}

#[test]
fn a_plain_cholesky_in_f32_fails_the_same_check() {
    for (range, seed) in [(0.05..1.0, 1), (5.0..40.0, 2), (40.0..240.0, 3)] {
        let trials = trials(4, range.clone(), seed);
        let error = error(model(), &trials, &plain_f32_frames(&trials));
        println!("plain Cholesky in f32, {range:?} N: {error:.1e}");
        assert!(error > 100.0 * ACCURACY, "{range:?} N: {error:e}");
    }
}

#[test]
fn one_wrong_node_of_3503_fails_the_same_check() {
    // The foam under a tip 10 % off at one node.
    let trials = trials(6, 1.0..40.0, 2);
    let mut fields = NodeFields::nominal(model().mesh());
    let centre = model().mesh().points[sensor().points().len() / 2].centre as usize;
    fields.ln_a[centre] += 0.1;
    let mut pressed = trials.clone();
    pressed[0] = vec![press(sensor().points().len() / 2, 30.0)];
    let circuit = ReadoutCircuit::nominal(sensor());
    let twin = ForwardModel::with(sensor(), responses(), fields, circuit).unwrap();
    let twin = BatchModel::new(&twin, Kernel::detect());
    let error = error(model(), &pressed, &frames(&twin, &pressed));
    assert!(error > 100.0 * ACCURACY, "{error:e}");
}

#[test]
fn the_reality_gap_is_honoured() {
    let mesh = model().mesh();
    let mut fields = NodeFields::nominal(mesh);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for field in [&mut fields.ln_a, &mut fields.ln_b, &mut fields.ln_c, &mut fields.ln_compliance] {
        field.iter_mut().for_each(|v| *v = rng.random_range(-0.3..0.3));
    }
    fields.ln_sheet_conductance.iter_mut().for_each(|v| *v = rng.random_range(-0.2..0.2));
    let law = |x: f64| x / (1.0 + (x / 5.0).powi(4)).powf(0.25);
    fields.displacement =
        Some(DisplacementLut::sample(LutGrid { step_mm: 0.05, end_mm: 12.0 }, law).unwrap());
    let mut circuit = ReadoutCircuit::nominal(sensor());
    for (index, site) in circuit.electrodes.iter_mut().enumerate() {
        site.contact_ohm = 30.0;
        site.lead_ohm = 400.0 + 50.0 * index as f64;
        site.x_mm += if site.x_mm < 270.0 { 3.0 } else { -3.0 };
    }
    circuit.gain = 1.7;
    let real = ForwardModel::with(sensor(), responses(), fields, circuit).unwrap();
    let trials = trials(18, 0.5..60.0, 6);
    for kernel in kernels() {
        let frames = frames(&BatchModel::new(&real, kernel), &trials);
        // The gain scales frames, not the electrode voltages that errors are relative to.
        let found = error(&real, &trials, &frames) / 1.7;
        assert!(found < ACCURACY, "{}: {found:e}", kernel.name());
        assert!(error(model(), &trials, &frames) > 0.01, "a nominal skin looks different");
    }
}

#[test]
fn a_trials_bytes_do_not_depend_on_its_neighbours() {
    let trials = trials(37, 1.0..40.0, 7);
    for batch in batches() {
        let name = batch.kernel().name();
        let all = frames(batch, &trials);
        // One by one, and shifted with respect to the lanes.
        for (trial, expected) in trials.iter().zip(all.chunks_exact(784)) {
            assert_eq!(frames(batch, std::slice::from_ref(trial)), expected, "{name}");
        }
        assert_eq!(frames(batch, &trials[5..]), all[5 * 784..], "{name}");
        // The order of a trial's neighbours, as well.
        let turned: Vec<_> = trials.iter().rev().cloned().collect();
        let turned = frames(batch, &turned);
        for (a, b) in turned.chunks_exact(784).rev().zip(all.chunks_exact(784)) {
            assert_eq!(a, b, "{name}");
        }
    }
}

#[test]
fn extremes_are_finite_and_bounded() {
    let ring =
        |force_n: f64| -> Vec<Contact> { (0..6).map(|i| press(380 + 2 * i, force_n)).collect() };
    let mut loads = vec![vec![], vec![press(0, 0.0)], vec![press(803, 240.0)]];
    loads.extend([1e-12, 1e-3, 240.0].map(ring));
    // The same point six times: 1,440 N, far beyond the foam's exponential range.
    loads.push(vec![press(400, 240.0); 6]);
    for batch in batches() {
        let frames = frames(batch, &loads);
        assert!(frames.iter().all(|v| v.is_finite() && v.abs() <= 12.0));
        assert_eq!(frames[..784], frames[784..2 * 784], "no force is no contact");
        assert!(error(model(), &loads, &frames) < ACCURACY);
    }
}

#[test]
fn an_empty_batch_is_legal_and_bad_ones_are_refused() {
    let batch = &batches()[0];
    assert_eq!(frames(batch, &[]), Vec::<f32>::new());
    let mut work = BatchWork::default();
    let mut refused = |contact: Contact| {
        let good = [press(3, 5.0)];
        let bad = [press(1, 1.0), contact];
        let trials: Vec<&[Contact]> =
            (0..20).map(|t| if t == 17 { &bad[..] } else { &good }).collect();
        batch.voltages(&trials, &mut vec![0.0; 20 * 784], &mut work).unwrap_err()
    };
    for force_n in [-1.0, f64::NAN, f64::INFINITY] {
        let found = refused(press(5, force_n));
        let source = match found {
            BatchError::Trial { trial: 17, source } => source,
            other => panic!("{other}"),
        };
        assert!(matches!(source, ContactError::Force { contact: 1, .. }), "{source}");
    }
    let off = Contact { x_mm: -30.0, ..press(5, 3.0) };
    assert!(matches!(refused(off), BatchError::Trial { trial: 17, .. }));
    let found = batch.voltages(&[&[]], &mut [0.0; 783], &mut work).unwrap_err();
    assert_eq!(found, BatchError::Output { trials: 1, needed: 784, found: 783 });
}

#[test]
fn contacts_beside_the_points_go_the_slow_way_and_are_right() {
    // A tenth of a millimetre off: no table row has exactly this position.
    let off = |point: usize, force_n: f64| {
        let on = press(point, force_n);
        Contact { x_mm: on.x_mm + 0.1, y_mm: on.y_mm - 0.1, ..on }
    };
    let loads = vec![vec![off(100, 20.0)], vec![press(300, 8.0), off(500, 30.0)], vec![]];
    for batch in batches() {
        assert!(error(model(), &loads, &frames(batch, &loads)) < ACCURACY);
    }
}
