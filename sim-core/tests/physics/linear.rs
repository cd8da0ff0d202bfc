//! The one-step reconstruction compared with dense algebra by another method.

use std::sync::OnceLock;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_core::forward::{Contact, Workspace};
use sim_core::inverse::linear::{LinearError, OneStep, Penalty, PointSlopes, Regularisation};

use super::{model, press};

const CHANNELS: usize = 784;
const NOISE_V: f64 = 0.2e-3;

fn slopes() -> &'static PointSlopes {
    static SLOPES: OnceLock<PointSlopes> = OnceLock::new();
    SLOPES.get_or_init(|| PointSlopes::secant(model(), 15.0).unwrap())
}

fn one_step() -> &'static OneStep {
    static ONE_STEP: OnceLock<OneStep> = OnceLock::new();
    ONE_STEP.get_or_init(|| OneStep::new(slopes(), Regularisation::Tikhonov).unwrap())
}

fn measured(contacts: &[Contact], seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let mut work = Workspace::default();
    let frame = model().voltages(contacts, &mut work).unwrap();
    frame.iter().map(|v| v + NOISE_V * normal()).collect()
}

fn load() -> [Contact; 2] {
    [press(210, 15.0), press(600, 12.0)]
}

/// `(J J' + penalty I)^-1 v`: the residual is `penalty` times it, the forces are `J'` times it, and
/// `trace(I - A) = penalty trace((J J' + penalty I)^-1)`.
fn dense(frame_v: &[f64], penalty_v2: f64) -> (Vec<f64>, f64) {
    let points = model().sensor().points().len();
    let j = Mat::from_fn(CHANNELS, points, |i, p| slopes().of(p)[i]);
    let mut kernel = &j * j.transpose();
    for i in 0..CHANNELS {
        kernel[(i, i)] += penalty_v2;
    }
    let factor = kernel.llt(Side::Lower).unwrap();
    let rest = model().voltages(&[], &mut Workspace::default()).unwrap().to_vec();
    let change = Mat::from_fn(CHANNELS, 1, |i, _| frame_v[i] - rest[i]);
    let solved = factor.solve(&change);
    let inverse = factor.solve(Mat::<f64>::identity(CHANNELS, CHANNELS));
    let free: f64 = (0..CHANNELS).map(|i| penalty_v2 * inverse[(i, i)]).sum();
    let residual_v2: f64 = (0..CHANNELS).map(|i| (penalty_v2 * solved[(i, 0)]).powi(2)).sum();
    let forces = j.transpose() * &solved;
    ((0..points).map(|p| forces[(p, 0)]).collect(), residual_v2 / (free * free))
}

fn largest_v2() -> f64 {
    let points = model().sensor().points().len();
    let j = Mat::from_fn(CHANNELS, points, |i, p| slopes().of(p)[i]);
    (&j * j.transpose()).self_adjoint_eigenvalues(Side::Lower).unwrap()[CHANNELS - 1]
}

#[test]
fn forces_are_those_of_dense_algebra() {
    let frame_v = measured(&load(), 1);
    for share in [1e-2, 1e-4] {
        let (forces, _) = dense(&frame_v, share * largest_v2());
        let found = one_step().solve(&frame_v, Penalty::Share(share)).unwrap();
        let largest = forces.iter().fold(0.0f64, |l, f| l.max(f.abs()));
        for (a, b) in found.forces_n.iter().zip(&forces) {
            assert!((a - b).abs() < 1e-6 * largest, "{a} {b}");
        }
    }
}

#[test]
fn cross_validation_chooses_the_penalty_that_is_least_by_dense_algebra() {
    let (frame_v, largest_v2) = (measured(&load(), 1), largest_v2());
    let gcv = |share: f64| dense(&frame_v, share * largest_v2).1;
    let share = one_step().solve(&frame_v, Penalty::Gcv).unwrap().penalty;
    let least = gcv(share);
    // Penalties are compared in steps of a tenth of a power of ten.
    for powers in [-1.0, -0.1, 0.1, 1.0] {
        let other = gcv(share * 10f64.powf(powers));
        assert!(least <= other * (1.0 + 1e-9), "{share}: {least}, 10^{powers} times it: {other}");
    }
}

#[test]
fn cross_validation_chooses_a_penalty_that_is_nearly_the_best() {
    let frame_v = measured(&load(), 2);
    // On a linear problem the truth is known: frames of the slopes themselves.
    let points = model().sensor().points().len();
    let mut truth = vec![0.0; points];
    (truth[210], truth[600]) = (15.0, 12.0);
    let error = |penalty: Penalty| {
        let found = one_step().solve(&frame_v, penalty).unwrap();
        let off = found.forces_n.iter().zip(&truth).map(|(f, t)| (f - t).powi(2));
        (off.sum::<f64>().sqrt(), found.penalty)
    };
    let tried = (0..=40).map(|i| 10f64.powf(-0.25 * f64::from(i)));
    let best = tried.map(|share| error(Penalty::Share(share)).0).fold(f64::INFINITY, f64::min);
    let (found, share) = error(Penalty::Gcv);
    assert!(found < 1.3 * best, "{found} N, best {best} N, share {share}");
}

#[test]
fn noser_finds_the_contact() {
    let frame_v = measured(&load()[..1], 3);
    let noser = OneStep::new(slopes(), Regularisation::Noser).unwrap();
    let found = noser.solve(&frame_v, Penalty::Gcv).unwrap();
    let most = (0..found.forces_n.len())
        .max_by(|a, b| found.forces_n[*a].total_cmp(&found.forces_n[*b]))
        .unwrap();
    let (a, b) = (press(most, 1.0), load()[0]);
    assert!((a.x_mm - b.x_mm).hypot(a.y_mm - b.y_mm) < 35.0, "{a:?}");
}

#[test]
fn what_cannot_be_inverted_is_refused_by_name() {
    let short = one_step().solve(&[0.0; 3], Penalty::Gcv);
    assert_eq!(short, Err(LinearError::Length { found: 3, needed: CHANNELS }));
    let mut frame_v = measured(&[], 4);
    let none = one_step().solve(&frame_v, Penalty::Share(0.0));
    assert_eq!(none, Err(LinearError::Penalty { penalty: 0.0 }));
    frame_v[9] = f64::NAN;
    let refused = one_step().solve(&frame_v, Penalty::Gcv);
    assert_eq!(refused, Err(LinearError::NotFinite { channel: 9 }));
    // A millionth of a newton compresses the foam by less than the least compression that counts: nothing changes.
    let untouched = PointSlopes::secant(model(), 1e-6).unwrap();
    assert!(matches!(OneStep::new(&untouched, Regularisation::Noser), Err(LinearError::Flat)));
}
