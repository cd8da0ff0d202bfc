//! Regressions in closed form, of a quantity, of a frame or of a force map, and perceptrons.

use nets::noise::{Noise, NoiseSource};
use nets::progress::Trained;
use nets::recipe::Recipe;
use nets::statistics::{Measured, Statistics};
use palpate_trainer::answer::answer;
use palpate_trainer::train::train;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{ONE_THREAD, Rows, Watch, plan};

const CHANNELS: usize = 12;

/// Random frames of a few hundredths of a volt, and `target` of each.
fn rows(count: usize, seed: u64, target: impl Fn(&[f32]) -> Vec<f32>) -> Rows {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut frame =
        || (0..CHANNELS).map(|_| chance.random_range(-0.03..0.03)).collect::<Vec<f32>>();
    let inputs: Vec<Vec<f32>> = (0..count).map(|_| frame()).collect();
    let targets = inputs.iter().map(|frame| target(frame)).collect();
    Rows { inputs, targets }
}

fn trained(net: &str, learn: &Rows, choose: &Rows, watch: &mut Watch) -> Trained {
    train(&plan(&format!("seed = 1\n{net}")), learn, choose, None, watch).unwrap()
}

/// Root mean square error on rows.
fn error(trained: &Trained, rows: &Rows) -> f64 {
    let answers = answer(&trained.network, &rows.inputs.concat(), ONE_THREAD);
    let targets = rows.targets.concat();
    let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
    let sum: f64 = answers.unwrap().iter().zip(&targets).map(square).sum();
    (sum / targets.len() as f64).sqrt()
}

/// x and y by a linear law, mm.
fn linear(frame: &[f32]) -> Vec<f32> {
    let along = |phase: f32| {
        frame.iter().zip(0u8..).map(|(v, c)| 900.0 * v * (f32::from(c) + phase).cos()).sum::<f32>()
    };
    vec![270.0 + along(0.0), 280.0 + along(1.0)]
}

/// A force that no linear law describes: its best linear answer is constant.
fn even(frame: &[f32]) -> Vec<f32> {
    vec![10.0 + 4e4 * frame[0] * frame[1] + 2e4 * frame[2] * frame[2]]
}

#[test]
fn ridge_regression_finds_a_linear_law_also_with_fewer_rows_than_channels() {
    let net = "[net]\nkind = 'ridge'\nanswers = 'position'\n";
    let (learn, other) = (rows(200, 1, linear), rows(50, 2, linear));
    let spread = 30.0;
    let of_many = error(&trained(net, &learn, &other, &mut Watch::default()), &other);
    assert!(of_many < 1e-3 * spread, "{of_many} mm");
    // In dual variables: the law is one of eight rows, their differences from the mean are seven.
    let few = rows(8, 1, linear);
    let of_few = trained(net, &few, &few, &mut Watch::default());
    assert!(error(&of_few, &few) < 1e-3 * spread, "{} mm", error(&of_few, &few));
    assert!(error(&of_few, &other) > 5.0);
}

#[test]
fn kernel_ridge_regression_finds_what_is_not_linear_and_ridge_does_not() {
    let (learn, choose, other) = (rows(900, 1, even), rows(200, 2, even), rows(200, 3, even));
    let constant = 20.0;
    let errors = ["ridge", "kernel-ridge"].map(|kind| {
        let net = format!("[net]\nkind = '{kind}'\nanswers = 'force'\n");
        let mut watch = Watch::default();
        let trained = trained(&net, &learn, &choose, &mut watch);
        assert_eq!(trained.curve.len(), watch.losses.len());
        error(&trained, &other)
    });
    assert!(errors[0] > 0.4 * constant && errors[1] < 0.2 * errors[0], "{errors:?} N");
}

#[test]
fn regressions_answer_frames() {
    let mixed = |frame: &[f32]| -> Vec<f32> {
        (0..CHANNELS).map(|c| 2.0 * frame[c] + frame[(c + 1) % CHANNELS]).collect()
    };
    let (learn, other) = (rows(300, 1, mixed), rows(50, 2, mixed));
    let spread_v = 0.03 * (5.0f64 / 3.0).sqrt();
    for (kind, most) in [("ridge", 1e-3), ("kernel-ridge", 0.2)] {
        let net = format!("[net]\nkind = '{kind}'\nanswers = 'frame'\n");
        let trained = trained(&net, &learn, &other, &mut Watch::default());
        assert_eq!(trained.network.output, [CHANNELS]);
        assert!(error(&trained, &other) < most * spread_v, "{kind}: {} V", error(&trained, &other));
    }
}

/// More pixels than those by which the penalty is chosen.
#[test]
fn regressions_answer_force_maps_without_negative_forces() {
    const SIDE: usize = 40;
    let drawn = |frame: &[f32]| -> Vec<f32> {
        let pixel = |p: usize| 5.0 + 40.0 * (1 + p / 800) as f32 * frame[p % CHANNELS];
        (0..SIDE * SIDE).map(pixel).collect()
    };
    let (learn, other) = (rows(300, 1, drawn), rows(50, 2, drawn));
    let spread_n = 40.0 * 0.03 * (2.5f64 / 3.0).sqrt();
    for (kind, answers, most) in [("ridge", "map", 1e-3), ("kernel-ridge", "recon-map", 0.2)] {
        let net = format!("[net]\nkind = '{kind}'\nanswers = '{answers}'\nside = {SIDE}\n");
        let trained = trained(&net, &learn, &other, &mut Watch::default());
        assert_eq!(trained.network.output, [SIDE, SIDE]);
        assert!(error(&trained, &other) < most * spread_n, "{kind}: {}", error(&trained, &other));
    }
    // Fewer rows than channels: two layers with fewer weights than one.
    let few = rows(8, 1, drawn);
    let net = "[net]\nkind = 'ridge'\nanswers = 'map'\nside = 40\n";
    let of_few = trained(net, &few, &few, &mut Watch::default());
    assert!(of_few.network.clone().numbers().len() < CHANNELS * SIDE * SIDE + 2 * SIDE * SIDE);
    assert!(error(&of_few, &few) < 1e-2 * spread_n, "{} N", error(&of_few, &few));
    let signed = |frame: &[f32]| vec![frame[0]; SIDE * SIDE];
    let learn = rows(300, 1, signed);
    let fitted = trained(net, &learn, &learn, &mut Watch::default());
    let found = answer(&fitted.network, &learn.inputs.concat(), ONE_THREAD).unwrap();
    assert!(found.iter().all(|n| *n >= 0.0) && found.iter().any(|n| *n > 0.0));
    for wrong in ["answers = 'map'", "answers = 'map'\nside = 161", "side = 40"] {
        let refused = Recipe::from_toml(&format!("seed = 1\n[net]\nkind = 'ridge'\n{wrong}\n"));
        assert!(refused.unwrap_err().to_string().contains("net.side"), "{wrong}");
    }
}

#[test]
fn a_perceptron_learns_each_quantity() {
    let pattern = |frame: &[f32]| vec![f32::from(frame[0] > 0.0), f32::from(frame[1] > frame[2])];
    let count = |frame: &[f32]| vec![f32::from(frame[3] > 0.0) + f32::from(frame[4] > 0.0)];
    let net = |answers: &str| {
        format!(
            "epochs = 120\nbatch = 16\n[net]\nkind = 'mlp'\nanswers = '{answers}'\nwidth = 64\n\
             [optimiser]\nschedule = 'cosine'\n"
        )
    };
    for (answers, learn, other, most) in [
        ("position", rows(600, 1, linear), rows(200, 2, linear), 5.0),
        ("force", rows(600, 1, even), rows(200, 2, even), 8.0),
        ("count", rows(600, 1, count), rows(200, 2, count), 0.45),
    ] {
        let trained = trained(&net(answers), &learn, &other, &mut Watch::default());
        assert!(error(&trained, &other) < most, "{answers}: {}", error(&trained, &other));
    }
    let (learn, other) = (rows(600, 1, pattern), rows(200, 2, pattern));
    let trained = trained(&net("pattern"), &learn, &other, &mut Watch::default());
    let logits = answer(&trained.network, &other.inputs.concat(), ONE_THREAD).unwrap();
    let right =
        logits.iter().zip(other.targets.concat()).filter(|(z, t)| (**z > 0.0) == (*t > 0.5));
    assert!(right.count() > 370, "of 400");
}

/// A channel that is constant in training once caused a loss of 1e21 when it moved.
#[test]
fn a_channel_that_is_constant_in_training_is_ignored_and_named() {
    let mut learn = rows(200, 1, linear);
    learn.inputs.iter_mut().for_each(|frame| frame.push(0.1));
    let mut other = rows(100, 2, linear);
    other.inputs.iter_mut().enumerate().for_each(|(row, frame)| frame.push(row as f32));
    let answers = "answers = 'position'\n";
    for net in [
        format!("[net]\nkind = 'ridge'\n{answers}"),
        format!("[net]\nkind = 'kernel-ridge'\n{answers}"),
        format!("epochs = 60\nbatch = 16\n[net]\nkind = 'mlp'\n{answers}"),
    ] {
        let mut watch = Watch::default();
        let trained = trained(&net, &learn, &other, &mut watch);
        assert!(error(&trained, &other) < 15.0, "{net}: {} mm", error(&trained, &other));
        let words = "1 of 13 channels are constant in the training rows";
        assert!(watch.warnings[0].starts_with(words), "{:?}", watch.warnings);
    }
}

/// Its sum over these rows is rounded: without the differences from the first row, that was a spread of 2.7 uV, more than
/// the limit, by which the channel was then divided.
#[test]
fn a_channel_is_constant_also_where_its_sum_is_rounded() {
    let mut learn = rows(700, 1, linear);
    learn.inputs.iter_mut().for_each(|frame| frame.push(24.1));
    let noise = NoiseSource::new(1, Noise::default(), None, CHANNELS + 1);
    for measured in [Measured::Moments, Measured::WithoutExtremes] {
        let found = Statistics::measure(&learn, measured, &noise, 1).unwrap();
        assert_eq!(found.constant_channels(), 1, "{measured:?}: {:?}", found.sd);
        assert_eq!(found.mean[CHANNELS], 24.1);
    }
}

/// One frame in 75 has a channel of a thousand times the others' size. Standardised, all other frames are
/// alike.
#[test]
fn faults_in_few_rows_do_not_spoil_a_robust_input() {
    let (mut learn, choose, other) = (rows(900, 1, even), rows(200, 2, even), rows(200, 3, even));
    for channel in 0..CHANNELS {
        learn.inputs[75 * channel][channel] = 30.0;
    }
    let errors = ["standardised", "robust"].map(|input| {
        let net = format!("[net]\nkind = 'kernel-ridge'\nanswers = 'force'\ninput = '{input}'\n");
        error(&trained(&net, &learn, &choose, &mut Watch::default()), &other)
    });
    assert!(errors[1] < 0.5 * errors[0], "{errors:?} N");
    // Without faults the law is the same, and a fault changes an answer by a bounded amount.
    let net = "[net]\nkind = 'ridge'\nanswers = 'position'\ninput = 'robust'\n";
    let (learn, other) = (rows(200, 1, linear), rows(50, 2, linear));
    let fitted = trained(net, &learn, &other, &mut Watch::default());
    assert!(error(&fitted, &other) < 0.03, "{} mm", error(&fitted, &other));
    let mut frame = other.inputs[0].clone();
    frame[0] = 1e6;
    let found = answer(&fitted.network, &frame, ONE_THREAD).unwrap();
    assert!(found.iter().all(|mm| mm.abs() < 1e3), "{found:?}");
    let refused = Recipe::from_toml(&format!("seed = 1\n{}", net.replace("robust", "unit")));
    assert!(refused.unwrap_err().to_string().contains("net.input"));
}

#[test]
fn a_fit_in_closed_form_can_be_stopped() {
    let (learn, other) = (rows(100, 1, even), rows(50, 2, even));
    let mut watch = Watch { checkpoint_at: Some(2), stop: true, ..Watch::default() };
    let net = "[net]\nkind = 'kernel-ridge'\nanswers = 'force'\n";
    let trained = trained(net, &learn, &other, &mut watch);
    assert_eq!((trained.end, watch.losses.len()), (nets::progress::End::Stopped, 2));
}
